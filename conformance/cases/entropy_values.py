"""Cases of clauses 8.4, 8.5 and A.3: models, means, scale indices, and the limits of symbols."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache, partial

import numpy as np

from refcodec.bitstream import codec
from refcodec.bitstream.attributes import ATTRIBUTE_SYMBOL_MAX
from refcodec.bitstream.dimensions import Dimensions, layers_of
from refcodec.bitstream.entropy import Encoder, SymbolName
from refcodec.bitstream.header import Lanes
from refcodec.bitstream.planes import PLANE_SYMBOL_MAX
from refcodec.bitstream.scene import Scene
from refcodec.bitstream.tables import SCALE_MIN, ModelSet, tables
from refcodec.bitstream.weights import WEIGHT_SYMBOL_MAX, GridLayer

from .book import Book
from .fault import Draw, Drawn, Edit, Whole, fault
from .numbers import Int64, Numbers
from .samplers import Sampler, Sweep, sampled
from .scenes import SMALLEST, constant, networks, observing, scene, silent
from .target import Target
from .targets import ATTRIBUTES_0, SEEDS, far, grids
from .weights_packed import with_integers

# One slice of sixteen, scalings, and offsets, all of them kept.
WIDE = Dimensions(10, (16,), 1, 4, 6, (20,), (4,), (), 1)
# The numbers of the D = 52 channels.
CHANNEL = np.arange(WIDE.attribute_width)


# --- faults -----------------------------------------------------------------------------------------------------------


@dataclass
class Unlimited:
    """An encoder without limits of symbols."""

    encoder: Encoder

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
        return self.encoder.values(models, mean, scale, counts, 1 << 40, name, given)

    def plain(self, models: ModelSet, index: Int64, counts: list[int], name: SymbolName, given: Int64 | None) -> Int64:
        """Codes a group of symbols."""
        return self.encoder.plain(models, index, counts, name, given)


# The sub-plane with a symbol in the file of larger_plane_symbol.
PLANE_2 = "planes.r2.top_right"


@fault("substream.symbol_range")
def larger_plane_symbol(t: Target) -> Edit:
    """The magnitude of the largest plane symbol is increased by one. The raw bytes are its escape."""
    s = t.substreams[PLANE_2]
    bits = int.from_bytes(t.data[s.raw_at : s.end], "little") + (1 << 16)
    return Edit({s.raw_at: bits.to_bytes(s.end - s.raw_at, "little")}, s.start)


@fault("substream.symbol_range")
def large_weight(t: Target, layer: str, sign: int = 1) -> Whole:
    """A packed layer has the largest integer, and one more, in the first two rows of its first column.

    sign: -1 for those of the opposite sign.
    """

    def change(g: GridLayer) -> GridLayer:
        weight = g.weight.copy()
        weight[:2, 0] = sign * WEIGHT_SYMBOL_MAX, sign * (WEIGHT_SYMBOL_MAX + 1)
        return replace(g, weight=weight)

    return Whole(with_integers(t, layer, change, Unlimited).data, t.substreams["weights"].start)


@large_weight.drawn
def _(draw: Draw, t: Target) -> Drawn:
    t = grids(draw.integer(0, SEEDS - 1))
    rows = {name: out for name, out, _ in layers_of(t.header.dimensions)}
    return t, draw.choice([layer for layer in t.layers[1:] if rows[layer] > 1]), draw.choice([1, -1])


@fault("substream.symbol_range")
def other_raw_bits(t: Target, bits: int) -> Edit:
    """Raw bits of a wide distribution give a symbol above the limit. bits: the flipped bits."""
    s = t.substreams[ATTRIBUTES_0]
    return Edit(t.flip(s.raw_at, bits), s.start)


@fault("substream.symbol_range")
def wrapping_symbol(t: Target, scale: int, value: int) -> Whole:
    """A feature overflows 32 bits to a small one with the same symbol_crc. scale: of its model."""
    encoder, gauss, none = Encoder(1, 1), tables().gauss, np.zeros(6, np.int64)
    # SPEC 7.10: the scalings come first.
    encoder.values(gauss, none, none + SCALE_MIN, [6], 1 << 40, _numbered, none)
    encoder.values(gauss, none[:1], none[:1] + scale, [1], 1 << 40, _numbered, np.array([value]))
    return Whole(t.with_substream(ATTRIBUTES_0, encoder.finish()[0]), t.substreams[ATTRIBUTES_0].start)


def _numbered(stream: int, index: int) -> str:
    return str(index)


# --- the suite's ------------------------------------------------------------------------------------------------------


def add(book: Book) -> None:
    """Adds the vectors."""
    _refused_symbols(book)
    _models(book)
    _ranges(book)


@cache
def _largest_plane_symbol(sign: int = 1) -> Target:
    """Returns a file whose only nonzero plane symbol is the largest, times sign: an escape with 14 zero bits."""
    made = scene("refused-plane", 0, SMALLEST, lanes=Lanes(0, 0, 0))
    made.networks["sarm"][:] = silent(made.networks["sarm"])
    made.networks["sarm"][-1][1][1] = -40
    made.planes[:] = 0
    made.planes[2, 0, 1, 1] = sign * PLANE_SYMBOL_MAX
    return Target(codec.emit(made))


def _refused_symbols(book: Book) -> None:
    proved, flags = "D8.8-1 D8.8-2 D8.7-1", "symbol-limit limit-off-by-one"
    for name, title, make, feature in (
        (
            "plane-symbol-2-15",
            "a plane symbol of 2^15",
            larger_plane_symbol.of(_largest_plane_symbol),
            "planes escapes",
        ),
        (
            "plane-symbol-minus-2-15",
            "a plane symbol of -2^15, which 16 bits hold",
            larger_plane_symbol.of(partial(_largest_plane_symbol, -1)),
            "planes escapes",
        ),
        (
            "weight-symbol-2-24",
            "an integer of a weight of 2^24",
            large_weight.of(grids, "colour.1"),
            "packed-weights escapes",
        ),
        (
            "weight-symbol-minus-2-24",
            "an integer of a weight of -2^24",
            large_weight.of(grids, "colour.1", -1),
            "packed-weights escapes",
        ),
        # 16 raw bits: the symbol of a model is in units of 2^16, and its low bits exceed the limit.
        (
            "symbol-raw-minus-2-23",
            "raw bits that lead to -2^23",
            other_raw_bits.of(partial(far, -ATTRIBUTE_SYMBOL_MAX, 160), 1),
            "raw-bits",
        ),
    ):
        book.add(f"invalid-{name}", title, make, features=f"{feature} substream", requirements=proved, flags=flags)
    for name, text, scale, value in (
        ("2-32-and-5", "2^32 and 5", 160, (1 << 32) + 5),
        ("minus-2-33-and-7", "-2^33 and 7", 160, 7 - (1 << 33)),
        ("2-32-less-9", "2^32 less 9", 80, (1 << 32) - 9),
    ):
        book.add(
            f"invalid-symbol-wraps-{name}",
            f"an escaped symbol of {text}, which is a small one in 32 bits",
            wrapping_symbol.of(partial(far, 0, scale), scale, value),
            features="escapes raw-bits substream",
            requirements="D8.5-1 D8.8-2",
            flags="symbol-wraps symbol-limit",
        )


def spread(
    name: str,
    mean: Int64,
    scale: Int64,
    coder: Sampler,
    anchors: int = 12,
    lanes: Lanes | None = None,
) -> Scene:
    """Returns a scene of WIDE with given means and scale indices of channels, the same for each anchor."""
    found, masks = constant(WIDE, Numbers(name), mean, scale), np.ones((anchors, WIDE.offset_count), bool)
    made = scene(name, anchors, WIDE, networks=found, masks=masks)
    return sampled(replace(made, lanes=lanes or made.lanes), coder, planes=False)


def _models(book: Book) -> None:
    book.valid(
        "models-gauss",
        "symbols of all rows and columns of the Gaussian family, the ends and the escape of each first",
        _gauss,
        features="models escapes",
        requirements="D8.2-1 D8.5-1 D8.7-1 DA-1",
        flags="table-rows table-columns symbol-search",
    )
    book.valid(
        "models-laplace",
        "symbols of the rows and columns of the Laplace family, the ends and the escape of each first",
        _laplace,
        features="models escapes planes",
        requirements="D8.2-1 D8.5-1 D8.7-1 DA-1",
        flags="table-rows table-columns symbol-search",
    )
    book.valid(
        "models-ends",
        "scale indices at and beyond both ends of the families",
        _ends,
        features="models",
        requirements="D8.5-1 DA-1",
        flags="scale-clamp",
    )


def _gauss() -> Scene:
    numbers = Numbers("models-gauss")
    d = Dimensions(10, (16, 16), 1, 4, 6, (20,), (4,), (1,), 1)
    found = observing(d, numbers)
    total = d.attribute_width
    w, b = found["hyper"][-1]
    # Each channel has one or two rows in turn. The columns follow from the context.
    b[total : 2 * total] = SCALE_MIN + np.arange(total) % 64
    w[total : total + 8, 0] = 2.0**-5
    return sampled(scene("models-gauss", 330, d, networks=found, masks=np.ones((330, 10), bool)), Sweep(numbers))


def _laplace() -> Scene:
    numbers = Numbers("models-laplace")
    d = Dimensions(1, (1,), 8, 1, 24, (1,), (2,), (), 1)
    found = networks(d, numbers)
    # The left neighbour and one above determine the scale index, the others the mean. Both are bounded.
    first = np.array([[16, 0, 0, 112], [0, 80, 16, 0]], np.float32)
    found["sarm"] = [
        (first, np.array([512, 512], np.float32)),
        (np.array([[0, 1 / 16], [1 / 16, 0]], np.float32), np.array([-32, SCALE_MIN], np.float32)),
    ]
    return sampled(scene("models-laplace", 1, d, networks=found, lanes=Lanes(2, 0, 0)), Sweep(numbers))


def _ends() -> Scene:
    scale = np.array([-41, -40, -39, 22, 23, 24, -(1 << 23), -1000])[CHANNEL % 8]
    return spread("models-ends", 3 * CHANNEL - 70, scale, Sampler(Numbers("models-ends/symbols")), 30)


def _ranges(book: Book) -> None:
    book.valid(
        "raw-widths",
        "0 to 16 raw bits, each at both ends of its scale indices",
        _widths,
        features="raw-bits escapes",
        requirements="D8.5-1 D8.6-1 D8.7-1",
        flags="raw-width raw-before-escapes scale-clamp symbol-limit",
    )
    book.valid(
        "raw-means",
        "means of wide distributions, whose low bits are raw",
        _means,
        features="raw-bits models",
        requirements="D8.5-1 D8.6-1",
        flags="select-rounding raw-width",
    )
    book.valid(
        "means-largest",
        "the largest means that F_h can have",
        _largest_means,
        features="models networks",
        requirements="D8.5-1 D7.2-1",
        flags="mean-width select-rounding",
    )
    book.valid(
        "means-sums",
        "the largest sums of outputs of F_h and CARM",
        _largest_sums,
        features="carm models",
        requirements="D7.9-1 D8.5-1",
        flags="mean-width carm-ignored",
    )
    book.valid(
        "select-ties",
        "means that are ties once the raw bits are gone",
        _ties,
        features="raw-bits models",
        requirements="D8.5-1",
        flags="select-rounding",
    )


def _widths() -> Scene:
    # Row 23 without raw bits, then the first and the last row for each number of raw bits, and beyond the last.
    ends = [s for k in range(1, 17) for s in (16 + 8 * k, 23 + 8 * k)]
    scale = np.array([23, *ends, 152, 160, 255, 1000, (1 << 24) - 1])
    mean, coder = Numbers("raw-widths").integers(-200, 200, len(CHANNEL)), Sampler(Numbers("raw-widths/symbols"), 12)
    return spread("raw-widths", mean, scale[CHANNEL % len(scale)], coder, 20)


def _means() -> Scene:
    numbers = Numbers("raw-means")
    return spread(
        "raw-means", numbers.integers(-50000, 50000, len(CHANNEL)), CHANNEL * 3 - 20, Sampler(numbers, 20), 20
    )


def _largest_means() -> Scene:
    largest = (1 << 24) - 1
    mean = np.array([largest, -largest, largest - 8, 8 - largest, 7, 8, -8, -9])[CHANNEL % 8]
    scale = np.array([-40, 0, 23, 60, 100])[CHANNEL % 5]
    return spread("means-largest", mean, scale, Sampler(Numbers("means/symbols"), 9))


def _largest_sums() -> Scene:
    d = Dimensions(1, (2, 6), 1, 1, 2, (2,), (2,), (2,), 1)
    numbers = Numbers("means-sums")
    most = (1 << 24) - 1
    mean, scale = np.zeros(d.attribute_width, np.int64), np.zeros(d.attribute_width, np.int64)
    mean[2:8] = most, -most, most, 5, -most, 100
    scale[2:8] = 0, 10, most, most, -most, -most
    found = constant(d, numbers, mean, scale)
    found["carm.1"][-1][1][:] = [most, -most, -most, 7, most, -3, 0, -10, -most, most, most, -most]
    return sampled(scene("means-sums", 9, d, networks=found), Sampler(numbers, 8))


def _ties() -> Scene:
    # With k raw bits a mean is rounded at 2^(k - 1) of its sixteenths.
    k = CHANNEL % 6 + 1
    mean = (CHANNEL - len(CHANNEL) // 2) * (1 << k) + ((1 << k) >> 1) + 8 * ((1 << k) - 1)
    return spread("select-ties", mean, 16 + 8 * k, Sampler(Numbers("select-ties/symbols"), 0), 16)
