"""Cases of clauses 8.4 to 8.7 and A.3: models, means, scale indices, limits of symbols, raw bits and escapes."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from refcodec.bitstream import codec
from refcodec.bitstream.attributes import ATTRIBUTE_SYMBOL_MAX, code_attributes
from refcodec.bitstream.chunks import chunk_ranges
from refcodec.bitstream.dimensions import Dimensions, layers_of
from refcodec.bitstream.entropy import ESCAPE_PREFIX_MAX, Encoder, ValueGroup, select
from refcodec.bitstream.header import Lanes
from refcodec.bitstream.planes import PLANE_SYMBOL_MAX
from refcodec.bitstream.scene import Scene
from refcodec.bitstream.tables import SCALE_MIN, tables
from refcodec.bitstream.weights import WEIGHT_SYMBOL_MAX, GridLayer

from .fault import Draw, Edit, Fault, Spec, Whole, fault
from .numbers import Int64, Numbers
from .samplers import Sampler, Sweep, sampled
from .scenes import SMALLEST, TINY_DIMENSIONS, scene, with_symbols
from .table import More, refused, valid
from .target import Target
from .targets import ATTRIBUTES_0, SEEDS, beyond, far, grids, radius, target_of
from .weights import QUIET_SARM, constant, dyadic, networks, observing, with_weights
from .weights_packed import any_grids, with_integers

# One slice of sixteen, scalings, and offsets, all of them kept.
WIDE = Dimensions(10, (16,), 1, 4, 6, (20,), (4,), (), 1)
# The numbers of the D = 52 channels.
CHANNEL = np.arange(WIDE.attribute_width)
# The largest output of a network.
LARGEST = (1 << 24) - 1

# --- faults of symbols ------------------------------------------------------------------------------------------------


class Unlimited(Encoder):
    """An encoder without limits of symbols."""

    def values(self, group: ValueGroup) -> Int64:
        """Codes a group of values."""
        return super().values(replace(group, limit=1 << 40))


@fault("substream.symbol_range")
def larger_plane_symbol(t: Target) -> Edit:
    """The magnitude of the largest plane symbol is increased by one. The raw bytes are its escape."""
    s = t.substreams["planes.r2.top_right"]
    bits = int.from_bytes(t.data[s.raw_at : s.end], "little") + (1 << 16)
    return Edit({s.raw_at: bits.to_bytes(s.end - s.raw_at, "little")}, s.start)


def _layer(draw: Draw, t: Target) -> str:
    """Draws a packed layer of several rows."""
    rows = {name: out for name, out, _ in layers_of(t.header.dimensions)}
    return draw.choice([layer for layer in t.layers[1:] if rows[layer] > 1])


@fault("substream.symbol_range", _layer, [1, -1], base=any_grids)
def large_weight(t: Target, layer: str, sign: int = 1) -> Whole:
    """A packed layer has the largest integer, and one more, in the first two rows of its first column.

    sign: -1 for those of the opposite sign.
    """

    def change(g: GridLayer) -> GridLayer:
        weight = g.weight.copy()
        weight[:2, 0] = sign * WEIGHT_SYMBOL_MAX, sign * (WEIGHT_SYMBOL_MAX + 1)
        return replace(g, weight=weight)

    return Whole(with_integers(t, layer, change, Unlimited).data, t.substreams["weights"].start)


@fault("substream.symbol_range")
def wrapping_symbol(t: Target, scale: int, value: int) -> Whole:
    """A feature overflows 32 bits to a small one with the same symbol_crc. scale: of its model."""
    encoder, none = Unlimited(1, 1), np.zeros(6, np.int64)
    # SPEC 7.10: the scalings come first.
    for mean, scales, values in ((none, none + SCALE_MIN, none), (none[:1], none[:1] + scale, np.array([value]))):
        encoder.values(ValueGroup(tables().gauss, mean, scales, [len(values)], 0, lambda *_: "", values))
    return Whole(t.with_substream(ATTRIBUTES_0, encoder.finish()[0]), t.substreams[ATTRIBUTES_0].start)


# --- faults of raw bits -----------------------------------------------------------------------------------------------


def _any_far(draw: Draw, t: Target, symbol: int = 1000) -> Target:
    return far(draw.choice([-1, 1]) * symbol, seed=draw.integer(0, SEEDS - 1))


def _partial_byte(draw: Draw, t: Target) -> Target:
    """Draws a file whose escape does not fill its last byte."""
    prefix = draw.choice([z for z in range(6, 21) if (2 * z + 2) % 8])
    return _any_far(draw, t, radius() + (1 << prefix) + draw.integer(0, (1 << prefix) - 1))


def _unused(draw: Draw, t: Target) -> int:
    """Draws an unused bit of such a file."""
    s = t.substreams[ATTRIBUTES_0]
    raw = int.from_bytes(t.data[s.raw_at : s.end], "little")
    prefix = (raw >> 1 & -(raw >> 1)).bit_length() - 1
    return draw.integer(2 * prefix + 2, 8 * (s.end - s.raw_at) - 1)


def _raw_bit(error: str, name: str, *drawn: Spec, base: Callable[[Draw, Target], Target] | None = None) -> Fault[[int]]:
    """Returns the fault that a bit of the raw bytes of the attributes is inverted. Its argument is the bit."""

    def broken(t: Target, bit: int) -> Edit:
        s = t.substreams[ATTRIBUTES_0]
        return Edit(t.flip(s.raw_at + bit // 8, 1 << bit % 8), s.start)

    return Fault(error, name, broken, drawn, base)


# An unused bit, the sign of an escape, and a raw bit of a value at the limit.
padding_bit = _raw_bit("substream.raw_padding", "padding_bit", _unused, base=_partial_byte)
other_sign = _raw_bit(
    "substream.symbol_crc", "other_sign", [0], base=lambda d, t: _any_far(d, t, radius() + d.integer(1, 9999))
)
other_raw_bits = _raw_bit("substream.symbol_range", "other_raw_bits")


def escape_of(prefix: int, low: int, negative: bool = False) -> int:
    """Returns the 2 * prefix + 2 bits of an escape (SPEC 8.7)."""
    return int(negative) | 1 << (1 + prefix) | low << (2 + prefix)


def _with_raw(t: Target, value: int, bits: int) -> Whole:
    """Returns the file with other raw bits in its attributes, padded to a byte."""
    s = t.substreams[ATTRIBUTES_0]
    raw = value.to_bytes((bits + 7) // 8, "little")
    return Whole(t.with_substream(ATTRIBUTES_0, t.data[s.start : s.raw_at] + raw), s.start)


@fault("substream.escape", (ESCAPE_PREFIX_MAX + 1, 99), base=_any_far)
def long_prefix(t: Target, prefix: int) -> Whole:
    """An escape has too many zero bits, then a 1."""
    return _with_raw(t, escape_of(prefix, 0), 2 + 2 * prefix)


@fault("substream.escape", (1, 99), base=_any_far)
def escape_of_zeros(t: Target, bits: int) -> Whole:
    """An escape consists of zeros to the end of the substream, after which bits read as 0.

    bits: of the raw bytes. A decoder reads at most the longest prefix.
    """
    return _with_raw(t, 0, bits)


def low_beyond(*_: object) -> int:
    """Returns the low bits of the first escape with 22 zero bits above the largest symbol, for the mean 0."""
    return ATTRIBUTE_SYMBOL_MAX + 1 - radius() - (1 << 22)


@fault(
    "substream.symbol_range",
    (22, ESCAPE_PREFIX_MAX),
    lambda d, t, prefix: d.integer(low_beyond() if prefix == 22 else 0, (1 << prefix) - 1),
    [False, True],
    base=_any_far,
)
def far_escape(t: Target, prefix: int, low: int, negative: bool = False, bits: int | None = None) -> Whole:
    """An escape gives a symbol above the limit. bits: of the raw bytes, if more than those of the escape."""
    return _with_raw(t, escape_of(prefix, low, negative), bits or 2 + 2 * prefix)


@fault("substream.raw_length")
def raw_byte_less(t: Target) -> Whole:
    """The last raw byte is missing. Its bits read as 0."""
    s = t.substreams[ATTRIBUTES_0]
    return Whole(t.with_substream(ATTRIBUTES_0, t.data[s.start : s.end - 1]), s.start)


# --- a coder that lies ------------------------------------------------------------------------------------------------


class Liar(Encoder):
    """A coder that draws symbols, but codes others instead of the first ones. A decoder replaces those by fixed values.

    beyond: the first feature is coded far above every limit, and later counts as 0.
    endless: 1 or -1 if the first other feature is coded as an escape of this sign with too long a prefix, and later
        counts as one beyond the radius; else 0.
    escaped: the feature after that one has a valid escape.
    """

    def __init__(self, sampler: Sampler, beyond: bool, endless: int, escaped: bool) -> None:
        super().__init__(1, 1)
        self.sampler, self.beyond, self.endless, self.escaped = sampler, beyond, endless, escaped
        # Earlier groups, of scalings and offsets.
        self.waiting = 2

    def values(self, group: ValueGroup) -> Int64:
        """Codes a group of values."""
        drawn = self.sampler.values(group)
        coded, first = drawn.copy(), self.waiting == 0
        if first:
            model, centre, raw = select(group.mean, group.scale)
            radius = group.models.radius
            assert not raw.any()
            if self.beyond:
                drawn[0], coded[0] = 0, 1 << 24
            if self.endless:
                at = int(self.beyond)
                drawn[at] = coded[at] = centre[at] + self.endless * (radius[model[at]] + 1)
                if self.escaped:
                    # Its bits read from any later one give another symbol.
                    drawn[at + 1] = coded[at + 1] = centre[at + 1] - radius[model[at + 1]] - 300
        super().values(replace(group, limit=1 << 40, given=coded))
        if first and self.endless:
            # The escape's fields: a sign, and zeros instead of the prefix.
            fields = np.array([self.endless < 0, 0], np.int64), np.array([1, ESCAPE_PREFIX_MAX + 1])
            self.raw[0][-1 - self.escaped] = fields
        self.waiting -= 1
        return drawn


def _lied(beyond: bool, endless: int, escaped: bool = False) -> Whole:
    """Returns a file of one anchor whose second slice depends on each bit of the first, with symbols of a Liar."""
    d = Dimensions(1, (2, 8), 1, 1, 2, (2,), (1,), (3,), 1)
    numbers = Numbers(f"planted-liar-{beyond:d}{endless:d}")
    network_weights = networks(d, numbers)
    network_weights["hyper"] = [(w * 0, b * 0) for w, b in network_weights["hyper"]]
    first, last = network_weights["carm.1"]
    # Units for either sign of both symbols' sum; each unit changes mean and scale.
    first[0][:], first[1][:] = np.array([[1, 1], [-1, -1], [0, 0]]), 0
    last[0][:], last[1][:] = dyadic(numbers.integers(-9, 9, *last[0].shape) * 2 + 1, 0), 0
    made = scene(
        "planted-liar", 1, d, networks=network_weights, carm_shift=np.zeros(2, np.uint8), masks=np.ones((1, 1), bool)
    )
    made = replace(made, lanes=Lanes(0, 0, 0))
    coding, liar = codec.Coding(made), Liar(Sampler(numbers, 0), beyond, endless, escaped)
    code_attributes(liar, coding.model, coding.contexts(), made.masks, chunk_ranges(1, made.chunk_size))
    t = Target(codec.emit(made))
    return Whole(t.with_substream(ATTRIBUTES_0, liar.finish()[0]), t.substreams[ATTRIBUTES_0].start)


@fault("substream.symbol_range")
def beyond_then_more(t: Target) -> Whole:
    """A symbol is beyond the limit, and the models of others depend on its being 0. The file is another one."""
    return _lied(True, 0)


@fault("substream.escape")
def endless_then_more(t: Target, sign: int, beyond: bool = False, escaped: bool = False) -> Whole:
    """An escape has too long a prefix, and the models of others depend on it. The file is another one.

    sign, beyond, escaped: as of Liar.
    """
    return _lied(beyond, sign, escaped)


# --- valid files ------------------------------------------------------------------------------------------------------


@target_of
def _largest_plane_symbol(sign: int = 1) -> Scene:
    """A file whose only nonzero plane symbol is the largest, times sign: an escape with 14 zero bits."""
    made = with_weights(scene("refused-plane", 0, SMALLEST, lanes=Lanes(0, 0, 0)), *QUIET_SARM)
    made.planes[:] = 0
    made.planes[2, 0, 1, 1] = sign * PLANE_SYMBOL_MAX
    return made


def spread(
    name: str,
    mean: Int64,
    scale: Int64,
    anchors: int = 12,
    coder: Sampler | int = 0,
    lanes: Lanes | None = None,
    symbols: str = "",
) -> Scene:
    """Returns a scene of WIDE with given means and scale indices of channels, the same for each anchor.

    coder: draws the symbols; a number is that of a Sampler's escapes. symbols: the name of its Numbers.
    """
    network_weights, masks = constant(WIDE, Numbers(name), mean, scale), np.ones((anchors, WIDE.offset_count), bool)
    made = scene(name, anchors, WIDE, networks=network_weights, masks=masks)
    coder = Sampler(Numbers(symbols or f"{name}/symbols"), coder) if isinstance(coder, int) else coder
    return sampled(replace(made, lanes=lanes or made.lanes), coder, planes=False)


def _gauss() -> Scene:
    numbers = Numbers("models-gauss")
    d = Dimensions(10, (16, 16), 1, 4, 6, (20,), (4,), (1,), 1)
    network_weights = observing(d, numbers)
    total = d.attribute_width
    w, b = network_weights["hyper"][-1]
    # Each channel has one or two rows in turn. The columns follow from the context.
    b[total : 2 * total] = SCALE_MIN + np.arange(total) % 64
    w[total : total + 8, 0] = 2.0**-5
    return sampled(
        scene("models-gauss", 330, d, networks=network_weights, masks=np.ones((330, 10), bool)), Sweep(numbers)
    )


def _laplace() -> Scene:
    numbers = Numbers("models-laplace")
    d = Dimensions(1, (1,), 8, 1, 24, (1,), (2,), (), 1)
    network_weights = networks(d, numbers)
    # The left neighbour and one above determine the scale index, the others the mean. Both are bounded.
    first = np.array([[16, 0, 0, 112], [0, 80, 16, 0]], np.float32)
    network_weights["sarm"] = [
        (first, np.array([512, 512], np.float32)),
        (np.array([[0, 1 / 16], [1 / 16, 0]], np.float32), np.array([-32, SCALE_MIN], np.float32)),
    ]
    return sampled(scene("models-laplace", 1, d, networks=network_weights, lanes=Lanes(2, 0, 0)), Sweep(numbers))


def _of_numbers(name: str, largest: int, scale: Int64, anchors: int, escapes: int, lanes: Lanes | None = None) -> Scene:
    """Returns a scene with means up to a largest one, whose symbols continue the sequence of numbers."""
    numbers = Numbers(name)
    mean = numbers.integers(-largest, largest, len(CHANNEL))
    return spread(name, mean, scale, anchors, Sampler(numbers, escapes), lanes)


def _largest_sums() -> Scene:
    d = Dimensions(1, (2, 6), 1, 1, 2, (2,), (2,), (2,), 1)
    numbers, most = Numbers("means-sums"), LARGEST
    mean, scale = np.zeros(d.attribute_width, np.int64), np.zeros(d.attribute_width, np.int64)
    mean[2:8] = most, -most, most, 5, -most, 100
    scale[2:8] = 0, 10, most, most, -most, -most
    network_weights = constant(d, numbers, mean, scale)
    network_weights["carm.1"][-1][1][:] = [most, -most, -most, 7, most, -3, 0, -10, -most, most, most, -most]
    return sampled(scene("means-sums", 9, d, networks=network_weights), Sampler(numbers, 8))


def _about_powers(limit: int) -> Int64:
    """Returns values of either sign around each power of two, up to the limit."""
    bounds = {v + o for z in range(limit.bit_length()) for v in (1 << z, (2 << z) - 1) for o in (0, 1)}
    bounds |= {limit, limit - 1}
    return np.array(sorted({s * v for v in bounds if v <= limit for s in (1, -1)}), dtype=np.int64)


def _escaped_attributes() -> Scene:
    d, values = Dimensions(1, (16,), 1, 1, 2, (1,), (1,), (), 1), _about_powers(ATTRIBUTE_SYMBOL_MAX)
    count = -(-len(values) // 16)
    made = scene("escapes-attributes", count, d, networks=constant(d, Numbers("escapes")))
    return with_symbols(made, features=np.resize(values, (count, 16)))


def _escaped_planes() -> Scene:
    made = with_weights(scene("escapes-planes", 2, replace(TINY_DIMENSIONS, plane_size=8)), QUIET_SARM[0])
    values = np.resize(_about_powers(PLANE_SYMBOL_MAX), made.planes.shape).astype(np.int16)
    return with_symbols(replace(made, planes=values))


def _padding() -> Scene:
    scale = np.array([31] * 5 + [0] * (SMALLEST.attribute_width - 5))
    values = np.zeros((16, 6), np.int64)
    values[1::2, 5] = 1 << np.arange(1, 16, 2)
    network_weights = constant(SMALLEST, Numbers("padding"), 0, scale)
    made = scene("padding", 16, SMALLEST, networks=network_weights, chunk_size=1)
    return with_symbols(made, features=np.zeros((16, 1)), scalings=values)


# fmt: off
_END, _LIMIT = "D8.8-1 D8.8-2 D8.7-1", "symbol-limit limit-off-by-one"
_SCALE_ENDS = np.array([-41, -40, -39, 22, 23, 24, -(1 << 23), -1000])[CHANNEL % 8]
# Row 23 without raw bits, then the first and the last row for each number of raw bits, and beyond the last.
_WIDTHS = np.resize([23, *(16 + 8 * k + e for k in range(1, 17) for e in (0, 7)), 152, 160, 255, 1000, LARGEST], 52)
_MEANS = np.array([LARGEST, -LARGEST, LARGEST - 8, 8 - LARGEST, 7, 8, -8, -9])[CHANNEL % 8]
# With k raw bits a mean is rounded at 2^(k - 1) of its sixteenths.
_K = CHANNEL % 6 + 1
_TIES = (CHANNEL - len(CHANNEL) // 2) * (1 << _K) + ((1 << _K) >> 1) + 8 * ((1 << _K) - 1)
_far_1000 = partial(far, 1000)
# Escapes of 18 bits, and of 20.
_far_18, _far_20 = partial(beyond, (1 << 8) + 3), partial(beyond, 513)
CASES = [
    *refused("planes escapes substream", _LIMIT,
        ("plane-symbol-2-15", "a plane symbol of 2^15", _largest_plane_symbol, larger_plane_symbol),
        ("plane-symbol-minus-2-15", "a plane symbol of -2^15, which 16 bits hold", partial(_largest_plane_symbol, -1),
         larger_plane_symbol), requirements=_END),
    *refused("packed-weights escapes substream", _LIMIT,
        ("weight-symbol-2-24", "an integer of a weight of 2^24", grids, large_weight, "colour.1"),
        ("weight-symbol-minus-2-24", "an integer of a weight of -2^24", grids, large_weight, "colour.1", -1),
        requirements=_END),
    # 16 raw bits: the symbol of a model is in units of 2^16, and its low bits exceed the limit.
    *refused("raw-bits substream", _LIMIT,
        ("symbol-raw-minus-2-23", "raw bits that lead to -2^23", partial(far, -ATTRIBUTE_SYMBOL_MAX, 160),
         other_raw_bits, 0), requirements=_END),
    *refused("escapes raw-bits substream", "symbol-wraps symbol-limit", *(
        (f"symbol-wraps-{name}", f"an escaped symbol of {text}, which is a small one in 32 bits",
         partial(far, 0, scale), wrapping_symbol, scale, value)
        for name, text, scale, value in (
            ("2-32-and-5", "2^32 and 5", 160, (1 << 32) + 5), ("minus-2-33-and-7", "-2^33 and 7", 160, 7 - (1 << 33)),
            ("2-32-less-9", "2^32 less 9", 80, (1 << 32) - 9))), requirements="D8.5-1 D8.8-2"),
    *valid("models escapes", "table-rows table-columns symbol-search", "D8.2-1 D8.5-1 D8.7-1 DA-1",
        ("models-gauss",
         "symbols of all rows and columns of the Gaussian family, the ends and the escape of each first", _gauss),
        ("models-laplace",
         "symbols of the rows and columns of the Laplace family, the ends and the escape of each first", _laplace,
         More(features="planes"))),
    *valid("models", "scale-clamp", "D8.5-1 DA-1",
        ("models-ends", "scale indices at and beyond both ends of the families", spread, "models-ends",
         3 * CHANNEL - 70, _SCALE_ENDS, 30, 40)),
    *valid("raw-bits escapes", "raw-width raw-before-escapes scale-clamp symbol-limit", "D8.5-1 D8.6-1 D8.7-1",
        ("raw-widths", "0 to 16 raw bits, each at both ends of its scale indices", spread, "raw-widths",
         Numbers("raw-widths").integers(-200, 200, len(CHANNEL)), _WIDTHS, 20, 12)),
    *valid("raw-bits models", "select-rounding raw-width", "D8.5-1 D8.6-1",
        ("raw-means", "means of wide distributions, whose low bits are raw", _of_numbers, "raw-means", 50000,
         CHANNEL * 3 - 20, 20, 20)),
    *valid("models networks", "mean-width select-rounding", "D8.5-1 D7.2-1",
        ("means-largest", "the largest means that F_h can have", spread, "means-largest", _MEANS,
         np.array([-40, 0, 23, 60, 100])[CHANNEL % 5], 12, 9, None, "means/symbols")),
    *valid("carm models", "mean-width carm-ignored", "D7.9-1 D8.5-1",
        ("means-sums", "the largest sums of outputs of F_h and CARM", _largest_sums)),
    *valid("raw-bits models", "select-rounding", "D8.5-1",
        ("select-ties", "means that are ties once the raw bits are gone", spread, "select-ties", _TIES, 16 + 8 * _K,
         16)),

    *refused("escapes substream", "escape-unbounded",
        *((f"escape-prefix-{prefix}", f"{prefix} zero bits in an escape", _far_1000, long_prefix, prefix)
          for prefix in (ESCAPE_PREFIX_MAX + 1, ESCAPE_PREFIX_MAX + 2, 40)),
        ("escape-of-zeros", "an escape of zeros to the end of the substream", _far_1000, escape_of_zeros, 12,
         More("raw-past-end")), requirements=_END),
    *refused("escapes substream", "symbol-crc escape-sign",
        ("raw-sign", "the sign of an escape is the other one", _far_18, other_sign, 0), requirements=_END),
    *refused("escapes substream", "symbol-limit escape-prefix", *(
        (f"escape-{sign}-2-23-{name}",
         f"an escape of {ESCAPE_PREFIX_MAX} zero bits, which leads beyond every attribute: the {name} one", _far_1000,
         far_escape, ESCAPE_PREFIX_MAX, low, sign == "minus")
        for sign in ("plus", "minus") for low, name in ((0, "least"), ((1 << ESCAPE_PREFIX_MAX) - 1, "largest"))),
        requirements=_END),
    *refused("escapes substream", "symbol-limit limit-off-by-one", *(
        (f"symbol-{sign}-2-23", "an attribute symbol of magnitude 2^23", _far_1000, far_escape, 22, low_beyond,
         sign == "minus") for sign in ("plus", "minus")), requirements=_END),
    *refused("substream escapes carm", "",
        ("range-then-more", "a symbol beyond the limit, and others whose models depend on its being 0",
         beyond_then_more, More("symbol-limit")),
        ("escape-then-more", "an escape whose prefix is too long, and others whose models depend on it",
         endless_then_more, 1, More("escape-unbounded")),
        ("escape-minus-then-more",
         "a negative escape whose prefix is too long, and others whose models depend on its sign", endless_then_more,
         -1, More("escape-unbounded escape-sign")),
        ("escape-then-escape",
         "an escape whose prefix is too long, directly after it a valid one, and others whose models depend on both",
         endless_then_more, 1, False, True, More("escape-unbounded escape-prefix")),
        ("order-of-escape-and-range", "a symbol beyond the limit, and an escape whose prefix is too long",
         endless_then_more, 1, True, More("order-of-checks")),
        requirements="D8.8-1 D8.8-2 D10.2-3"),
    # An escape whose prefix is z zeros takes 2 z + 2 bits.
    *refused("raw-bits substream", "raw-padding",
        ("padding-6", "padding bit 6 is set", _far_18, padding_bit, 23), requirements=_END),
    *refused("raw-bits substream", "raw-length-unchecked raw-past-end",
        ("raw-cut", "the last raw byte is missing; its bits read as 0", _far_20, raw_byte_less), requirements=_END),
    *valid("escapes", "escape-prefix escape-sign escape-offset symbol-limit", "D8.7-1 R8.5-1 R8.7-1",
        ("escapes-attributes", "attribute symbols about each power of two, to the largest", _escaped_attributes)),
    *valid("escapes planes", "escape-prefix escape-sign escape-offset symbol-limit", "D8.7-1 R8.5-1",
        ("escapes-planes", "plane symbols about each power of two, to the largest", _escaped_planes)),
    *valid("escapes raw-bits lanes", "raw-before-escapes escape-raw-bits", "D8.6-1 D8.7-1 D8.5-1",
        ("escapes-raw", "groups with many raw fields and many escapes", _of_numbers, "escapes-raw", 500,
         30 + CHANNEL % 40, 14, 3, Lanes(0, 0, 3))),
    *valid("raw-bits escapes chunks", "raw-padding", "D8.6-1 R8.8-3 R8.8-4",
        ("padding", "raw bits that end at each place of a byte", _padding)),
]
