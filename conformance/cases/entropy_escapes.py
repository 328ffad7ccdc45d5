"""Cases of clauses 8.6 and 8.7: raw bits and escapes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache, partial

import numpy as np

from refcodec.bitstream import codec
from refcodec.bitstream.attributes import ATTRIBUTE_SYMBOL_MAX, code_attributes
from refcodec.bitstream.chunks import chunk_ranges
from refcodec.bitstream.dimensions import Dimensions
from refcodec.bitstream.entropy import ESCAPE_PREFIX_MAX, Encoder, SymbolName, select
from refcodec.bitstream.header import Lanes
from refcodec.bitstream.planes import PLANE_SYMBOL_MAX
from refcodec.bitstream.scene import Scene
from refcodec.bitstream.tables import ModelSet

from .book import Book
from .entropy_values import CHANNEL, spread
from .fault import Draw, Drawn, Edit, Refused, Whole, fault
from .numbers import Int64, Numbers
from .samplers import Sampler
from .scenes import SMALLEST, TINY_DIMENSIONS, constant, dyadic, networks, scene, silent, with_symbols
from .target import Target
from .targets import ATTRIBUTES_0, SEEDS, far, radius

# --- faults -----------------------------------------------------------------------------------------------------------


def escape_of(prefix: int, low: int, negative: bool = False) -> int:
    """Returns the 2 * prefix + 2 bits of an escape (SPEC 8.7)."""
    return int(negative) | 1 << (1 + prefix) | low << (2 + prefix)


def _with_raw(t: Target, value: int, bits: int) -> Whole:
    """Returns the file with other raw bits in its attributes, padded to a byte."""
    s = t.substreams[ATTRIBUTES_0]
    raw = value.to_bytes((bits + 7) // 8, "little")
    return Whole(t.with_substream(ATTRIBUTES_0, t.data[s.start : s.raw_at] + raw), s.start)


def _any_far(draw: Draw, symbol: int) -> Target:
    return far(draw.choice([-1, 1]) * symbol, seed=draw.integer(0, SEEDS - 1))


@fault("substream.escape")
def long_prefix(t: Target, prefix: int) -> Whole:
    """An escape has too many zero bits, then a 1."""
    return _with_raw(t, escape_of(prefix, 0), 2 + 2 * prefix)


@long_prefix.drawn
def _(draw: Draw, t: Target) -> Drawn:
    return _any_far(draw, 1000), draw.integer(ESCAPE_PREFIX_MAX + 1, 99)


@fault("substream.escape")
def escape_of_zeros(t: Target, bits: int) -> Whole:
    """An escape consists of zeros to the end of the substream, after which bits read as 0.

    bits: of the raw bytes. A decoder reads at most the longest prefix.
    """
    return _with_raw(t, 0, bits)


@escape_of_zeros.drawn
def _(draw: Draw, t: Target) -> Drawn:
    return _any_far(draw, 1000), draw.integer(1, 99)


@fault("substream.symbol_range")
def far_escape(t: Target, prefix: int, low: int, negative: bool = False, bits: int | None = None) -> Whole:
    """An escape gives a symbol above the limit. bits: of the raw bytes, if more than those of the escape."""
    return _with_raw(t, escape_of(prefix, low, negative), bits or 2 + 2 * prefix)


@far_escape.drawn
def _(draw: Draw, t: Target) -> Drawn:
    prefix = draw.integer(22, ESCAPE_PREFIX_MAX)
    least = low_beyond() if prefix == 22 else 0
    return _any_far(draw, 1000), prefix, draw.integer(least, (1 << prefix) - 1), draw.flag()


def low_beyond() -> int:
    """Returns the low bits of the first escape with 22 zero bits above the largest symbol, for the mean 0."""
    return ATTRIBUTE_SYMBOL_MAX + 1 - radius() - (1 << 22)


@fault("substream.raw_padding")
def padding_bit(t: Target, bit: int) -> Edit:
    """An unused bit of the last raw byte is 1."""
    s = t.substreams[ATTRIBUTES_0]
    return Edit(t.flip(s.raw_at + bit // 8, 1 << bit % 8), s.start)


@padding_bit.drawn
def _(draw: Draw, t: Target) -> Drawn:
    prefix = draw.choice([z for z in range(6, 21) if (2 * z + 2) % 8])
    t = _any_far(draw, radius() + (1 << prefix) + draw.integer(0, (1 << prefix) - 1))
    s = t.substreams[ATTRIBUTES_0]
    return t, draw.integer(2 * prefix + 2, 8 * (s.end - s.raw_at) - 1)


@fault("substream.raw_length")
def raw_byte_less(t: Target) -> Whole:
    """The last raw byte is missing. Its bits read as 0."""
    s = t.substreams[ATTRIBUTES_0]
    return Whole(t.with_substream(ATTRIBUTES_0, t.data[s.start : s.end - 1]), s.start)


@fault("substream.symbol_crc")
def other_sign(t: Target) -> Edit:
    """The sign of an escape is inverted."""
    s = t.substreams[ATTRIBUTES_0]
    return Edit(t.flip(s.raw_at, 1), s.start)


@other_sign.drawn
def _(draw: Draw, t: Target) -> Drawn:
    return (_any_far(draw, radius() + draw.integer(1, 9999)),)


# --- a coder that lies ------------------------------------------------------------------------------------------------


@dataclass
class Liar:
    """A coder that draws symbols, but codes others instead of the first ones. A decoder replaces those by fixed values.

    beyond: the first feature is coded far above every limit, and later counts as 0.
    endless: 1 or -1 if the first other feature is coded as an escape of this sign with too long a prefix, and later
        counts as one beyond the radius; else 0.
    escaped: the feature after that one has a valid escape.
    waiting: earlier groups, of scalings and offsets.
    """

    encoder: Encoder
    sampler: Sampler
    beyond: bool
    endless: int
    escaped: bool = False
    waiting: int = 2

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
        """Codes a group of values."""
        found = self.sampler.values(models, mean, scale, counts, limit, name, given)
        coded, first = found.copy(), self.waiting == 0
        if first:
            model, centre, raw = select(mean, scale)
            assert not raw.any()
            if self.beyond:
                found[0], coded[0] = 0, 1 << 24
            if self.endless:
                at = int(self.beyond)
                found[at] = coded[at] = centre[at] + self.endless * (models.radius[model[at]] + 1)
                if self.escaped:
                    # Its bits read from any later one give another symbol.
                    found[at + 1] = coded[at + 1] = centre[at + 1] - models.radius[model[at + 1]] - 300
        self.encoder.values(models, mean, scale, counts, 1 << 40, name, coded)
        if first and self.endless:
            # The escape's fields: a sign, and zeros instead of the prefix.
            fields = np.array([self.endless < 0, 0], np.int64), np.array([1, ESCAPE_PREFIX_MAX + 1])
            self.encoder.raw[0][-1 - self.escaped] = fields
        self.waiting -= 1
        return found

    def plain(self, models: ModelSet, index: Int64, counts: list[int], name: SymbolName, given: Int64 | None) -> Int64:
        """Codes no symbols of these kinds."""
        raise NotImplementedError


@cache
def _lied(beyond: bool, endless: int, escaped: bool = False) -> Refused:
    """Returns a file of one anchor whose second slice depends on each bit of the first, with symbols of a Liar."""
    d = Dimensions(1, (2, 8), 1, 1, 2, (2,), (1,), (3,), 1)
    numbers = Numbers(f"planted-liar-{beyond:d}{endless:d}")
    found = networks(d, numbers)
    found["hyper"] = [(w * 0, b * 0) for w, b in found["hyper"]]
    first, last = found["carm.1"]
    # Units for either sign of both symbols' sum; each unit changes mean and scale.
    first[0][:], first[1][:] = np.array([[1, 1], [-1, -1], [0, 0]]), 0
    last[0][:], last[1][:] = dyadic(numbers.integers(-9, 9, *last[0].shape) * 2 + 1, 0), 0
    made = scene(
        "planted-liar",
        1,
        d,
        networks=found,
        carm_shift=np.zeros(2, np.uint8),
        lanes=Lanes(0, 0, 0),
        masks=np.ones((1, 1), bool),
    )
    coding, encoder = codec.Coding(made), Encoder(1, 1)
    liar, chunks = Liar(encoder, Sampler(numbers, 0), beyond, endless, escaped), chunk_ranges(1, made.chunk_size)
    code_attributes(liar, coding.model, coding.contexts(), made.masks, chunks)
    t = Target(codec.emit(made))
    name = "substream.escape" if endless else "substream.symbol_range"
    return Refused(t.with_substream(ATTRIBUTES_0, encoder.finish()[0]), name, t.substreams[ATTRIBUTES_0].start)


# --- the suite's ------------------------------------------------------------------------------------------------------


def add(book: Book) -> None:
    """Adds the vectors."""
    _refused_escapes(book)
    _refused_raw_bits(book)
    _valid(book)


def _refused_escapes(book: Book) -> None:
    add = partial(book.add, features="escapes substream", requirements="D8.8-1 D8.8-2 D8.7-1")
    usual = partial(far, 1000)
    for prefix in (ESCAPE_PREFIX_MAX + 1, ESCAPE_PREFIX_MAX + 2, 40):
        title, make = f"{prefix} zero bits in an escape", long_prefix.of(usual, prefix)
        add(f"invalid-escape-prefix-{prefix}", title, make, flags="escape-unbounded")
    title, make = "an escape of zeros to the end of the substream", escape_of_zeros.of(usual, 12)
    add("invalid-escape-of-zeros", title, make, flags="escape-unbounded raw-past-end")
    title = "the sign of an escape is the other one"
    make = other_sign.of(partial(far, radius() + (1 << 8) + 3))
    add("invalid-raw-sign", title, make, flags="symbol-crc escape-sign")
    for negative, sign in ((False, "plus"), (True, "minus")):
        for low, name in ((0, "least"), ((1 << ESCAPE_PREFIX_MAX) - 1, "largest")):
            title = f"an escape of {ESCAPE_PREFIX_MAX} zero bits, which leads beyond every attribute: the {name} one"
            make = far_escape.of(usual, ESCAPE_PREFIX_MAX, low, negative)
            add(f"invalid-escape-{sign}-2-23-{name}", title, make, flags="symbol-limit escape-prefix")
        title, make = "an attribute symbol of magnitude 2^23", far_escape.of(usual, 22, low_beyond(), negative)
        add(f"invalid-symbol-{sign}-2-23", title, make, flags="symbol-limit limit-off-by-one")
    rows: list[tuple[str, str, bool, int, bool, str]] = [
        (
            "range-then-more",
            "a symbol beyond the limit, and others whose models depend on its being 0",
            True,
            0,
            False,
            "symbol-limit",
        ),
        (
            "escape-then-more",
            "an escape whose prefix is too long, and others whose models depend on it",
            False,
            1,
            False,
            "escape-unbounded",
        ),
        (
            "escape-minus-then-more",
            "a negative escape whose prefix is too long, and others whose models depend on its sign",
            False,
            -1,
            False,
            "escape-unbounded escape-sign",
        ),
        (
            "escape-then-escape",
            "an escape whose prefix is too long, directly after it a valid one, and others whose models depend on both",
            False,
            1,
            True,
            "escape-unbounded escape-prefix",
        ),
        (
            "order-of-escape-and-range",
            "a symbol beyond the limit, and an escape whose prefix is too long",
            True,
            1,
            False,
            "order-of-checks",
        ),
    ]
    for name, title, beyond, endless, escaped, flags in rows:
        book.add(
            f"invalid-{name}",
            title,
            partial(_lied, beyond, endless, escaped),
            features="substream escapes carm",
            requirements="D8.8-1 D8.8-2 D10.2-3",
            flags=flags,
        )


def _refused_raw_bits(book: Book) -> None:
    add = partial(book.add, features="raw-bits substream", requirements="D8.8-1 D8.8-2 D8.7-1")
    # An escape whose prefix is z zeros takes 2 z + 2 bits.
    title, make = "padding bit 6 is set", padding_bit.of(partial(far, radius() + (1 << 8) + 3), 23)
    add("invalid-padding-6", title, make, flags="raw-padding")
    title, make = "the last raw byte is missing; its bits read as 0", raw_byte_less.of(partial(far, radius() + 513))
    add("invalid-raw-cut", title, make, flags="raw-length-unchecked raw-past-end")


def _valid(book: Book) -> None:
    book.valid(
        "escapes-attributes",
        "attribute symbols about each power of two, to the largest",
        _escaped_attributes,
        features="escapes",
        requirements="D8.7-1 R8.5-1 R8.7-1",
        flags="escape-prefix escape-sign escape-offset symbol-limit",
    )
    book.valid(
        "escapes-planes",
        "plane symbols about each power of two, to the largest",
        _escaped_planes,
        features="escapes planes",
        requirements="D8.7-1 R8.5-1",
        flags="escape-prefix escape-sign escape-offset symbol-limit",
    )
    book.valid(
        "escapes-raw",
        "groups with many raw fields and many escapes",
        _escapes_among_raw_bits,
        features="escapes raw-bits lanes",
        requirements="D8.6-1 D8.7-1 D8.5-1",
        flags="raw-before-escapes escape-raw-bits",
    )
    book.valid(
        "padding",
        "raw bits that end at each place of a byte",
        _padding,
        features="raw-bits escapes chunks",
        requirements="D8.6-1 R8.8-3 R8.8-4",
        flags="raw-padding",
    )


def _about_powers(limit: int) -> Int64:
    """Returns values of either sign around each power of two, up to the limit."""
    found = {v + o for z in range(limit.bit_length()) for v in (1 << z, (2 << z) - 1) for o in (0, 1)}
    found |= {limit, limit - 1}
    return np.array(sorted({s * v for v in found if v <= limit for s in (1, -1)}), dtype=np.int64)


def _escaped_attributes() -> Scene:
    d = Dimensions(1, (16,), 1, 1, 2, (1,), (1,), (), 1)
    values = _about_powers(ATTRIBUTE_SYMBOL_MAX)
    count = -(-len(values) // 16)
    zero = np.zeros(d.attribute_width, np.int64)
    made = scene("escapes-attributes", count, d, networks=constant(d, Numbers("escapes"), zero, zero - 40))
    return with_symbols(made, features=np.resize(values, (count, 16)))


def _escaped_planes() -> Scene:
    made = scene("escapes-planes", 2, replace(TINY_DIMENSIONS, plane_size=8))
    made.networks["sarm"][:] = silent(made.networks["sarm"])
    values = np.resize(_about_powers(PLANE_SYMBOL_MAX), made.planes.shape).astype(np.int16)
    return with_symbols(replace(made, planes=values))


def _escapes_among_raw_bits() -> Scene:
    numbers = Numbers("escapes-raw")
    mean = numbers.integers(-500, 500, len(CHANNEL))
    return spread("escapes-raw", mean, 30 + CHANNEL % 40, Sampler(numbers, 3), 14, lanes=Lanes(0, 0, 3))


def _padding() -> Scene:
    zero = np.zeros(SMALLEST.attribute_width, np.int64)
    scale = zero + np.array([31] * 5 + [0] * (len(zero) - 5))
    values = np.zeros((16, 6), np.int64)
    for n in range(1, 16, 2):
        values[n, 5] = 1 << n
    found = constant(SMALLEST, Numbers("padding"), zero, scale)
    made = scene("padding", 16, SMALLEST, networks=found, chunk_size=1)
    return with_symbols(made, features=np.zeros((16, 1)), scalings=values)
