"""Cases of clauses 5.8, 6.8 and 7.2: weights as f32, and the integer networks made of them.

The weights are those of mode 0 and of raw layers of mode 1. The table of scales begins the section in both modes.
"""

import struct
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from refcodec.bitstream.dimensions import RENDERING, Dimensions, layers_of
from refcodec.bitstream.directory import WEIGHTS
from refcodec.bitstream.scene import Scene
from refcodec.bitstream.weights import CARM_SHIFT_MAX, PLANE_SHIFT_MAX, GridLayer

from .fault import Draw, Drawn, Edit, element, fault, padding
from .header import INFINITY, LARGEST_F32, NAN, SMALLEST_F32
from .numbers import Numbers
from .samplers import Sampler, drawn, sampled
from .scenes import CONSTANT, PLANELESS, SMALLEST, UNENCODED, scene
from .table import NAME, More, refused, valid
from .target import Target
from .targets import five_cells, grids, packed, plain, planeless, target_of, unpredicted
from .weights import ALL, Values, dyadic, networks, packed_weights, set_weights, with_weights
from .weights_packed import grid_fault

NOT_A_NUMBER, INFINITE, MINUS = (struct.pack("<f", value) for value in (NAN, INFINITY, -INFINITY))
SIGNALLING = [b"\1\0\x80\xff", b"\1\0\x80\x7f"]


def _scales(draw: Draw, t: Target) -> Drawn:
    """Draws a field of the table at the start of the section, and a value outside its limits."""
    d = t.header.dimensions
    limits = {"plane_shift": PLANE_SHIFT_MAX if d.plane_channels else 0, "carm_input_count": d.carm_inputs}
    limits |= {f"carm_shift[{i}]": CARM_SHIFT_MAX for i in range(d.carm_inputs)}
    field = draw.choice(list(limits))
    return field, draw.choice([limits[field] + 1, 255])


scale = element("weights.scale", "weights.{}", _scales)
padding_byte = padding("weights.padding", r"weights\.padding")


def _numbers(draw: Draw, t: Target) -> Drawn:
    """Draws a raw layer, a row, and a column or None."""
    raw = [shape for shape in layers_of(t.header.dimensions) if f"weights.{shape[0]}.weight" in t.elements]
    layer, out, fan_in = draw.choice(raw)
    column = draw.integer(0, fan_in)
    return layer, draw.integer(0, out - 1), None if column == fan_in else column


@fault("weights.not_finite", _numbers, [NOT_A_NUMBER, INFINITE, *SIGNALLING])
def not_finite(t: Target, layer: str, row: int, column: int | None, value: bytes) -> Edit:
    """A weight of a raw layer, or a bias if column is None, is not finite."""
    at = t.weight_at(layer, row, column)
    return Edit({at: value}, at)


def _any_finite() -> Scene:
    made = drawn("weights-any", 2)
    values = np.array([LARGEST_F32, -LARGEST_F32, -0.0, SMALLEST_F32, -(2.0**-126), 1 / 3], np.float32)
    for name in RENDERING:
        for w, b in made.networks[name]:
            flat = w.reshape(-1)
            flat[:6] = values[: flat.size]
            b[0] = -0.0
    return made


def _negative_zeros() -> Scene:
    made = drawn("weights-negative-zero", 3)
    for layers in made.networks.values():
        layers[0][0][0, 0] = -0.0
        layers[-1][1][0] = -0.0
    return sampled(made, Sampler(Numbers("weights-negative-zero/again")))


# F_h reads ten numbers, and has sixteen hidden units: at 1023 each, they and weights of 1023 are next to the bound.
ROWS = Dimensions(1, (6, 2), 2, 3, 4, (16,), (4,), (16,), 1)
# What such a row leaves for its bias.
SPARE = (1 << 24) - 1 - 16 * 1023 * 1023
# The largest weight, which rounds to 1023, and the f32 below the least one, -1023.5.
LARGEST = float(np.nextafter(np.float32(1023.5), np.float32(0)))
BELOW = float(np.nextafter(np.float32(-1023.5), -LARGEST_F32))
LARGE_WEIGHTS = [1023.5, -1023.75, 1024.0, -LARGEST_F32]
rows_file = target_of(lambda: scene("refused-rows", 1, ROWS))
_all_packed = target_of(lambda: packed_weights(scene("refused-grids-bound", 1, SMALLEST)))
_constant_packed = target_of(lambda: packed_weights(scene("refused-constant-packed", 3, CONSTANT)))

# --- faults -----------------------------------------------------------------------------------------------------------


def _reported(t: Target, layer: str, row: int) -> int:
    """SPEC [R6.8-4]: the row's first weight, or its bias if it has none, or in mode 1 the layer's model."""
    if t.sections[WEIGHTS].mode:
        return t.layer_at(layer)
    inputs = next(fan_in for name, _, fan_in in layers_of(t.header.dimensions) if name == layer)
    return t.weight_at(layer, row, 0 if inputs else None)


def _large(draw: Draw, t: Target) -> Drawn:
    if t.sections[WEIGHTS].mode:
        return "hyper.0", 0, 0, draw.choice(LARGE_WEIGHTS)
    shapes = [shape for shape in layers_of(t.header.dimensions) if not shape[0].startswith(RENDERING)]
    layer, out, fan_in = draw.choice(shapes)
    row = draw.integer(0, out - 1)
    if draw.flag() or not fan_in:
        return layer, row, None, draw.choice([2.0**24, -(2.0**24), LARGEST_F32])
    return layer, row, draw.integer(0, fan_in - 1), draw.choice(LARGE_WEIGHTS)


@fault("weights.bound", _large, base=lambda draw, t: grids() if t.sections[WEIGHTS].mode else t)
def large_value(t: Target, layer: str, row: int, column: int | None, value: float) -> Edit:
    """A weight, or a bias if column is None, is too large for every exponent. The layer is raw."""
    return Edit({t.weight_at(layer, row, column): struct.pack("<f", value)}, _reported(t, layer, row))


@fault(
    "weights.bound",
    ["hyper.1"],
    (0, 3),
    lambda d, t, *_: [d.choice([-1023, 1023]) for _ in range(16)],
    lambda d, t, *_: d.choice([-1, 1]) * (SPARE + d.integer(1, 99)),
    base=lambda draw, t: rows_file(),
)
def large_row(t: Target, layer: str, row: int, weights: Sequence[float], bias: float) -> Edit:
    """The weights and the bias of a row together are too large."""
    puts = {t.weight_at(layer, row, i): struct.pack("<f", value) for i, value in enumerate(weights)}
    return Edit(puts | {t.weight_at(layer, row, None): struct.pack("<f", bias)}, _reported(t, layer, row))


@grid_fault(
    "weights.bound",
    [(1 << 23) + 1, -(1 << 23) - 1],
    layers=lambda t: [layer for layer in t.layers[1:] if not layer.startswith(RENDERING)],
)
def large_integer(g: GridLayer, value: int) -> GridLayer:
    """The last row of a packed layer has too large a weight."""
    weight = g.weight.copy()
    weight[-1, 0] = value
    return replace(g, weight=weight)


@grid_fault("weights.bound", (1, 36), layers=lambda t: ["hyper.0"], base=lambda draw, t: _constant_packed())
def large_bias(g: GridLayer, row: int) -> GridLayer:
    """The packed first layer of F_h has too large a bias: the largest integer, with the exponent -1.

    row: not the first one, which has no difference.
    """
    bias, difference, exponent = g.bias.copy(), g.difference.copy(), g.exponent + int(g.difference[: row + 1].sum())
    bias[row] = (1 << 24) - 1
    difference[row] -= exponent + 1
    difference[row + 1 : row + 2] += exponent + 1
    return replace(g, bias=bias, difference=difference)


# --- valid files ------------------------------------------------------------------------------------------------------


def _with_hyper(name: str, *values: Values, anchors: int = 24) -> Scene:
    """Returns a scene with a changed F_h. The means depend on all of it."""
    numbers = Numbers(name)
    network_weights = set_weights(networks(ROWS, numbers), *values)
    return sampled(scene(name, anchors, ROWS, networks=network_weights), Sampler(numbers, 0))


def _each_row(weight: Callable[[int], Any], bias: Callable[[int], float]) -> tuple[Values, ...]:
    """Returns weights and a bias for each row of the last layer, by the number of the row."""
    return tuple(("hyper.1", r, weight(r), bias(r)) for r in range(ROWS.attribute_width))


def _ties() -> Scene:
    # Exponents from 0 to 9: half of the sums are ties.
    numbers = Numbers("network-ties")
    rows = _each_row(
        lambda r: dyadic(numbers.integers(-500, 500, 16) | 1, 1 + r % 3),
        lambda r: float(numbers.integer(-2000, 2000)) / 2,
    )
    return _with_hyper("network-ties", *rows)


def _tied_weights(r: int) -> NDArray[np.float32]:
    """Returns a row: its largest weight determines the exponent, and the others are then halfway between integers."""
    row = dyadic((2 * Numbers("weight-ties").integers(-60, 60, 16) + 1), 1 + r % 11)
    row[r % 16] = 1000.0 / 2 ** (r % 11)
    return row


def _signed(r: int) -> NDArray[np.float32]:
    """Returns a row of weights of both signs with an exponent of its own."""
    row = np.full(16, np.ldexp(np.float32(600 - r), -min(r, 30)))
    row[::2] *= -1
    return row


def _tiny() -> Scene:
    # The shift that makes them integers is wider than a register, or would be without the row's exponent.
    units = [-64, -70, -77, -84, -87, -90, -96, -100, -104, -107, -116, -126, -127, -138, -149]
    significands = [1, -3, (1 << 24) - 1, 1 - (1 << 24), (1 << 23) + 1, -(1 << 23) - 1]
    numbers = Numbers("outside-tiny")

    def small(values: NDArray[np.float32]) -> NDArray[np.float32]:
        chosen = numbers.chosen(significands, *values.shape).astype(np.float32)
        made = np.ldexp(chosen, numbers.chosen(units, *values.shape))
        return np.where(numbers.integers(0, 2, *values.shape) == 0, made.astype(np.float32), values)

    made = with_weights(scene("outside-tiny", 4), *((name, ALL, small, small) for name in ("hyper", "sarm", "carm.1")))
    return sampled(made, Sampler(numbers))


# fmt: off
_LIMITS = [
    values for r, value in enumerate((
        1023.0, 1023.4375, -1023.0, -1023.5, 511.75, -511.75, 1023.25 / 1024, -1023.5 / 1024, 1023.5 / 2048))
    for values in (("hyper.1", r, 0, r - 4), ("hyper.1", (r, r), value, None))]
# 16 weights of 1023 times 1023, and a bias of the whole rest, or of half of it. At the exponent 1 the rounding term
# counts. One more than the rest makes the exponent 0.
_ACCUMULATOR = (
    ("hyper.1", slice(6), 1023, (SPARE, -SPARE, SPARE - 1, 0, 1, -1)), ("hyper.1", 1, -1023, None),
    ("hyper.1", slice(6, 10), 511.5, ((SPARE - 1) / 2, SPARE / 2, (1 - SPARE) / 2, -SPARE / 2)),
    ("hyper.1", slice(10, 12), 0, ((1 << 24) - 1, 1 - (1 << 24))))
# Hidden units below 0, above 1023 and at both.
_SATURATED = (
    ("hyper.0", ALL, lambda w: dyadic(Numbers("saturated").integers(-900, 900, *w.shape), 5),
     (0, 1023, 1022.5, 1024, -1, -0.5, 0.5, 0.25, 2000, -2000, 1, 2, 3, 1023.5, 511, 512)),
    ("hyper.0", slice(8), 0, None))
CASES = [
    *refused("raw-weights", "limit-off-by-one",
        ("plane-shift-11", "plane_shift 11", scale, "plane_shift", 11),
        ("planeless-plane-shift-1", "plane_shift 1, and no planes", planeless, scale, "plane_shift", 1),
        ("carm-input-count-0", "carm_input_count 0", scale, "carm_input_count", 0),
        ("carm-input-count-3", "carm_input_count 3", scale, "carm_input_count", 3),
        ("carm-shift-17", "carm_shift 17", scale, "carm_shift[0]", 17),
        ("last-carm-shift-17", "carm_shift 17", scale, "carm_shift[1]", 17)),
    *refused("packed-weights", "limit-off-by-one",
        ("packed-carm-input-count-0", "carm_input_count 0", packed, scale, "carm_input_count", 0)),
    *refused("", "padding-unchecked", *(
        (f"weights-padding-{name}", f"padding of the table of scales that is not zero: {name.replace('-', ', ')}", base,
         padding_byte, "weights.padding", at, 0x80, More(features=features))
        for name, base, at, features in (
            ("raw", five_cells, 1, "raw-weights"), ("packed", grids, 0, "packed-weights"),
            ("packed-last-byte", grids, 1, "packed-weights")))),
    *refused("raw-weights", "float-limits", (not_finite,),
        ("weights-not-a-number-first", "a weight or bias is not a number: first", "hyper.0", 0, 0, NOT_A_NUMBER),
        ("weights-infinite-bias", "a weight or bias is infinite: bias", "sarm.0", 1, None, INFINITE),
        ("weights-signalling-carm", "a weight or bias is signalling: carm", "carm.1.0", 0, 0, SIGNALLING[0]),
        ("weights-not-a-number-last", "a weight or bias is not a number: last", "colour.1", 5, None, NOT_A_NUMBER),
        ("weights-infinite-end", "the last bias of a section of weights is infinite", "colour.1", 5, None, MINUS),
        ("weights-infinite-rendering", "the first weight of a rendering network is infinite", "opacity.0", 0, 0,
         INFINITE)),
    *refused("packed-weights", "float-limits",
        ("grids-raw-not-a-number", "a raw layer with a number that is none", grids, not_finite, "hyper.0", 0, 0,
         NOT_A_NUMBER)),
    *valid("raw-weights", "weight-bits", "R6.8-3 D9.3-1",
        ("weights-any", "rendering networks with any finite f32, which decide no symbol", _any_finite)),
    *valid("raw-weights networks", "weight-bits", "D7.2-1 D9.3-1",
        ("weights-negative-zero", "weights and biases of -0, which stay as they are", _negative_zeros)),
    *valid("raw-weights dimensions", "empty-refused", "R6.8-1 D7.2-1 D7.2-2", *(
        (f"weights-{name}", f"weights of a scene with {text}", partial(drawn, f"weights-{name}", 7, d, chunk_size=4))
        for name, text, d in (
            ("planeless", "no planes: there is no SARM, and plane_shift is 0", PLANELESS),
            ("unencoded", "no positional encoding: F_h has four inputs", UNENCODED),
            ("constant", "neither planes nor encoding: F_h is its biases", CONSTANT)))),

    *refused("raw-weights", "accumulator-bound weight-limit", (large_value,),
        ("weights-bound-weight-1023-5", "a weight that rounds to 1024 at each exponent", "hyper.1", 3, 1, 1023.5),
        ("weights-bound-weight-below-minus-1023-5", "the f32 below -1023.5 as a weight", "hyper.1", 2, 0, BELOW),
        ("weights-bound-weight-minus-1024", "a weight of -1024", "carm.1.0", 1, 0, -1024.0),
        ("weights-bound-weight-largest", "the largest f32 as a weight", "sarm.2", 1, 3, -LARGEST_F32),
        ("weights-bound-bias-2-24", "a bias of 2^24", "hyper.0", 1, None, 2.0**24),
        ("weights-bound-bias-minus-2-24", "a bias of -2^24", "sarm.1", 0, None, -(2.0**24)),
        ("weights-bound-bias-largest", "the largest f32 as a bias", "carm.1.1", 5, None, LARGEST_F32)),
    *refused("raw-weights", "accumulator-bound row-order", *(
        (f"weights-bound-no-inputs-{name}", f"a bias of F_h that is too large, where F_h has no inputs: the {name} row",
         unpredicted, large_value, "hyper.0", row, None, bias)
        for name, row, bias in (("first", 0, 2.0**24), ("last", 36, -LARGEST_F32)))),
    *refused("raw-weights", "",
        ("weights-bound-by-one", "a row that is at the accumulator bound, and not below it", rows_file, large_row,
         "hyper.1", 4, [-1023] * 16, SPARE + 1, More("accumulator-bound")),
        ("weights-bound-rounded", "a row that is at the bound once its bias is rounded", rows_file, large_row,
         "hyper.1", 2, [1022.5] + [1023] * 15, SPARE + 0.5, More("accumulator-bound weight-rounding")),
        ("weights-bound-bias-of-first-row", "two rows that break the bound, the first by its bias",
         large_value.target(plain, "sarm.0", 1, 0, 5000.0), large_value, "sarm.0", 0, None, 1e30, More("row-order"))),
    *refused("packed-weights", "accumulator-bound",
        ("grids-raw-bound", "a row of a raw layer in mode 1 that breaks the bound", grids, large_value, "hyper.0", 0, 0,
         4096.0),
        ("grids-packed-bound", "a row of a packed layer that breaks the bound", _all_packed, large_integer, "hyper.1",
         (1 << 23) + 1),
        ("grids-packed-bound-no-inputs", "a bias that breaks the bound, in a packed layer without inputs",
         _constant_packed, large_bias, "hyper.0", 36)),
    *valid("networks raw-weights", "", "D7.2-1 D7.2-2",
        ("network-ties", "sums of rows that are ties", _ties, More("network-rounding")),
        (_with_hyper, NAME),
        ("network-weight-limit", "weights that round to 1023 and to 1024", *_LIMITS, More("weight-limit")),
        ("network-weight-ties", "weights and biases halfway between integers",
         *_each_row(_tied_weights, lambda r: (2 * r - 15) / 2.0 ** (1 + r % 11)), More("weight-rounding")),
        ("network-accumulator", "rows at the accumulator bound", *_ACCUMULATOR,
         More("accumulator-bound rounding-term")),
        ("network-exponents", "exponents of rows from 0 to 20, zero rows and subnormal weights",
         *_each_row(_signed, lambda r: 3 - r), ("hyper.1", 3, 0, 0), ("hyper.1", 4, 0, 2.0**-21),
         ("hyper.1", 5, 2.0**-149, -(2.0**-149)), More("exponent-limit subnormals")),
        ("network-saturated", "hidden units below 0 and above 1023", *_SATURATED, More("activation-clamp"))),
    # At the exponent 20 this bias is 2^19 - 1, which rounds to 0; at 19 it would be 2^18, which rounds to 1.
    *valid("networks", "exponent-limit", "D7.2-1",
        ("network-largest-exponent", "biases that only the largest exponent rounds down",
         partial(_with_hyper, "planted-exponent", ("hyper.1", slice(ROWS.attribute_width), 0, 0.5 - 2.0**-20),
                 anchors=12))),
    *valid("networks raw-weights", "", "D7.2-1",
        ("network-largest-weight", "the largest weight, and the least one",
         partial(_with_hyper, "network-largest-weight", ("hyper.1", slice(2), 0, 0),
                 ("hyper.1", ([0, 1], [0, 1]), (LARGEST, -1023.5), None), anchors=2),
         More("weight-limit weight-rounding")),
        ("weights-tiny", "weights and biases of 2^-40 to 2^-149 among others, which round to 0", _tiny,
         More("shift-too-far subnormals weight-rounding"))),
]
