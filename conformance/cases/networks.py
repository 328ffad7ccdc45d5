"""Cases of clause 7.2: integer networks, and weights that exceed their bound."""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache, partial

import numpy as np

from refcodec.bitstream import codec
from refcodec.bitstream.dimensions import RENDERING, Dimensions, layers_of
from refcodec.bitstream.directory import WEIGHTS
from refcodec.bitstream.networks import Layer
from refcodec.bitstream.scene import Scene
from refcodec.bitstream.weights import GridLayer

from .book import Book
from .fault import Draw, Drawn, Edit, Whole, fault, several
from .header import LARGEST_F32
from .numbers import Numbers
from .samplers import Sampler, sampled
from .scenes import CONSTANT, SMALLEST, TINY_DIMENSIONS, dyadic, networks, packed_weights, scene
from .target import Target
from .targets import SEEDS, grids, plain, unpredicted
from .weights_packed import with_integers

# F_h reads ten numbers, and has sixteen hidden units: at 1023 each, they and weights of 1023 are next to the bound.
ROWS = Dimensions(1, (6, 2), 2, 3, 4, (16,), (4,), (16,), 1)
# What such a row leaves for its bias.
SPARE = (1 << 24) - 1 - 16 * 1023 * 1023
# The largest weight, which rounds to 1023, and the f32 below the least one, -1023.5.
LARGEST, BELOW = (
    float(np.nextafter(np.float32(1023.5), np.float32(0))),
    float(np.nextafter(np.float32(-1023.5), -LARGEST_F32)),
)
LARGE_WEIGHTS = [1023.5, -1023.75, 1024.0, -LARGEST_F32]


# --- faults -----------------------------------------------------------------------------------------------------------


def _told(t: Target, layer: str, row: int) -> int:
    """SPEC [R6.8-4]: the row's first weight, or its bias if it has none, or in mode 1 the layer's model."""
    if t.sections[WEIGHTS].mode:
        return t.layer_at(layer)
    inputs = next(fan_in for name, _, fan_in in layers_of(t.header.dimensions) if name == layer)
    return t.weight_at(layer, row, 0 if inputs else None)


@fault("weights.bound")
def large_value(t: Target, layer: str, row: int, column: int | None, value: float) -> Edit:
    """A weight, or a bias if column is None, is too large for every exponent. The layer is raw."""
    return Edit({t.weight_at(layer, row, column): struct.pack("<f", value)}, _told(t, layer, row))


@large_value.drawn
def _(draw: Draw, t: Target) -> Drawn:
    if t.sections[WEIGHTS].mode:
        return grids(), "hyper.0", 0, 0, draw.choice(LARGE_WEIGHTS)
    shapes = [shape for shape in layers_of(t.header.dimensions) if not shape[0].startswith(RENDERING)]
    layer, out, fan_in = draw.choice(shapes)
    row = draw.integer(0, out - 1)
    if draw.flag() or not fan_in:
        return t, layer, row, None, draw.choice([2.0**24, -(2.0**24), LARGEST_F32])
    return t, layer, row, draw.integer(0, fan_in - 1), draw.choice(LARGE_WEIGHTS)


@fault("weights.bound")
def large_row(t: Target, layer: str, row: int, weights: Sequence[float], bias: float) -> Edit:
    """The weights and the bias of a row together are too large."""
    puts = {t.weight_at(layer, row, i): struct.pack("<f", value) for i, value in enumerate(weights)}
    return Edit(puts | {t.weight_at(layer, row, None): struct.pack("<f", bias)}, _told(t, layer, row))


@large_row.drawn
def _(draw: Draw, t: Target) -> Drawn:
    signs = [draw.choice([-1023, 1023]) for _ in range(16)]
    return rows_file(), "hyper.1", draw.integer(0, 3), signs, draw.choice([-1, 1]) * (SPARE + draw.integer(1, 99))


@fault("weights.bound")
def large_integer(t: Target, layer: str, value: int) -> Whole:
    """The last row of a packed layer has too large a weight."""

    def change(g: GridLayer) -> GridLayer:
        weight = g.weight.copy()
        weight[-1, 0] = value
        return replace(g, weight=weight)

    return with_integers(t, layer, change)


@large_integer.drawn
def _(draw: Draw, t: Target) -> Drawn:
    t = grids(draw.integer(0, SEEDS - 1))
    layers = [layer for layer in t.layers[1:] if not layer.startswith(RENDERING)]
    return t, draw.choice(layers), draw.choice([-1, 1]) * ((1 << 23) + 1)


@fault("weights.bound")
def large_bias(t: Target, row: int) -> Whole:
    """The packed first layer of F_h has too large a bias: the largest integer, with the exponent -1."""

    def change(g: GridLayer) -> GridLayer:
        bias, difference, exponent = g.bias.copy(), g.difference.copy(), g.exponent + int(g.difference[: row + 1].sum())
        bias[row] = (1 << 24) - 1
        difference[row] -= exponent + 1
        difference[row + 1 : row + 2] += exponent + 1
        return replace(g, bias=bias, difference=difference)

    return with_integers(t, "hyper.0", change)


@large_bias.drawn
def _(draw: Draw, t: Target) -> Drawn:
    # A first row has no difference.
    return _constant_packed(), draw.integer(1, 36)


@cache
def rows_file() -> Target:
    """Returns a file of ROWS."""
    return Target(codec.emit(scene("refused-rows", 1, ROWS)))


# --- the suite's ------------------------------------------------------------------------------------------------------


def add(book: Book) -> None:
    """Adds the vectors."""
    _refused(book)
    _valid(book)


@cache
def _all_packed() -> Target:
    return Target(codec.emit(packed_weights(scene("refused-grids-bound", 1, SMALLEST))))


@cache
def _constant_packed() -> Target:
    return Target(codec.emit(packed_weights(scene("refused-constant-packed", 3, CONSTANT))))


def _refused(book: Book) -> None:
    add = partial(book.add, features="raw-weights")
    values: list[tuple[str, str, tuple[str, int, int | None, float]]] = [
        ("weight-1023-5", "a weight that rounds to 1024 at each exponent", ("hyper.1", 3, 1, 1023.5)),
        ("weight-below-minus-1023-5", "the f32 below -1023.5 as a weight", ("hyper.1", 2, 0, BELOW)),
        ("weight-minus-1024", "a weight of -1024", ("carm.1.0", 1, 0, -1024.0)),
        ("weight-largest", "the largest f32 as a weight", ("sarm.2", 1, 3, -LARGEST_F32)),
        ("bias-2-24", "a bias of 2^24", ("hyper.0", 1, None, 2.0**24)),
        ("bias-minus-2-24", "a bias of -2^24", ("sarm.1", 0, None, -(2.0**24))),
        ("bias-largest", "the largest f32 as a bias", ("carm.1.1", 5, None, LARGEST_F32)),
    ]
    for name, title, value in values:
        make = large_value.of(plain, *value)
        add(f"invalid-weights-bound-{name}", title, make, flags="accumulator-bound weight-limit")
    for name, row, bias in (("first", 0, 2.0**24), ("last", 36, -LARGEST_F32)):
        title = f"a bias of F_h that is too large, where F_h has no inputs: the {name} row"
        make = large_value.of(unpredicted, "hyper.0", row, None, bias)
        add(f"invalid-weights-bound-no-inputs-{name}", title, make, flags="accumulator-bound row-order")
    title = "a row that is at the accumulator bound, and not below it"
    make = large_row.of(rows_file, "hyper.1", 4, [-1023] * 16, SPARE + 1)
    add("invalid-weights-bound-by-one", title, make, flags="accumulator-bound")
    title = "a row that is at the bound once its bias is rounded"
    make = large_row.of(rows_file, "hyper.1", 2, [1022.5] + [1023] * 15, SPARE + 0.5)
    add("invalid-weights-bound-rounded", title, make, flags="accumulator-bound weight-rounding")
    title = "two rows that break the bound, the first by its bias"
    rows = (large_value.edit("sarm.0", 0, None, 1e30), large_value.edit("sarm.0", 1, 0, 5000.0))
    add("invalid-weights-bound-bias-of-first-row", title, several(plain, *rows), flags="row-order")
    add = partial(book.add, features="packed-weights", flags="accumulator-bound")
    title = "a row of a raw layer in mode 1 that breaks the bound"
    add("invalid-grids-raw-bound", title, large_value.of(grids, "hyper.0", 0, 0, 4096.0))
    title = "a row of a packed layer that breaks the bound"
    add("invalid-grids-packed-bound", title, large_integer.of(_all_packed, "hyper.1", (1 << 23) + 1))
    title, make = "a bias that breaks the bound, in a packed layer without inputs", large_bias.of(_constant_packed, 36)
    add("invalid-grids-packed-bound-no-inputs", title, make)


def _with_hyper(name: str, change: Callable[[list[Layer]], None], anchors: int = 24) -> Scene:
    """Returns a scene with a changed F_h. The means depend on all of it."""
    numbers = Numbers(name)
    found = networks(ROWS, numbers)
    layers = [(w.copy(), b.copy()) for w, b in found["hyper"]]
    change(layers)
    made = scene(name, anchors, ROWS, networks={**found, "hyper": layers})
    return sampled(made, Sampler(numbers, 0))


def _valid(book: Book) -> None:
    for name, title, change, flags in (
        ("ties", "sums of rows that are ties", _ties, "network-rounding"),
        ("weight-limit", "weights that round to 1023 and to 1024", _weight_limit, "weight-limit"),
        ("weight-ties", "weights and biases halfway between integers", _weight_ties, "weight-rounding"),
        ("accumulator", "rows at the accumulator bound", _accumulator, "accumulator-bound rounding-term"),
        (
            "exponents",
            "exponents of rows from 0 to 20, zero rows and subnormal weights",
            _exponents,
            "exponent-limit subnormals",
        ),
        ("saturated", "hidden units below 0 and above 1023", _saturated, "activation-clamp"),
    ):
        book.valid(
            f"network-{name}",
            title,
            partial(_with_hyper, f"network-{name}", change),
            features="networks raw-weights",
            requirements="D7.2-1 D7.2-2",
            flags=flags,
        )
    book.valid(
        "network-largest-exponent",
        "biases that only the largest exponent rounds down",
        partial(_with_hyper, "planted-exponent", _largest_exponent, 12),
        features="networks",
        requirements="D7.2-1",
        flags="exponent-limit",
    )
    book.valid(
        "network-largest-weight",
        "the largest weight, and the least one",
        partial(_with_hyper, "network-largest-weight", _largest_weight, 2),
        features="networks raw-weights",
        requirements="D7.2-1",
        flags="weight-limit weight-rounding",
    )
    book.valid(
        "weights-tiny",
        "weights and biases of 2^-40 to 2^-149 among others, which round to 0",
        _tiny,
        features="networks raw-weights",
        requirements="D7.2-1",
        flags="shift-too-far subnormals weight-rounding",
    )


def _ties(layers: list[Layer]) -> None:
    # Exponents from 0 to 9: half of the sums are ties.
    numbers = Numbers("network-ties")
    w, b = layers[-1]
    for r in range(ROWS.attribute_width):
        w[r] = dyadic(numbers.integers(-500, 500, w.shape[1]) | 1, 1 + r % 3)
        b[r] = float(numbers.integer(-2000, 2000)) / 2


def _weight_limit(layers: list[Layer]) -> None:
    w, b = layers[-1]
    for r, value in enumerate(
        (1023.0, 1023.4375, -1023.0, -1023.5, 511.75, -511.75, 1023.25 / 1024, -1023.5 / 1024, 1023.5 / 2048)
    ):
        w[r], b[r] = 0, r - 4
        w[r, r] = value


def _largest_weight(layers: list[Layer]) -> None:
    w, b = layers[-1]
    w[:2], b[:2] = 0, 0
    w[0, 0], w[1, 1] = LARGEST, -1023.5


def _weight_ties(layers: list[Layer]) -> None:
    # The largest weight determines the exponent. The others are then halfway between integers.
    w, b = layers[-1]
    for r in range(ROWS.attribute_width):
        e = r % 11
        w[r] = dyadic((2 * Numbers("weight-ties").integers(-60, 60, w.shape[1]) + 1), 1 + e)
        w[r, r % w.shape[1]] = 1000.0 / 2**e
        b[r] = (2 * r - 15) / 2.0 ** (1 + e)


def _accumulator(layers: list[Layer]) -> None:
    # 16 weights of 1023 times 1023, and a bias of the whole rest, or of half of it.
    w, b = layers[-1]
    w[:6] = 1023
    w[1] = -1023
    b[:6] = SPARE, -SPARE, SPARE - 1, 0, 1, -1
    # At the exponent 1 the rounding term counts. One more than the rest makes the exponent 0.
    w[6:10] = 511.5
    b[6:10] = (SPARE - 1) / 2, SPARE / 2, (1 - SPARE) / 2, -SPARE / 2
    w[10], b[10] = 0, (1 << 24) - 1
    w[11], b[11] = 0, 1 - (1 << 24)


def _exponents(layers: list[Layer]) -> None:
    w, b = layers[-1]
    for r in range(ROWS.attribute_width):
        w[r] = np.ldexp(np.float32(600 - r), -min(r, 30))
        w[r, ::2] *= -1
        b[r] = 3 - r
    w[3], b[3] = 0, 0
    w[4], b[4] = 0, 2.0**-21
    w[5], b[5] = 2.0**-149, -(2.0**-149)


def _saturated(layers: list[Layer]) -> None:
    # Hidden units below 0, above 1023 and at both.
    w, b = layers[0]
    w[:] = dyadic(Numbers("saturated").integers(-900, 900, *w.shape), 5)
    b[:] = [0, 1023, 1022.5, 1024, -1, -0.5, 0.5, 0.25, 2000, -2000, 1, 2, 3, 1023.5, 511, 512]
    w[:8] = 0


def _largest_exponent(layers: list[Layer]) -> None:
    # At the exponent 20 this bias is 2^19 - 1, which rounds to 0; at 19 it would be 2^18, which rounds to 1.
    w, b = layers[-1]
    total = ROWS.attribute_width
    w[:total], b[:total] = 0, 0.5 - 2.0**-20


def _tiny() -> Scene:
    # The shift that makes them integers is wider than a register, or would be without the row's exponent.
    units = [-64, -70, -77, -84, -87, -90, -96, -100, -104, -107, -116, -126, -127, -138, -149]
    significands = [1, -3, (1 << 24) - 1, 1 - (1 << 24), (1 << 23) + 1, -(1 << 23) - 1]
    numbers = Numbers("outside-tiny")
    made = scene("outside-tiny", 4, TINY_DIMENSIONS)
    for name in ("hyper", "sarm", "carm.1"):
        for layer in made.networks[name]:
            for values in layer:
                chosen = numbers.chosen(significands, *values.shape).astype(np.float32)
                small = np.ldexp(chosen, numbers.chosen(units, *values.shape))
                values[:] = np.where(numbers.integers(0, 2, *values.shape) == 0, small.astype(np.float32), values)
    return sampled(made, Sampler(numbers))
