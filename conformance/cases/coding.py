"""Valid files for the entropy coder: models, raw bits, escapes, words and states."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from refcodec.bitstream.attributes import ATTRIBUTE_SYMBOL_MAX
from refcodec.bitstream.dimensions import Dimensions
from refcodec.bitstream.header import Lanes
from refcodec.bitstream.planes import PLANE_SYMBOL_MAX
from refcodec.bitstream.scene import Scene
from refcodec.bitstream.tables import SCALE_MIN

from .book import Book
from .numbers import Int64, Numbers
from .sampling import Sampler, Sweep, sampled
from .scenes import SMALL, constant, dyadic, networks, observing, scene, with_symbols

# One slice of sixteen, scalings, and offsets that are all kept: D = 52.
WIDE = Dimensions(10, (16,), 1, 4, 6, (20,), (4,), (), 1)


def add(book: Book) -> None:
    """Adds the vectors."""
    _models(book)
    _ranges(book)
    _escapes(book)
    _streams(book)


def spread(
    name: str,
    mean: Int64,
    scale: Int64,
    coder: Sampler,
    anchors: int = 12,
    d: Dimensions = WIDE,
    lanes: Lanes | None = None,
) -> Scene:
    """A scene whose channels have these means and scale indices, the same for each anchor."""
    made = scene(
        name,
        anchors,
        d,
        networks=constant(d, Numbers(name), mean, scale),
        masks=np.ones((anchors, d.offset_count), bool),
    )
    return sampled(replace(made, lanes=lanes or made.lanes), coder, planes=False)


def _models(book: Book) -> None:
    def gauss() -> Scene:
        numbers = Numbers("models-gauss")
        d = Dimensions(10, (16, 16), 1, 4, 6, (20,), (4,), (1,), 1)
        found = observing(d, numbers)
        total = d.attribute_width
        w, b = found["hyper"][-1]
        # Each channel a row or two, by turns; the columns follow from the context.
        b[total : 2 * total] = SCALE_MIN + np.arange(total) % 64
        w[total : total + 8, 0] = dyadic(np.array([1] * 8), 5)
        return sampled(scene("models-gauss", 330, d, networks=found, masks=np.ones((330, 10), bool)), Sweep(numbers))

    book.valid(
        "models-gauss",
        "symbols of all rows and columns of the Gaussian family, the ends and the escape of each first",
        gauss,
        features="models escapes",
        requirements="D8.2-1 D8.5-1 D8.7-1 DA-1",
        flags="table-rows table-columns symbol-search",
    )

    def laplace() -> Scene:
        numbers = Numbers("models-laplace")
        d = Dimensions(1, (1,), 8, 1, 24, (1,), (2,), (), 1)
        made = networks(d, numbers)
        # The left neighbour and one above give the scale index, the others the mean: both within bounds, whatever the symbols are.
        first = np.array([[16, 0, 0, 112], [0, 80, 16, 0]], np.float32)
        made["sarm"] = [
            (first, np.array([512, 512], np.float32)),
            (np.array([[0, 1 / 16], [1 / 16, 0]], np.float32), np.array([-32, SCALE_MIN], np.float32)),
        ]
        return sampled(scene("models-laplace", 1, d, networks=made, lanes=Lanes(2, 0, 0)), Sweep(numbers))

    book.valid(
        "models-laplace",
        "symbols of the rows and columns of the Laplace family, the ends and the escape of each first",
        laplace,
        features="models escapes planes",
        requirements="D8.2-1 D8.5-1 D8.7-1 DA-1",
        flags="table-rows table-columns symbol-search",
    )

    def ends() -> Scene:
        total = WIDE.attribute_width
        scale = np.array([-41, -40, -39, 22, 23, 24, -(1 << 23), -1000])[np.arange(total) % 8]
        return spread("models-ends", 3 * np.arange(total) - 70, scale, Sampler(Numbers("models-ends/symbols")), 30)

    book.valid(
        "models-ends",
        "scale indices at and beyond both ends of the families",
        ends,
        features="models",
        requirements="D8.5-1 DA-1",
        flags="scale-clamp",
    )


def _ranges(book: Book) -> None:
    total = WIDE.attribute_width

    def widths() -> Scene:
        # Row 23 without raw bits, then the first and the last row of each number of them, and more than there can be.
        scale = np.array(
            [23, *(s for k in range(1, 17) for s in (16 + 8 * k, 23 + 8 * k)), 152, 160, 255, 1000, (1 << 24) - 1]
        )
        mean = Numbers("raw-widths").integers(-200, 200, total)
        return spread(
            "raw-widths", mean, scale[np.arange(total) % len(scale)], Sampler(Numbers("raw-widths/symbols"), 12), 20
        )

    book.valid(
        "raw-widths",
        "0 to 16 raw bits, each at both ends of its scale indices",
        widths,
        features="raw-bits escapes",
        requirements="D8.5-1 D8.6-1 D8.7-1",
        flags="raw-width raw-before-escapes scale-clamp symbol-limit",
    )

    def means() -> Scene:
        scale = np.arange(total) * 3 - 20
        numbers = Numbers("raw-means")
        return spread("raw-means", numbers.integers(-50000, 50000, total), scale, Sampler(numbers, 20), 20)

    book.valid(
        "raw-means",
        "means of wide distributions, whose low bits are raw",
        means,
        features="raw-bits models",
        requirements="D8.5-1 D8.6-1",
        flags="select-rounding raw-width",
    )

    def far() -> Scene:
        largest = (1 << 24) - 1
        mean = np.array([largest, -largest, largest - 8, 8 - largest, 7, 8, -8, -9])[np.arange(total) % 8]
        return spread(
            "means-largest",
            mean,
            np.array([-40, 0, 23, 60, 100])[np.arange(total) % 5],
            Sampler(Numbers("means/symbols"), 9),
        )

    book.valid(
        "means-largest",
        "the largest means that F_h can have",
        far,
        features="models networks",
        requirements="D8.5-1 D7.2-1",
        flags="mean-width select-rounding",
    )

    def sums() -> Scene:
        d = Dimensions(1, (2, 6), 1, 1, 2, (2,), (2,), (2,), 1)
        numbers = Numbers("means-sums")
        largest = (1 << 24) - 1
        mean, scale = np.zeros(d.attribute_width, np.int64), np.zeros(d.attribute_width, np.int64)
        mean[2:8] = largest, -largest, largest, 5, -largest, 100
        scale[2:8] = 0, 10, largest, largest, -largest, -largest
        found = constant(d, numbers, mean, scale)
        found["carm.1"][-1][1][:] = [
            largest,
            -largest,
            -largest,
            7,
            largest,
            -3,
            0,
            -10,
            -largest,
            largest,
            largest,
            -largest,
        ]
        return sampled(scene("means-sums", 9, d, networks=found), Sampler(numbers, 8))

    book.valid(
        "means-sums",
        "the largest sums of outputs of F_h and CARM",
        sums,
        features="carm models",
        requirements="D7.9-1 D8.5-1",
        flags="mean-width carm-ignored",
    )

    def halves() -> Scene:
        # With k raw bits a mean is rounded at 2^(k - 1) of its sixteenths.
        scale = 24 + 8 * (np.arange(total) % 6)
        k = (scale - 24) // 8 + 1
        mean = (np.arange(total) - total // 2) * (1 << k) + ((1 << k) >> 1) + 8 * ((1 << k) - 1)
        return spread("select-ties", mean, scale, Sampler(Numbers("select-ties/symbols"), 0), 16)

    book.valid(
        "select-ties",
        "means that are ties once the raw bits are gone",
        halves,
        features="raw-bits models",
        requirements="D8.5-1",
        flags="select-rounding",
    )


def _escapes(book: Book) -> None:
    def lengths(limit: int) -> Int64:
        """Values of either sign about each power of two, up to the limit."""
        found = [
            s * (v + o)
            for z in range(limit.bit_length())
            for v in (1 << z, (2 << z) - 1)
            for o in (0, 1)
            for s in (1, -1)
        ]
        kept = sorted({v for v in found if abs(v) <= limit} | {limit, -limit, limit - 1, 1 - limit})
        return np.array(kept, dtype=np.int64)

    def attributes() -> Scene:
        d = Dimensions(1, (16,), 1, 1, 2, (1,), (1,), (), 1)
        values = lengths(ATTRIBUTE_SYMBOL_MAX)
        count = -(-len(values) // 16)
        zero = np.zeros(d.attribute_width, np.int64)
        made = scene("escapes-attributes", count, d, networks=constant(d, Numbers("escapes"), zero, zero - 40))
        return with_symbols(made, features=np.resize(values, (count, 16)))

    book.valid(
        "escapes-attributes",
        "attribute symbols about each power of two, to the largest",
        attributes,
        features="escapes",
        requirements="D8.7-1 R8.5-1 R8.7-1",
        flags="escape-prefix escape-sign escape-offset symbol-limit",
    )

    def planes() -> Scene:
        d = replace(SMALL, plane_size=8)
        made = scene("escapes-planes", 2, d)
        made.networks["sarm"][:] = [(np.zeros_like(w), np.zeros_like(b)) for w, b in made.networks["sarm"]]
        values = np.resize(lengths(PLANE_SYMBOL_MAX), made.planes.shape).astype(np.int16)
        return with_symbols(replace(made, planes=values))

    book.valid(
        "escapes-planes",
        "plane symbols about each power of two, to the largest",
        planes,
        features="escapes planes",
        requirements="D8.7-1 R8.5-1",
        flags="escape-prefix escape-sign escape-offset symbol-limit",
    )

    def with_raw() -> Scene:
        total = WIDE.attribute_width
        numbers = Numbers("escapes-raw")
        return spread(
            "escapes-raw",
            numbers.integers(-500, 500, total),
            30 + np.arange(total) % 40,
            Sampler(numbers, 3),
            14,
            lanes=Lanes(0, 0, 3),
        )

    book.valid(
        "escapes-raw",
        "groups with many raw fields and many escapes",
        with_raw,
        features="escapes raw-bits lanes",
        requirements="D8.6-1 D8.7-1 D8.5-1",
        flags="raw-before-escapes escape-raw-bits",
    )

    def padding() -> Scene:
        d = Dimensions(1, (1,), 1, 1, 2, (1,), (1,), (), 1)
        zero = np.zeros(d.attribute_width, np.int64)
        scale = zero + np.array([31] * 5 + [0] * (d.attribute_width - 5))
        numbers = Numbers("padding")
        values = np.zeros((16, 6), np.int64)
        for n in range(16):
            values[n, 5] = (1 << n) * (n % 2)
        made = scene("padding", 16, d, networks=constant(d, numbers, zero, scale), chunk_size=1)
        return with_symbols(made, features=np.zeros((16, 1)), scalings=values)

    book.valid(
        "padding",
        "raw bits that end at each place of a byte",
        padding,
        features="raw-bits escapes chunks",
        requirements="D8.6-1 R8.8-3 R8.8-4",
        flags="raw-padding",
    )


class _Rare(Sampler):
    """Always the rarest symbol of a model that is no escape, at one end or the other."""

    def distances(self, model: Int64, radius: Int64) -> Int64:
        return np.asarray(radius * self.numbers.chosen([-1, 1], len(model)))


def _streams(book: Book) -> None:
    total = WIDE.attribute_width

    def rare() -> Scene:
        zero = np.zeros(total, np.int64)
        return spread(
            "words-many", zero + 3, zero + np.arange(total) % 20, _Rare(Numbers("words-many")), 20, lanes=Lanes(0, 0, 4)
        )

    book.valid(
        "words-many",
        "symbols that nearly all take a word, in 16 lanes at once",
        rare,
        features="substream lanes",
        requirements="D8.2-1 D8.3-1 R8.8-1",
        flags="word-order lane-order",
    )

    def certain() -> Scene:
        zero = np.zeros(total, np.int64)
        made = spread("words-none", zero, zero - 40, Sampler(Numbers("words-none"), 0), 1, lanes=Lanes(0, 0, 0))
        return with_symbols(made, features=np.zeros((1, 16)), scalings=np.zeros((1, 6)), offsets=np.zeros((1, 10, 3)))

    book.valid(
        "words-none",
        "a substream without words",
        certain,
        features="substream",
        requirements="D8.2-1 R8.8-1 R8.8-2",
        flags="final-state",
    )

    def long() -> Scene:
        return sampled(
            scene("substream-long", 200, SMALL, lanes=Lanes(0, 0, 0)), Sampler(Numbers("substream-long"), 15)
        )

    book.valid(
        "substream-long",
        "one lane, thousands of symbols",
        long,
        features="substream",
        requirements="D8.2-1 D8.3-1 R8.8-5",
        flags="symbol-crc group-continues",
    )
