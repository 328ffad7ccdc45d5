"""Clauses 5.15 and 8: the entropy coder."""

import struct
import zlib
from bisect import bisect_right
from collections.abc import Iterable, Sequence

from .conventions import ESCAPE_PREFIX_MAX, PRECISION, RAW_MAX, SCALE_END, SCALE_MIN, STATE_MIN, clamp, shift_round
from .errors import require
from .tables import Family, Model

HEAD_LENGTH = 8
SLOT_MASK = (1 << PRECISION) - 1


# SPEC 8.5, SELECT
def select(mean: int, scale: int) -> tuple[int, int, int, int]:
    """Return the row from 0, the column, the centre and the number of raw bits of a value."""
    raw = clamp((scale - SCALE_END) // 8 + 1, 0, RAW_MAX)
    row = clamp(scale - 8 * raw, SCALE_MIN, SCALE_END - 1) - SCALE_MIN
    centre, column = divmod(shift_round(mean - 8 * ((1 << raw) - 1), raw) + 8, 16)
    return row, column, centre, raw


class RawBits:
    """The bits behind the words. Past their end they are 0."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        self._taken = 0

    # SPEC 8.6
    def take(self, count: int) -> int:
        """Return the next field of count bits."""
        first, self._taken = self._taken, self._taken + count
        window = self._data[first >> 3 : (self._taken + 7) >> 3]
        return int.from_bytes(window, "little") >> (first & 7) & ((1 << count) - 1)

    # SPEC [R8.8-3]
    def length_right(self) -> bool:
        """Whether the bytes are as few as hold the taken bits."""
        return len(self._data) == (self._taken + 7) // 8

    # SPEC [R8.8-4]: the length is known to be right
    def padding_zero(self) -> bool:
        """Whether the bits after the last one taken are 0."""
        return self._taken % 8 == 0 or self._data[-1] >> self._taken % 8 == 0


class Substream:
    """A substream while it is decoded. offset: its first byte in the file."""

    # SPEC 5.15, [R8.1-1], [R8.1-2]
    def __init__(self, data: bytes, offset: int, length: int, lanes_log2: int) -> None:
        """Read the substream in data[offset : offset + length], and check its head and its states."""
        lanes = 1 << lanes_log2
        self.offset = offset
        words_at = HEAD_LENGTH + 4 * lanes
        require(length >= words_at, "substream.length", offset)
        self._crc_sent, word_count = struct.unpack_from("<2I", data, offset)
        raw_at = words_at + 2 * word_count
        require(length >= raw_at, "substream.length", offset)
        self._states = list(struct.unpack_from(f"<{lanes}I", data, offset + HEAD_LENGTH))
        require(min(self._states) >= STATE_MIN, "substream.state", offset)
        self._words = struct.unpack_from(f"<{word_count}H", data, offset + words_at)
        self._words_taken = 0
        self._raw = RawBits(data[offset + raw_at : offset + length])
        self._crc = 0
        self._escape_right = True
        self._range_right = True

    # SPEC 8.2, 8.3
    def _group(self, models: Iterable[Model]) -> list[int]:
        states, words, taken = self._states, self._words, self._words_taken
        lanes = len(states)
        out = []
        for n, (starts, frequencies, _) in enumerate(models):
            state = states[n % lanes]
            slot = state & SLOT_MASK
            symbol = bisect_right(starts, slot) - 1
            state = frequencies[symbol] * (state >> PRECISION) + slot - starts[symbol]
            if state < STATE_MIN:
                state = state << 16 | (words[taken] if taken < len(words) else 0)
                taken += 1
            states[n % lanes] = state
            out.append(symbol)
        self._words_taken = taken
        return out

    # SPEC [R8.8-5]
    def _note(self, values: list[int]) -> None:
        self._crc = zlib.crc32(struct.pack(f"<{len(values)}i", *values), self._crc)

    # SPEC 7.6, 7.12, 8.3
    def plain(self, models: Iterable[Model]) -> list[int]:
        """Decode a group of symbols that are no values: mask bits, or halves of children. models: one for each."""
        out = self._group(models)
        self._note(out)
        return out

    # SPEC 8.7, [R8.7-1]
    def _escape(self, radius: int) -> int:
        negative = self._raw.take(1)
        zeros = 0
        while zeros <= ESCAPE_PREFIX_MAX and self._raw.take(1) == 0:
            zeros += 1
        beyond = 1
        if zeros <= ESCAPE_PREFIX_MAX:
            beyond = (1 << zeros) + self._raw.take(zeros)
        else:
            self._escape_right = False
        return -(radius + beyond) if negative else radius + beyond

    # SPEC 8.5, 8.6, [R8.5-1]
    def values(self, family: Family, parameters: Sequence[Sequence[int]], limit: int) -> list[int]:
        """Decode a group of values. parameters: the mean and the scale index of each. limit: the largest magnitude."""
        chosen = [select(mean, scale) for mean, scale in parameters]
        models = [family[row][column] for row, column, _, _ in chosen]
        symbols = self._group(models)
        low_bits = [self._raw.take(raw) for _, _, _, raw in chosen]
        out = []
        for (_, _, centre, raw), model, symbol, low in zip(chosen, models, symbols, low_bits):
            distance = symbol - model.radius
            if distance > model.radius:
                distance = self._escape(model.radius)
            value = ((centre + distance) << raw) + low
            if abs(value) > limit:
                self._range_right = False
                value = 0
            out.append(value)
        self._note(out)
        return out

    # SPEC 8.8
    def finish(self) -> None:
        """Check the end of the substream, when all groups are decoded."""
        at = self.offset
        require(self._words_taken == len(self._words), "substream.words", at)
        require(all(state == STATE_MIN for state in self._states), "substream.final_state", at)
        require(self._escape_right, "substream.escape", at)
        require(self._range_right, "substream.symbol_range", at)
        require(self._raw.length_right(), "substream.raw_length", at)
        require(self._raw.padding_zero(), "substream.raw_padding", at)
        require(self._crc == self._crc_sent, "substream.symbol_crc", at)
