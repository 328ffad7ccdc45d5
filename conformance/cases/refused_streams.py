"""Files with one fault in a substream: most are seen only when it has been decoded."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np

from refcodec.bitstream import codec, dimensions, directory, weights
from refcodec.bitstream.dimensions import Dimensions
from refcodec.bitstream.entropy import Encoder, SymbolName
from refcodec.bitstream.header import Lanes
from refcodec.bitstream.tables import ModelSet, tables

from .book import Book, Make, Refused
from .files import Target, lanes_of, repair, substreams, with_stream
from .numbers import Int64, Numbers
from .refused_header import plain
from .refused_sections import five_cells, grids
from .scenes import constant, scene, with_symbols
from .structure import drawn

KINDS = {
    "planes": directory.PLANES_SECTION,
    "masks": directory.MASKS,
    "attributes": directory.ATTRIBUTES,
    "positions": directory.POSITIONS,
    "weights": directory.WEIGHTS,
}
Stream = tuple[int, int, int, int]


def base(kind: str) -> Target:
    """A file with a substream of this kind."""
    return five_cells()[0] if kind == "positions" else grids() if kind == "weights" else plain()


def stream_of(t: Target, kind: str, number: int = 0) -> Stream:
    """A substream: (section, start, length, where its length is)."""
    return [s for s in substreams(t.data) if s[0] == KINDS[kind]][number]


def words_of(t: Target, stream: Stream) -> tuple[int, int, int]:
    """(number of words, where they begin, where the raw bytes do), in the file."""
    kind, start, _, _ = stream
    count = struct.unpack_from("<I", t.data, start + 4)[0]
    at = start + 8 + 4 * lanes_of(t, kind)
    return count, at, at + 2 * count


def add(book: Book) -> None:
    """Adds the vectors."""
    for kind in KINDS:
        _each(book, kind)
    _values(book)


def _each(book: Book, kind: str) -> None:
    """The faults that every kind of substream can have."""

    def add(
        klass: str, name: str, text: str, make: Callable[[Target, Stream], Refused], flags: str, number: int = 0
    ) -> None:
        def made() -> Refused:
            t = base(kind)
            return make(t, stream_of(t, kind, number))

        features = {"positions": "packed-positions", "weights": "packed-weights"}.get(kind, kind)
        book.add(
            f"{klass}-{kind}-{name}",
            f"{text}, in the {kind}",
            made,
            features=f"substream {features}",
            requirements="D8.8-1 D8.8-2",
            flags=flags,
        )

    def told(data: bytes, name: str, stream: Stream) -> Refused:
        return Refused(data, f"substream.{name}", stream[1])

    def cut(t: Target, stream: Stream) -> Refused:
        _, start, _, _ = stream
        length = 7 + 4 * lanes_of(t, stream[0])
        return told(with_stream(t, stream, t.data[start : start + length]), "length", stream)

    def head(t: Target, stream: Stream) -> Refused:
        return told(with_stream(t, stream, t.data[stream[1] : stream[1] + 7]), "length", stream)

    def counted(t: Target, stream: Stream) -> Refused:
        return told(repair(t.put(stream[1] + 4, b"\xff\xff\xff\xff")), "length", stream)

    def state(t: Target, stream: Stream) -> Refused:
        at = stream[1] + 8 + 4 * (lanes_of(t, stream[0]) - 1)
        return told(repair(t.put(at, struct.pack("<I", 0xFFFF))), "state", stream)

    def more_words(t: Target, stream: Stream) -> Refused:
        count, _, raw_at = words_of(t, stream)
        part = t.data[stream[1] : stream[1] + stream[2]]
        end = raw_at - stream[1]
        return told(
            with_stream(t, stream, part[:4] + (count + 1).to_bytes(4, "little") + part[8:end] + bytes(2) + part[end:]),
            "words",
            stream,
        )

    def fewer_words(t: Target, stream: Stream) -> Refused:
        count, _, raw_at = words_of(t, stream)
        part = t.data[stream[1] : stream[1] + stream[2]]
        end = raw_at - stream[1]
        return told(
            with_stream(t, stream, part[:4] + (count - 1).to_bytes(4, "little") + part[8 : end - 2] + part[end:]),
            "words",
            stream,
        )

    def more_raw(t: Target, stream: Stream) -> Refused:
        part = t.data[stream[1] : stream[1] + stream[2]]
        return told(with_stream(t, stream, part + b"\0"), "raw_length", stream)

    def crc(t: Target, stream: Stream) -> Refused:
        return told(repair(t.put(stream[1] + 3, bytes([t.data[stream[1] + 3] ^ 1]))), "symbol_crc", stream)

    add("malformed", "cut-in-states", "a substream that ends within its states", cut, "truncation")
    add("invalid", "word-more", "a word that no lane takes", more_words, "words-uncounted")
    add("invalid", "symbol-crc", "a CRC-32 of other symbols", crc, "symbol-crc")
    if kind != "masks":
        add("invalid", "state-below", "an initial state of 2^16 - 1", state, "limit-off-by-one initial-state")
        add("invalid", "raw-byte-more", "a raw byte that nothing reads", more_raw, "raw-length-unchecked")
    if kind in ("planes", "attributes"):
        add(
            "malformed",
            "words-beyond",
            "a word_count of 2^32 - 1",
            counted,
            "lengths-trusted sum-wraps buffer-too-small",
        )
        add("malformed", "cut-in-head", "a substream that ends within its head", head, "truncation")
        add("invalid", "word-less", "a word too few", fewer_words, "words-uncounted")
        last = 4 if kind == "planes" else 2
        add(
            "invalid",
            "last-symbol-crc",
            "a CRC-32 of other symbols, of the last substream",
            crc,
            "symbol-crc last-chunk",
            last,
        )


# --- faults that depend on values -------------------------------------------------------------------------------------

ONE = Dimensions(1, (1,), 1, 1, 2, (1,), (1,), (), 1)


@cache
def far(symbol: int, scale: int = -40) -> Target:
    """A file whose one feature is far from its mean, 0, and all else there is next to nothing."""
    zero = np.zeros(ONE.attribute_width, np.int64)
    made = scene("refused-far", 1, ONE, networks=constant(ONE, Numbers("refused-far"), zero, zero - 40))
    made.networks["hyper"][-1][1][ONE.attribute_width] = scale
    masks = np.zeros((1, 1), bool)
    made = replace(made, masks=masks, lanes=Lanes(0, 0, 0))
    return Target(codec.emit(with_symbols(made, features=np.array([[symbol]]), scalings=np.zeros((1, 6)))))


def raw_of(t: Target) -> tuple[int, int]:
    """(where the raw bytes of the attributes begin, as a number)."""
    _, _, raw_at = words_of(t, stream_of(t, "attributes"))
    return raw_at, int.from_bytes(t.data[raw_at:], "little")


def escape_of(prefix: int, low: int, negative: int = 0) -> int:
    """The bits of an escape (SPEC 8.7)."""
    return negative | 1 << (1 + prefix) | low << (2 + prefix)


def with_raw(t: Target, value: int, bits: int, name: str) -> Refused:
    """The file with other raw bytes in its attributes."""
    stream = stream_of(t, "attributes")
    raw_at, _ = raw_of(t)
    content = t.data[stream[1] : raw_at] + value.to_bytes((bits + 7) // 8, "little")
    return Refused(with_stream(t, stream, content), f"substream.{name}", stream[1])


def _values(book: Book) -> None:
    def add(name: str, text: str, make: Make, flags: str, features: str = "escapes") -> None:
        book.add(
            f"invalid-{name}",
            text,
            make,
            features=f"{features} substream",
            requirements="D8.8-1 D8.8-2 D8.7-1",
            flags=flags,
        )

    for prefix in (26, 40):
        add(
            f"escape-prefix-{prefix}",
            f"{prefix} zero bits in an escape",
            lambda prefix=prefix: with_raw(  # type: ignore[misc]
                far(1000), 1 << (1 + prefix), 2 + 2 * prefix, "escape"
            ),
            "escape-unbounded",
        )
    add(
        "escape-of-zeros",
        "an escape of zeros to the end of the substream",
        lambda: with_raw(far(1000), 0, 12, "escape"),
        "escape-unbounded raw-past-end",
    )
    for prefix in (24, 25):
        for negative in (0, 1):
            sign = "minus" if negative else "plus"
            add(
                f"escape-{sign}-2-{prefix}",
                f"an escape of {prefix} zero bits, which leads beyond every symbol",
                lambda p=prefix, n=negative: with_raw(  # type: ignore[misc]
                    far(1000), escape_of(p, 5, n), 2 + 2 * p, "symbol_range"
                ),
                "symbol-limit escape-prefix",
            )
    for negative in (0, 1):
        sign = "minus" if negative else "plus"

        def limit(negative: int = negative) -> Refused:
            # The radius of the model is 1, so that n is the symbol less one.
            n = (1 << 23) - _radius()
            return with_raw(far(1000), escape_of(22, n - (1 << 22), negative), 46, "symbol_range")

        add(f"symbol-{sign}-2-23", "an attribute symbol of magnitude 2^23", limit, "symbol-limit limit-off-by-one")

    def plane_limit() -> Refused:
        d = ONE
        made = scene("refused-plane", 0, d, lanes=Lanes(0, 0, 0))
        made.networks["sarm"][:] = [(np.zeros_like(w), np.zeros_like(b)) for w, b in made.networks["sarm"]]
        made.networks["sarm"][-1][1][1] = -40
        made.planes[:] = 0
        made.planes[2, 0, 1, 1] = 32767
        t = Target(codec.emit(made))
        stream = stream_of(t, "planes", 2)
        _, _, raw_at = words_of(t, stream)
        bits = int.from_bytes(t.data[raw_at : stream[1] + stream[2]], "little")
        # The symbol is 32767 = R + n with a prefix of 14 zeros; one more stays within them.
        more = bits + (1 << 16)
        content = t.data[stream[1] : raw_at] + more.to_bytes(stream[1] + stream[2] - raw_at, "little")
        return Refused(with_stream(t, stream, content), "substream.symbol_range", stream[1])

    add("plane-symbol-2-15", "a plane symbol of 2^15", plane_limit, "symbol-limit limit-off-by-one", "planes escapes")

    def weight_limit() -> Refused:
        t = grids()
        stream = stream_of(t, "weights")
        made = codec.parse(t.data).scene
        assert made.weight_scales is not None
        layers = [weights.to_grid(layer) for network in made.networks.values() for layer in network]
        coded = [i for i, grid in enumerate(layers) if grid is not None]
        grid = layers[coded[-1]]
        assert grid is not None
        grid.weight[0, 0] = (1 << 24) - 1
        grid.weight[1, 0] = 1 << 24
        encoder, shapes = Encoder(1, 1 << made.lanes.attribute), dimensions.layers_of(made.dimensions)
        weights.code_grids(
            Unlimited(encoder),
            [shapes[i] for i in coded],
            made.weight_scales[coded],
            [g for g in layers if g is not None],
        )
        return Refused(with_stream(t, stream, encoder.finish()[0]), "substream.symbol_range", stream[1])

    add(
        "weight-symbol-2-24",
        "an integer of a weight of 2^24",
        weight_limit,
        "symbol-limit limit-off-by-one",
        "packed-weights escapes",
    )

    def wide() -> Refused:
        # 16 raw bits: the symbol of a model is in units of 2^16, and its low bits lead over the limit.
        t = far(-(1 << 23) + 1, 160)
        stream = stream_of(t, "attributes")
        raw_at, bits = raw_of(t)
        assert bits & 0xFFFF == 1
        content = t.data[stream[1] : raw_at] + (bits & ~1).to_bytes(stream[1] + stream[2] - raw_at, "little")
        return Refused(with_stream(t, stream, content), "substream.symbol_range", stream[1])

    add("symbol-raw-minus-2-23", "raw bits that lead to -2^23", wide, "symbol-limit limit-off-by-one", "raw-bits")
    for bits in (6,):

        def padding(bits: int = bits) -> Refused:
            # An escape of 2 z + 2 bits, and one of those after it.
            t = far(_radius() + (1 << 7) + 3)
            raw_at, value = raw_of(t)
            assert len(t.data) - raw_at == 2
            t = far(_radius() + (1 << 8) + 3)
            raw_at, value = raw_of(t)
            assert len(t.data) - raw_at == 3
            return with_raw(t, value | 1 << (17 + bits), 24, "raw_padding")

        add(f"padding-{bits}", f"padding bit {bits} is set", padding, "raw-padding", "raw-bits")

    def full_padding() -> Refused:
        # 16 bits fill two bytes; a third has nothing to hold.
        t = far(_radius() + (1 << 7) + 3)
        _, value = raw_of(t)
        return with_raw(t, value, 24, "raw_length")

    add(
        "raw-byte-of-nothing",
        "a raw byte after the last bit fills the one before",
        full_padding,
        "raw-length-unchecked",
        "raw-bits",
    )

    def raw_cut() -> Refused:
        t = far(_radius() + (1 << 9) + 1)
        _, value = raw_of(t)
        return with_raw(t, value & 0xFFFF, 16, "raw_length")

    add(
        "raw-cut",
        "the last raw byte is missing; its bits read as 0",
        raw_cut,
        "raw-length-unchecked raw-past-end",
        "raw-bits",
    )

    def other_value() -> Refused:
        t = far(_radius() + (1 << 8) + 3)
        _, value = raw_of(t)
        return with_raw(t, value ^ 1, 18, "symbol_crc")

    add("raw-sign", "the sign of an escape is the other one", other_value, "symbol-crc escape-sign")

    @cache
    def idle() -> Target:
        return Target(codec.emit(drawn("refused-idle", 3, lanes=Lanes(6, 4, 8))))

    for kind in ("planes", "masks", "attributes"):

        def lane(kind: str = kind) -> Refused:
            t = idle()
            stream = stream_of(t, kind)
            at = stream[1] + 8 + 4 * (lanes_of(t, stream[0]) - 1)
            assert t.data[at : at + 4] == struct.pack("<I", 1 << 16)
            return Refused(repair(t.put(at, struct.pack("<I", (1 << 16) + 1))), "substream.final_state", stream[1])

        add(
            f"final-state-idle-{kind}",
            f"a lane that no symbol uses is not at 2^16, in the {kind}",
            lane,
            "final-state idle-lanes",
            "lanes",
        )

    def used_lane() -> Refused:
        # Of a lane whose only symbols leave it above 2^16 without a word: a state that is 2^14 more at the end.
        t = far(0)
        stream = stream_of(t, "attributes")
        assert words_of(t, stream)[0] == 0
        state = struct.unpack_from("<I", t.data, stream[1] + 8)[0]
        return Refused(repair(t.put(stream[1] + 8, struct.pack("<I", state + 2))), "substream.final_state", stream[1])

    add("final-state-used", "a lane that ends above 2^16", used_lane, "final-state", "lanes")


class Unlimited:
    """An encoder whose symbols have no limit."""

    def __init__(self, encoder: Encoder) -> None:
        self.encoder = encoder

    def values(
        self,
        models: ModelSet,
        mean: Int64,
        scale: Int64,
        counts: list[int],
        limit: int,
        name: SymbolName,
        given: Int64 | None,
    ) -> Int64:
        """A group of values."""
        return self.encoder.values(models, mean, scale, counts, 1 << 40, name, given)

    def plain(self, models: ModelSet, index: Int64, counts: list[int], name: SymbolName, given: Int64 | None) -> Int64:
        """A group of symbols."""
        return self.encoder.plain(models, index, counts, name, given)


def _radius() -> int:
    """Of the model of the least scale."""
    return int(tables().gauss.radius[8])
