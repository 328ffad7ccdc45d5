"""Clauses 5.15 and 8: the entropy coder, interleaved rANS over many substreams at once.

Decoder and Encoder have the same two methods, `values` and `plain`, so each part of the decoding process is written
once and runs in either direction. Symbols come in groups (SPEC 8.3). The arrays of a group hold the symbols of the
first substream, then those of the second, and so on.
"""

import zlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import construct as cs
import numpy as np
from numpy.typing import NDArray

from . import syntax
from .conventions import Int64, clamp, rshift_round
from .errors import BitstreamError
from .source import Piece
from .tables import FRACTIONS, PRECISION, SCALE_END, SCALE_MIN, TOTAL, ModelSet

# SPEC 8.1: the smallest state of a lane, and its final state.
STATE_MIN = 1 << 16
# SPEC 8.5: the largest number of raw bits of a value.
RAW_MAX = 16
# SPEC 8.7: the largest number of zero bits in the prefix of an escape.
ESCAPE_PREFIX_MAX = 23
# SPEC 5.15: the bytes before the states.
HEAD_BYTES = syntax.size_of("Substream")
# Up to this number of lanes, decoding symbols one by one is faster than NumPy's array steps.
FEW_LANES = 32
# The name of a symbol of a group in a trace: (substream of the batch, index in its part of the group) -> path.
SymbolName = Callable[[int, int], str]


@dataclass(frozen=True)
class TraceRow:
    """One decoded symbol of a trace.

    path: its name.
    family: the family of its model, or the name of a ModelSet that is not a family.
    mean: in 1/16 of a step, or the index of the model for a symbol that is not a value.
    scale: the scale index, or 0 for a symbol that is not a value.
    value: the symbol.
    substream: the offset of its substream in the file.
    """

    path: str
    family: str
    mean: int
    scale: int
    value: int
    substream: int


Trace = Callable[[TraceRow], None]


@dataclass(frozen=True)
class Substream:
    """SPEC 5.15: a substream.

    states: uint32 [lanes]. words: uint16 [word_count]. raw: the raw bytes. offset: of its first byte in the file.
    path: its name.
    """

    symbol_crc: int
    states: NDArray[np.uint32]
    words: NDArray[np.uint16]
    raw: bytes
    offset: int
    path: str


def parse_substream(piece: Piece, lanes: int, path: str) -> Substream:
    """SPEC 5.15 and 8.1: returns the substream in a piece of the file.

    Raises BitstreamError substream.length or substream.state.
    """
    try:
        head, size = syntax.parse("Substream", piece.data[:HEAD_BYTES])
    except cs.ConstructError:
        allowed = f"at least the {HEAD_BYTES} of its head"
        raise piece.error("substream.length", 0, path, f"{len(piece)} bytes", allowed) from None
    words_at = size + 4 * lanes
    raw_at = words_at + 2 * head.word_count
    if raw_at > len(piece):
        allowed = f"at least {raw_at}, for {lanes} states and {head.word_count} words"
        raise piece.error("substream.length", 0, path, f"{len(piece)} bytes", allowed)
    states = np.frombuffer(piece.data, "<u4", lanes, size).astype(np.uint32)
    if (states < STATE_MIN).any():
        lane = int(np.argmax(states < STATE_MIN))
        below = f"state {states[lane]} of lane {lane}"
        raise piece.error("substream.state", 0, path, below, f"at least {STATE_MIN}")
    words = np.frombuffer(piece.data, "<u2", head.word_count, words_at).astype(np.uint16)
    return Substream(head.symbol_crc, states, words, piece.data[raw_at:], piece.start, path)


def open_substream(piece: Piece, lanes: int, path: str) -> tuple[Substream, BitstreamError | None]:
    """Returns a substream and None, or an empty substream and the error of parse_substream.

    The empty one can be decoded in its place, in parallel with valid substreams.
    """
    try:
        return parse_substream(piece, lanes, path), None
    except BitstreamError as error:
        empty = np.empty(0, dtype=np.uint16)
        return Substream(0, np.full(lanes, STATE_MIN, dtype=np.uint32), empty, b"", piece.start, path), error


class SymbolCoder(Protocol):
    """A coder of symbols that are not values, in either direction."""

    def plain(self, models: ModelSet, index: Int64, counts: list[int], name: SymbolName, given: Int64 | None) -> Int64:
        """Codes one group of symbols and returns them, int64 [symbols].

        index: int64 [symbols], the model of each symbol. counts: the number of symbols of each substream. name: for a
        trace. given: int64 [symbols], the symbols for encoding, or None for decoding.
        """
        ...


@dataclass(frozen=True)
class ValueGroup:
    """A group of values for a Coder.

    mean: int64 [values], in 1/16 of a step. scale: int64 [values], scale indices. counts: the number of values of each
    substream. limit: the largest magnitude of a value. name: for a trace. given: int64 [values], the values for
    encoding, or None for decoding.
    """

    models: ModelSet
    mean: Int64
    scale: Int64
    counts: list[int]
    limit: int
    name: SymbolName
    given: Int64 | None = None


class Coder(SymbolCoder, Protocol):
    """A coder of symbols and values, in either direction."""

    def values(self, group: ValueGroup) -> Int64:
        """Codes one group of values and returns them, int64 [values]."""
        ...


def select(mean: Int64, scale: Int64) -> tuple[Int64, Int64, Int64]:
    """SPEC 8.5, SELECT: returns (model, centre, number of raw bits) of values. All arrays are int64 of one shape.

    mean: in 1/16 of a step. scale: scale indices. model: an index of a ModelSet, which counts rows, then columns.
    """
    raw = clamp(((scale - SCALE_END) >> 3) + 1, 0, RAW_MAX)
    row = clamp(scale - 8 * raw, SCALE_MIN, SCALE_END - 1)
    shifted = rshift_round(mean - 8 * ((np.int64(1) << raw) - 1), raw) + 8
    return (row - SCALE_MIN) * FRACTIONS + (shifted & 15), shifted >> 4, raw


def placed(models: ModelSet, mean: Int64, scale: Int64, value: Int64) -> tuple[Int64, Int64, Int64, Int64]:
    """SPEC 8.4 and 8.5: returns (model, model index, distance from the centre, number of raw bits) of values.

    All arrays are int64 of one shape. mean, scale: as for select. The model index 2 R + 1 is an escape.
    """
    model, centre, raw = select(mean, scale)
    away = (value >> raw) - centre
    radius = models.radius.take(model)
    return model, np.where(np.abs(away) > radius, 2 * radius + 1, away + radius), away, raw


class _Layout:
    """SPEC 8.3: the places of a group's symbols. Lane i mod lanes codes symbol i of a substream, in step i // lanes.

    even: every substream fills all lanes of all steps, so no symbol is moved.
    """

    def __init__(self, counts: list[int], lanes: int) -> None:
        self.counts = np.asarray(counts, dtype=np.int64)
        self.starts = np.cumsum(self.counts) - self.counts
        self.steps = -(-int(self.counts.max(initial=0)) // lanes)
        self.shape = (len(counts), self.steps, lanes)
        self.even = bool((self.counts == self.steps * lanes).all())
        if not self.even:
            shift = np.arange(len(counts)) * (self.steps * lanes) - self.starts
            self.place = np.arange(int(self.counts.sum())) + np.repeat(shift, self.counts)

    def spread(self, flat: NDArray[Any], fill: int) -> NDArray[Any]:
        """Returns [symbols] as [steps, substreams, lanes], with `fill` where there is no symbol."""
        if not self.even:
            padded = np.full(int(np.prod(self.shape)), fill, dtype=flat.dtype)
            padded[self.place] = flat
            flat = padded
        return np.ascontiguousarray(flat.reshape(self.shape).transpose(1, 0, 2))

    def gather(self, grid: NDArray[Any]) -> NDArray[Any]:
        """Returns [steps, substreams, lanes] as [symbols]: the reverse of spread."""
        flat = grid.transpose(1, 0, 2).reshape(-1)
        return flat if self.even else flat[self.place]


class Decoder:
    """A coder that decodes a batch of substreams in parallel.

    Decoding never stops within a substream (SPEC 8.8). Words and raw bits past the end read as zero. `finish` returns
    the errors.
    """

    lanes: int
    state: NDArray[np.uint32]
    words: NDArray[np.uint32]
    word_at: Int64
    word_end: Int64
    raw: bytes
    raw_bytes: NDArray[np.uint8]
    raw_base: Int64
    raw_end: Int64
    raw_at: Int64
    crc: list[int]
    bad_escape: NDArray[np.bool_]

    def __init__(self, streams: list[Substream], trace: Trace | None = None) -> None:
        """streams: at least one, all with the same number of lanes."""
        self.streams = streams
        self.trace = trace
        self.lanes = len(streams[0].states)
        self.state = np.stack([s.states for s in streams])
        # Reads past the end of a substream return one zero word and eight zero bytes after it.
        zero_word = np.zeros(1, np.uint16)
        self.words = np.concatenate([part for s in streams for part in (s.words, zero_word)]).astype(np.uint32)
        lengths = np.array([len(s.words) for s in streams], dtype=np.int64)
        self.word_at = np.cumsum(lengths + 1) - (lengths + 1)
        self.word_end = self.word_at + lengths
        raw_lengths = np.array([len(s.raw) for s in streams], dtype=np.int64)
        self.raw = b"".join(s.raw + bytes(8) for s in streams)
        self.raw_bytes = np.frombuffer(self.raw, np.uint8)
        self.raw_base = 8 * (np.cumsum(raw_lengths + 8) - (raw_lengths + 8))
        self.raw_end = 8 * raw_lengths
        self.raw_at = np.zeros(len(streams), dtype=np.int64)
        self.crc = [0] * len(streams)
        self.bad_escape = np.zeros(len(streams), dtype=bool)
        self.bad_range: dict[int, tuple[int, int]] = {}

    def _group(self, models: ModelSet, index: Int64, layout: _Layout) -> Int64:
        """SPEC 8.2 and 8.3: decodes one symbol for each model index."""
        if len(layout.counts) * self.lanes <= FEW_LANES:
            return self._one_by_one(models, index, layout)
        return self._side_by_side(models, index, layout)

    def _one_by_one(self, models: ModelSet, index: Int64, layout: _Layout) -> Int64:
        """Decodes the symbols of a group one by one."""
        out = np.empty_like(index)
        # Items of a memoryview are Python integers, with which Python computes faster than with NumPy's.
        offset, first, lower, upper = models.offset.data, models.first.data, models.lower.data, models.upper.data
        words, model, symbol = self.words.data, index.data, out.data
        for stream, (start, count) in enumerate(zip(layout.starts.tolist(), layout.counts.tolist(), strict=True)):
            state, at, end = self.state[stream].tolist(), int(self.word_at[stream]), int(self.word_end[stream])
            for i in range(start, start + count):
                lane, m = (i - start) & (self.lanes - 1), model[i]
                x = state[lane]
                slot, base = x & (TOTAL - 1), offset[m]
                position = base + first[m << 8 | slot >> (PRECISION - 8)]
                # The top bits of a slot name the first symbol that it can mean. Few slots mean a later one.
                while upper[position] <= slot:
                    position += 1
                low = lower[position]
                x = (upper[position] - low) * (x >> PRECISION) + slot - low
                if x < STATE_MIN:
                    x = x << 16 | words[min(at, end)]
                    at += 1
                state[lane] = x
                symbol[i] = position - base
            self.state[stream], self.word_at[stream] = state, at
        return out

    def _side_by_side(self, models: ModelSet, index: Int64, layout: _Layout) -> Int64:
        """Decodes the symbols of a group with the lanes of all substreams at once."""
        grid = layout.spread(index, models.null).reshape(layout.steps, len(layout.counts) * self.lanes)
        base = models.offset.take(grid)
        grid = grid << 8
        out = np.empty_like(base)
        state, at = self.state.reshape(-1), self.word_at.copy()
        count = len(at)
        stream_of = np.repeat(np.arange(count), self.lanes)
        mask, low, word_bits = np.uint32(TOTAL - 1), np.uint32(STATE_MIN), np.uint32(16)
        shift, first_shift = np.uint32(PRECISION), np.uint32(PRECISION - 8)
        for step in range(layout.steps):
            slot = state & mask
            key = grid[step]
            key |= slot >> first_shift
            position = models.first.take(key)
            position += base[step]
            upper = models.upper.take(position)
            # The top bits of a slot name the first symbol that it can mean. Few slots mean a later one.
            late = (upper <= slot).nonzero()[0]
            while late.size:
                position[late] += 1
                bound = models.upper.take(position.take(late))
                upper[late] = bound
                late = late[bound <= slot.take(late)]
            lower = models.lower.take(position)
            out[step] = position
            upper -= lower
            slot -= lower
            state >>= shift
            state *= upper
            state += slot
            hungry = state < low
            need = hungry.nonzero()[0]
            if need.size:
                # The lanes of a substream read its words in lane order.
                stream = stream_of.take(need)
                taken = hungry.reshape(count, self.lanes).sum(axis=1)
                place = np.arange(need.size) + (at - np.cumsum(taken) + taken).take(stream)
                at += taken
                word = self.words.take(np.minimum(place, self.word_end.take(stream)))
                state[need] = (state.take(need) << word_bits) | word
        self.state, self.word_at = state.reshape(self.state.shape), at
        out -= base
        return layout.gather(out.reshape(layout.steps, count, self.lanes))

    def _raw(self, width: Int64, layout: _Layout) -> Int64:
        """SPEC 8.6: reads the raw low bits of each value of a group. width: int64 [values], numbers of bits."""
        low = np.zeros(len(width), dtype=np.int64)
        some = np.flatnonzero(width)
        if some.size:
            stream = np.repeat(np.arange(len(layout.counts)), layout.counts)[some]
            k = width[some]
            before = np.cumsum(k) - k
            total = np.bincount(stream, k, len(layout.counts)).astype(np.int64)
            local = before - (np.cumsum(total) - total)[stream] + self.raw_at[stream]
            bit = self.raw_base[stream] + np.minimum(local, self.raw_end[stream])
            byte = bit >> 3
            # Four bytes hold 16 bits that start at any bit of the first one.
            window = np.zeros(len(bit), dtype=np.int64)
            for i in range(4):
                window |= self.raw_bytes[byte + i].astype(np.int64) << (8 * i)
            low[some] = (window >> (bit & 7)) & ((np.int64(1) << k) - 1)
            self.raw_at += total
        return low

    def _escapes(self, streams: list[int]) -> Int64:
        """SPEC 8.7: reads escapes and returns n of each, negative if the sign bit is set. streams: their substreams."""
        raw, numbers = self.raw, []
        at, end, base = self.raw_at.tolist(), self.raw_end.tolist(), self.raw_base.tolist()
        for stream in streams:
            bit = min(at[stream], end[stream]) + base[stream]
            window = int.from_bytes(raw[bit >> 3 : (bit >> 3) + 8], "little") >> (bit & 7)
            after = window >> 1 & ((2 << ESCAPE_PREFIX_MAX) - 1)
            if after:
                # The lowest bit that is set ends the prefix.
                prefix = (after & -after).bit_length() - 1
                n = (1 << prefix) + (window >> (prefix + 2) & ((1 << prefix) - 1))
                at[stream] += 2 + 2 * prefix
            else:
                n = 1
                self.bad_escape[stream] = True
                at[stream] += 2 + ESCAPE_PREFIX_MAX
            numbers.append(-n if window & 1 else n)
        self.raw_at[:] = at
        return np.array(numbers, dtype=np.int64)

    def values(self, group: ValueGroup) -> Int64:
        """SPEC 8.5: decodes a group, as Coder.values. Values past the limit become 0, and `finish` reports them."""
        layout = _Layout(group.counts, self.lanes)
        model, centre, raw = select(group.mean, group.scale)
        j = self._group(group.models, model, layout)
        radius = group.models.radius.take(model)
        high = centre + j - radius
        low = self._raw(raw, layout)
        escaped = np.flatnonzero(j == 2 * radius + 1)
        if escaped.size:
            # Several substreams can have the same start. All of them but the last are empty.
            n = self._escapes((np.searchsorted(layout.starts, escaped, side="right") - 1).tolist())
            high[escaped] = centre[escaped] + n + np.sign(n) * radius[escaped]
        value = (high << raw) + low
        outside = np.flatnonzero(np.abs(value) > group.limit)
        if outside.size:
            stream_of = np.repeat(np.arange(len(group.counts)), layout.counts)
            for stream, i in zip(*np.unique(stream_of[outside], return_index=True), strict=True):
                self.bad_range.setdefault(int(stream), (int(value[outside[i]]), group.limit))
            value[outside] = 0
        self._note(value, layout)
        if self.trace:
            self._show(group.models, group.mean, group.scale, value, layout, group.name)
        return value

    def plain(
        self, models: ModelSet, index: Int64, counts: list[int], name: SymbolName, given: Int64 | None = None
    ) -> Int64:
        """SPEC 8.2: decodes a group, as SymbolCoder.plain."""
        layout = _Layout(counts, self.lanes)
        value = self._group(models, index, layout)
        self._note(value, layout)
        if self.trace:
            self._show(models, index, np.zeros_like(index), value, layout, name)
        return value

    def _show(
        self, models: ModelSet, mean: Int64, scale: Int64, value: Int64, layout: _Layout, name: SymbolName
    ) -> None:
        """Reports the symbols of a group to the trace."""
        assert self.trace is not None
        rows = zip(mean.tolist(), scale.tolist(), value.tolist(), strict=True)
        for stream, count in enumerate(layout.counts.tolist()):
            offset = self.streams[stream].offset
            for i in range(count):
                self.trace(TraceRow(name(stream, i), models.family, *next(rows), offset))

    def _note(self, value: Int64, layout: _Layout) -> None:
        """SPEC 8.8: adds the symbols of a group to the CRC-32s, in coding order, each as an i32."""
        data = value.astype("<i4")
        for stream, (start, count) in enumerate(zip(layout.starts, layout.counts, strict=True)):
            self.crc[stream] = zlib.crc32(data[start : start + count].tobytes(), self.crc[stream])

    def finish(self) -> list[BitstreamError | None]:
        """SPEC 8.8: returns for each substream the error of the first failed check at its end, or None."""
        return [self._verdict(i, s) for i, s in enumerate(self.streams)]

    def _verdict(self, i: int, s: Substream) -> BitstreamError | None:
        used = int(self.word_at[i] - self.word_end[i]) + len(s.words)
        if used != len(s.words):
            return end_error("substream.words", s, used)
        if (self.state[i] != STATE_MIN).any():
            lane = int(np.argmax(self.state[i] != STATE_MIN))
            return end_error("substream.final_state", s, lane, int(self.state[i, lane]))
        if self.bad_escape[i]:
            return end_error("substream.escape", s)
        if i in self.bad_range:
            return end_error("substream.symbol_range", s, *self.bad_range[i])
        bits = int(self.raw_at[i])
        if len(s.raw) != (bits + 7) // 8:
            return end_error("substream.raw_length", s, bits)
        if bits % 8 and s.raw[-1] >> (bits % 8):
            return end_error("substream.raw_padding", s, bits)
        if self.crc[i] != s.symbol_crc:
            return end_error("substream.symbol_crc", s, self.crc[i])
        return None


def end_error(name: str, s: Substream, first: int = 0, second: int = 0) -> BitstreamError:
    """SPEC 8.5, 8.7 and 8.8: returns the error of a check at the end of a substream.

    first, second: for words, the number that the symbols take; for final_state, a lane and its state; for
    symbol_range, a symbol and its limit; for raw_length and raw_padding, the number of raw bits that the symbols take;
    for symbol_crc, the CRC-32 of the symbols.
    """
    found: object
    allowed: object
    match name.removeprefix("substream."):
        case "words":
            found, allowed = f"word_count {len(s.words)}", f"the {first} that the symbols take"
        case "final_state":
            found, allowed = f"final state {second} of lane {first}", STATE_MIN
        case "escape":
            found, allowed = f"more than {ESCAPE_PREFIX_MAX} zero bits in a prefix", f"at most {ESCAPE_PREFIX_MAX}"
        case "symbol_range":
            found, allowed = first, f"{-second} to {second}"
        case "raw_length":
            size = (first + 7) // 8
            found, allowed = f"{len(s.raw)} raw bytes", f"the {size} that hold {first} raw bits"
        case "raw_padding":
            found, allowed = f"0x{s.raw[-1] >> (first % 8):02x} in the padding", 0
        case "symbol_crc":
            found, allowed = f"0x{s.symbol_crc:08x}", f"0x{first:08x}, that of the symbols"
        case _:
            raise RuntimeError(f"{s.path}: {name} is not an error of a substream's end")
    return BitstreamError(name, s.offset, s.path, found, allowed)


def require_limit(values: NDArray[np.integer], limit: int) -> None:
    """Raises ValueError for values to encode that exceed their limit."""
    most = max(int(values.max(initial=0)), -int(values.min(initial=0)))
    if most > limit:
        raise ValueError(f"a symbol is {most}, but at most {limit} is allowed (SPEC.md 8.5)")


class Encoder:
    """A coder that encodes a batch of substreams (SPEC B.4). It has the decoder's methods, with the symbols given."""

    count: int
    lanes: int
    crc: list[int]

    def __init__(self, count: int, lanes: int) -> None:
        """count: the number of substreams. lanes: the lanes of each."""
        self.count, self.lanes = count, lanes
        self.groups: list[tuple[NDArray[np.uint32], NDArray[np.uint32]]] = []
        self.raw: list[list[tuple[Int64, Int64]]] = [[] for _ in range(count)]
        self.crc = [0] * count

    def _group(self, models: ModelSet, index: Int64, symbol: Int64, layout: _Layout) -> None:
        position = models.offset.take(index) + symbol
        lower = models.lower.take(position)
        frequency = models.upper.take(position) - lower
        self.groups.append((layout.spread(frequency, TOTAL), layout.spread(lower, 0)))

    def values(self, group: ValueGroup) -> Int64:
        """Encodes a group, as Coder.values. Raises ValueError for a value past the limit."""
        given = group.given
        assert given is not None
        require_limit(given, group.limit)
        layout = _Layout(group.counts, self.lanes)
        model, index, away, raw = placed(group.models, group.mean, group.scale, given)
        self._group(group.models, model, index, layout)
        radius = group.models.radius.take(model)
        escaped = index > 2 * radius
        low = given & ((np.int64(1) << raw) - 1)
        for stream, (start, count) in enumerate(zip(layout.starts, layout.counts, strict=True)):
            part = slice(start, start + count)
            some = np.flatnonzero(raw[part])
            if some.size:
                self.raw[stream].append((low[part][some], raw[part][some]))
            for i in np.flatnonzero(escaped[part]):
                self.raw[stream].append(_escape_bits(int(away[part][i]), int(radius[part][i])))
            self.crc[stream] = zlib.crc32(given[part].astype("<i4").tobytes(), self.crc[stream])
        return given

    def plain(self, models: ModelSet, index: Int64, counts: list[int], name: SymbolName, given: Int64 | None) -> Int64:
        """Encodes a group, as SymbolCoder.plain."""
        assert given is not None
        layout = _Layout(counts, self.lanes)
        self._group(models, index, given, layout)
        for stream, (start, count) in enumerate(zip(layout.starts, layout.counts, strict=True)):
            self.crc[stream] = zlib.crc32(given[start : start + count].astype("<i4").tobytes(), self.crc[stream])
        return given

    def finish(self) -> list[bytes]:
        """Returns the bytes of each substream. rANS runs backwards, from the final states to the initial ones."""
        state = np.full((self.count, self.lanes), STATE_MIN, dtype=np.uint32)
        emitted: list[tuple[NDArray[np.bool_], NDArray[np.uint16]]] = []
        for frequency, lower in reversed(self.groups):
            emit = np.empty(frequency.shape, dtype=bool)
            word = np.empty(frequency.shape, dtype=np.uint16)
            for step in range(len(frequency) - 1, -1, -1):
                f = frequency[step]
                emit[step] = (state >> np.uint32(32 - PRECISION)) >= f
                word[step] = state & np.uint32(0xFFFF)
                state = np.where(emit[step], state >> np.uint32(16), state)
                quotient = state // f
                state = (quotient << np.uint32(PRECISION)) + (state - quotient * f) + lower[step]
            emitted.append((emit, word))
        emitted.reverse()
        out = []
        for stream in range(self.count):
            words = [w[:, stream][e[:, stream]] for e, w in emitted]
            flat = np.concatenate(words) if words else np.empty(0, np.uint16)
            head = syntax.build("Substream", {"symbol_crc": self.crc[stream], "word_count": len(flat)})
            out.append(
                head + state[stream].astype("<u4").tobytes() + flat.astype("<u2").tobytes() + _pack(self.raw[stream])
            )
        return out


def _escape_bits(away: int, radius: int) -> tuple[Int64, Int64]:
    """SPEC 8.7: returns the fields of one escape as (values, widths in bits)."""
    n = abs(away) - radius
    prefix = n.bit_length() - 1
    fields = [(int(away < 0), 1), (1 << prefix, prefix + 1), (n - (1 << prefix), prefix)]
    value, width = zip(*fields, strict=True)
    return np.array(value, dtype=np.int64), np.array(width, dtype=np.int64)


def _pack(fields: list[tuple[Int64, Int64]]) -> bytes:
    """SPEC 8.6: returns the bytes of fields (values, widths in bits), least significant bit first, zero padded."""
    if not fields:
        return b""
    value = np.concatenate([v for v, _ in fields])
    width = np.concatenate([w for _, w in fields])
    within = np.arange(int(width.sum())) - np.repeat(np.cumsum(width) - width, width)
    return np.packbits(((np.repeat(value, width) >> within) & 1).astype(np.uint8), bitorder="little").tobytes()
