"""Cases of clauses 5.9, 6.8 and 7.13: weights in mode 1, as integers on grids, or raw.

Some layers are raw because no grid contains their values, others by the encoder's choice.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from refcodec.bitstream import codec, weights
from refcodec.bitstream.dimensions import Dimensions, layers_of
from refcodec.bitstream.directory import WEIGHTS
from refcodec.bitstream.entropy import Encoder
from refcodec.bitstream.header import Lanes
from refcodec.bitstream.scene import Scene
from refcodec.bitstream.weights import WEIGHT_EXPONENT_MAX, WEIGHT_EXPONENT_MIN, GridLayer, packable
from refcodec.encoder.weights import pack_weights

from .checksums import resized
from .fault import Draw, Drawn, Fault, Spec, Whole, element, fault
from .numbers import Int64, Numbers
from .samplers import Sampler, drawn, sampled
from .scenes import CONSTANT, SMALLEST, TINY_DIMENSIONS, scene, settled
from .table import NAME, More, refused, valid
from .target import Target
from .targets import SEEDS, grids, target_of
from .weights import ALL, Values, dyadic, packed_weights, scales, with_weights

# --- faults of sections and models ------------------------------------------------------------------------------------


def any_grids(draw: Draw, t: Target) -> Target:
    """Draws a file in mode 1."""
    return grids(draw.integer(0, SEEDS - 1))


@fault(
    "weights.length",
    lambda d, t: d.choice([None, *t.layers]),
    lambda d, t, layer: d.integer(0, 3 if layer is None else 7),
    base=any_grids,
)
def cut(t: Target, layer: str | None, more: int) -> Whole:
    """The section ends some bytes after the start of a layer's model, or of the section without a layer."""
    start = t.start(WEIGHTS)
    end = (start if layer is None else t.layer_at(layer)) + more
    return Whole(resized(t.data, WEIGHTS, t.data[start:end]), start)


def _fields(draw: Draw, t: Target) -> Drawn:
    """Draws a field of a layer's model, and a value outside its limits, or not 0 for a raw layer."""
    raw = t.layers[0]
    wrong = [(layer, "form", value) for layer in t.layers for value in (2, 255)]
    wrong += [(layer, "exponent", value) for layer in t.layers for value in (150, -105, 32767, -32768)]
    wrong += [(raw, "exponent", value) for value in (1, -1, 149, -104)]
    wrong += [(raw, field, value) for field in ("exponent_scale", "weight_scale", "bias_scale") for value in (1, 255)]
    return draw.choice(wrong)


model_field = element("weights.layer", "weights.{}.{}", _fields, base=any_grids)
reserved = element(
    "weights.reserved", "weights.{}.reserved[{}]", lambda d, t: d.choice(t.layers), (0, 1), (1, 255), base=any_grids
)

# --- faults of integers -----------------------------------------------------------------------------------------------


def with_integers(
    t: Target, layer: str, change: Callable[[GridLayer], GridLayer], coder: type[Encoder] = Encoder
) -> Whole:
    """Returns the file with other integers in packed layers, validly coded. The offset is that of the first model.

    layer: their names, separated by spaces.
    """
    made = codec.parse(t.data).scene
    assert made.weight_scales is not None
    shapes, wrong = layers_of(made.dimensions), {name: t.layers.index(name) for name in layer.split()}
    grids = [weights.to_grid(values) for network in made.networks.values() for values in network]
    coded = {i: grid for i, grid in enumerate(grids) if grid is not None}
    coded |= {i: change(coded[i]) for i in wrong.values()}
    encoder = coder(1, 1 << made.lanes.attribute)
    scale = made.weight_scales[list(coded)]
    weights.code_grids(encoder, [shapes[i] for i in coded], scale, list(coded.values()))
    start, stream = t.start(WEIGHTS), t.substreams["weights"].start
    models = bytearray(t.data[start:stream])
    for at, value in t.pack({f"weights.{name}.exponent": coded[i].exponent for name, i in wrong.items()}).items():
        models[at - start : at - start + len(value)] = value
    return Whole(resized(t.data, WEIGHTS, bytes(models) + encoder.finish()[0]), t.layer_at(next(iter(wrong))))


def grid_fault(
    error: str,
    *drawn: Spec,
    layers: Callable[[Target], list[str]] = lambda t: t.layers[1:],
    base: Callable[[Draw, Target], Target] = any_grids,
) -> Callable[[Callable[..., GridLayer]], Fault[...]]:
    """Decorates a function that changes the integers of a packed layer. The fault's first argument is the layer.

    layers: those that are drawn, of a drawn base.
    """

    def made(change: Callable[..., GridLayer]) -> Fault[...]:
        def broken(t: Target, layer: str, *arguments: Any) -> Whole:
            return with_integers(t, layer, lambda grid: change(grid, *arguments))

        return Fault(error, change.__name__, broken, [lambda d, t: d.choice(layers(t)), *drawn], base)

    return made


_OUTSIDE = (1000, -1000, (1 << 24) - 1, 1 - (1 << 24))


def changed(values: Int64, at: int, value: int) -> Int64:
    """Returns the integers with another one in a place."""
    copied = values.copy()
    copied[at] = value
    return copied


@grid_fault("weights.exponent", [1, None])
def even_integers(g: GridLayer, rows: int | None = None, exponent: int | None = None) -> GridLayer:
    """The first rows of a layer, or all, have only even integers. exponent: of all rows, if it changes."""
    weight, bias = g.weight.copy(), g.bias.copy()
    weight[:rows], bias[:rows] = weight[:rows] * 2, bias[:rows] * 2
    if exponent is not None:
        g = replace(g, exponent=exponent, difference=g.difference * 0)
    return replace(g, weight=weight, bias=bias)


@grid_fault("weights.exponent", lambda d, t, _: d.choice([*((0, n) for n in (1, -1, 5)), *((-1, n) for n in _OUTSIDE)]))
def difference(g: GridLayer, row: int, value: int) -> GridLayer:
    """The exponent of the first row is not the model's, or that of the last row, -1, is outside the limits."""
    return replace(g, difference=changed(g.difference, row, value))


@grid_fault("weights.exponent", lambda d, t, _: d.choice([(-1, 1), (-1, -1), (-1, 3), (0, 2), (0, -2)]))
def row_of_zeros(g: GridLayer, row: int, difference: int) -> GridLayer:
    """A last row of zeros, -1, has a different exponent, or a first one has a difference, which the second cancels."""
    differences, weight = changed(g.difference, -1, difference), g.weight.copy()
    if row == 0:
        differences = np.zeros_like(g.difference)
        differences[:2] = [difference, -difference][: len(differences)]
    weight[row] = 0
    return GridLayer(g.exponent, differences, weight, changed(g.bias, row, 0))


@grid_fault("weights.exponent", [1, 7, -104])
def layer_of_zeros(g: GridLayer, exponent: int) -> GridLayer:
    """A layer of zeros has a nonzero exponent."""
    return GridLayer(exponent, g.difference * 0, g.weight * 0, g.bias * 0)


# A file in mode 1 with a raw last layer.
_last_raw = target_of(lambda: packed_weights(_small("planted-cut", ("colour.1", 0, None, -0.0))))


def _until(layer: str, exponent: int) -> Callable[[Target], int]:
    """Returns a function that returns the difference with which the last row of a layer has an exponent."""

    def difference(t: Target) -> int:
        network, _, number = layer.rpartition(".")
        grid = weights.to_grid(codec.parse(t.data).scene.networks[network][int(number)])
        assert grid is not None
        return exponent - grid.exponent - int(grid.difference[:-1].sum())

    return difference


def _small(name: str, *values: Values, **dimensions: Any) -> Scene:
    """Returns a scene of the smallest dimensions with some values of weights. dimensions: other ones."""
    return with_weights(scene(name, 2, replace(SMALLEST, **dimensions), lanes=Lanes(0, 0, 1)), *values)


def _regular(name: str, *values: Values) -> Scene:
    """Returns a scene with some values of weights, packed. The symbols are drawn after the change."""
    return sampled(packed_weights(with_weights(scene(name, 3), *values)), Sampler(Numbers(f"{name}/symbols")))


def _lengths(w: NDArray[np.float32]) -> NDArray[np.float64]:
    """Returns odd multiples of 2^-149 from 1 bit to 24, of which only those of 24 bits are normal numbers."""
    lengths = np.arange(w.size).reshape(w.shape) % 24
    sign = np.where(lengths % 3 == 1, -1.0, 1.0)
    return sign * np.ldexp(np.ldexp(1.0, lengths) + (lengths > 0), -149)


def _fall(values: NDArray[np.float32]) -> NDArray[np.float32]:
    """Returns weights or biases of rows whose exponents rise and fall."""
    rows = np.arange(len(values))
    e = (-1) ** rows * (rows % 23) if len(rows) > 40 else rows * -3
    return np.ldexp(values.T, np.clip(e, -20, 0)).T


def _low_scales() -> Scene:
    numbers = Numbers("grids-escapes")
    values = [s * ((1 << z) | 1) for z in range(1, 24) for s in (1, -1)] + [(1 << 24) - 1, 1 - (1 << 24)]

    def any_of(old: NDArray[np.float32]) -> NDArray[np.float32]:
        return dyadic(numbers.chosen(values, *old.shape), 0)

    made = _regular("grids-escapes", ("colour.0", ALL, any_of, any_of))
    return replace(made, weight_scales=np.minimum(scales(made.networks), 60).astype(np.uint8))


def _one_scale(value: int) -> Scene:
    made = scene(f"grids-scales-{value}", 2, SMALLEST)
    return replace(made, weight_scales=np.full((len(layers_of(SMALLEST)), 3), value, np.uint8))


def _own_scales() -> Scene:
    layers = range(len(layers_of(TINY_DIMENSIONS)))
    rows = np.array([[40 + 13 * r % 90, 90 - 7 * r % 60, 60 + 5 * r % 50] for r in layers])
    return replace(scene("grids-scales", 2), weight_scales=rows.astype(np.uint8))


def _with_forms(made: Scene, forms: NDArray[Any]) -> Scene:
    """Returns the scene in mode 1, with some layers raw. forms: 0 for those."""
    packed = packed_weights(made)
    assert packed.weight_scales is not None
    # The model of a raw layer has no scales.
    scale = np.where(forms[:, None] == 0, 0, packed.weight_scales).astype(np.uint8)
    return replace(packed, weight_scales=scale, weight_forms=forms.astype(np.uint8))


def _chosen(name: str, forms: Callable[[int], NDArray[Any]], d: Dimensions = TINY_DIMENSIONS) -> Scene:
    """Returns a scene in mode 1 in which all layers can be packed. forms: of the first layers."""
    made = drawn(name, 3, d)
    assert packable(made.networks).all()
    return _with_forms(made, forms(len(layers_of(d))))


def _some_raw(made: Scene, *names: str) -> Scene:
    """Returns the scene with some layers raw, and the others packed."""
    return _with_forms(made, np.array([name not in names for name, _, _ in layers_of(made.dimensions)]))


# fmt: off
_TINY, _INTEGER = 2.0**-149, (1 << 24) - 1
# The least and the largest exponent of a layer and of a row, and integers at the limit.
_LIMITS = (
    ("opacity.0", 0, 0, _TINY), ("opacity.0", 1, 2.0**104, 0), ("opacity.0", 2, _TINY * _INTEGER, 0),
    ("covariance.0", 0, -_INTEGER, _INTEGER), ("covariance.0", 1, 2.0**104, -(2.0**127)),
    ("covariance.0", 2, 2.0**104 * _INTEGER, 2.0**104), ("colour.0", 0, 2.0**104, 0))
# -0, an odd integer beyond the limit, and exponents beyond their limits, and a row of zeros in a raw layer.
_BEYOND = (
    ("hyper.0", (0, 0), -0.0, None), ("covariance.1", 3, None, -0.0), ("opacity.0", np.s_[0, :2], (2.0**24, 1), None),
    ("opacity.1", 0, 0, 0), ("opacity.1", (0, 0), 2.0**105, None), ("colour.0", np.s_[1, :2], (3.0e38, _TINY), None),
    ("colour.0", 0, 0, 0))
_SUBNORMAL = tuple(
    values for name, tiny in (("hyper", _TINY), ("opacity", _TINY), ("colour", (2.0**23 - 1) * _TINY))
    for values in ((f"{name}.0", ALL, 1, 1), (f"{name}.0", (0, 0), tiny, None)))
_NOTHING = (("opacity", ALL, 0, 0), ("colour", ALL, 0, 0))
_SCALED = tuple(
    values for layer in ("opacity.0", "covariance.0")
    for values in ((layer, ALL, 0, 0), (layer, (0, 0), _INTEGER, None), (layer, (1, 0), 2.0**-30, None)))
_PLANES = "and the bytes of the planes make none"
CASES = [
    # The section's end, and the models of layers.
    *refused("packed-weights", "truncation lengths-trusted", (grids, cut),
        ("grids-nothing", "a section of weights without a byte", None, 0),
        ("grids-cut-in-table", "the section ends within its table", None, 1),
        ("grids-cut-in-padding", "the section ends within the padding of its table", None, 3),
        ("grids-cut-behind-table", "the section ends behind its table", None, 4),
        ("grids-cut-in-model", "the section ends within a layer's model", "sarm.1", 5),
        ("grids-cut-in-reserved", "the section ends within the reserved bytes of a layer's model", "hyper.1", 7),
        ("grids-cut-in-values", "the section ends within the values of a raw layer", "hyper.0", 9),
        ("grids-cut-before-model", f"the weights end before a layer's model, {_PLANES}", "sarm.1", 0),
        ("grids-cut-in-exponent", f"the weights end within the exponent of a layer, {_PLANES}", "sarm.1", 2),
        ("grids-cut-in-last-model", f"the weights end within the model of the last layer, {_PLANES}", "colour.1", 3),
        (_last_raw, cut, "colour.1"),
        ("grids-cut-in-last-values", "the section ends within the values of its last layer, which is raw", 15),
        ("grids-cut-by-one", "the section ends one byte before the values of its last layer do", 31)),
    *refused("packed-weights", "limit-off-by-one reserved-unchecked", (grids, model_field),
        ("grids-form-2", "form 2", "hyper.1", "form", 2),
        ("grids-exponent-150", "exponent 150", "sarm.0", "exponent", 150),
        ("grids-exponent-minus-105", "exponent -105", "sarm.0", "exponent", -105),
        ("grids-raw-exponent", "a raw layer with an exponent", "hyper.0", "exponent", 1),
        ("grids-raw-exponent-below", "a raw layer with an exponent of -1", "hyper.0", "exponent", -1),
        ("grids-raw-exponent-scale", "a raw layer with a scale of exponents", "hyper.0", "exponent_scale", 1),
        ("grids-raw-weight-scale", "a raw layer with a scale of weights", "hyper.0", "weight_scale", 1),
        ("grids-raw-bias-scale", "a raw layer with a scale of biases", "hyper.0", "bias_scale", 255)),
    *refused("packed-weights", "reserved-unchecked", *(
        (f"grids-reserved-{name}", f"a reserved byte of a layer's model that is not zero: {name}", grids, reserved,
         layer, item, 1)
        for name, layer, item in (("raw", "hyper.0", 0), ("packed", "opacity.1", 1), ("last", "colour.1", 1)))),

    # Exponents of rows.
    *refused("packed-weights", "grid-exponent zero-rows",
        ("grids-exponent-even", "a row whose integers are all even", grids, even_integers, "hyper.1"),
        ("grids-exponent-first-difference", "a first row whose exponent is not the model's", grids, difference,
         "sarm.1", 0, 1),
        ("grids-exponent-outside-above", "an exponent above the largest", grids, difference, "opacity.1", -1, 1000),
        ("grids-exponent-outside-below", "an exponent below the least", grids, difference, "opacity.0", -1, -1000),
        ("grids-exponent-of-row-150", "a row with the exponent 150", grids, difference, "hyper.1", -1,
         _until("hyper.1", WEIGHT_EXPONENT_MAX + 1)),
        ("grids-exponent-of-row-minus-105", "a row with the exponent -105", grids, difference, "opacity.0", -1,
         _until("opacity.0", WEIGHT_EXPONENT_MIN - 1)),
        ("grids-exponent-far-outside", "exponents of eight digits", grids, difference, "hyper.1", -1, (1 << 24) - 1),
        ("grids-exponent-zero-row-differs", "a row of zeros with an exponent of its own", grids, row_of_zeros,
         "hyper.1", -1, 3),
        ("grids-exponent-zero-layer-exponent", "a layer of zeros with an exponent", grids, layer_of_zeros, "sarm.1", 7),
        ("grids-exponent-zero-row-first", "a difference in the first row, which is all zero", grids, row_of_zeros,
         "hyper.1", 0, 2)),
    *refused("packed-weights", "grid-exponent", (grids, even_integers),
        ("exponent-even-first", "a first row whose integers are all even, odd ones behind it", "hyper.1", 1),
        ("grids-exponent-even-least", f"rows of the exponent {WEIGHT_EXPONENT_MIN}, whose integers are all even",
         "opacity.0", None, WEIGHT_EXPONENT_MIN, More("limit-off-by-one")), requirements="D7.13-1"),

    # Valid files.
    *valid("packed-weights", "", "D7.13-1",
        ("packed-weights", "every layer packed", lambda: packed_weights(drawn("packed-weights", 4)),
         More("grid-exponent", "D9.3-1")),
        ("packed-weights-chosen", "weights as the reference encoder packs them",
         lambda: pack_weights(drawn("packed-weights-chosen", 4)), More("grid-exponent")),
        ("grids-limits", "exponents and integers at their limits", _regular, "grids-limits", *_LIMITS,
         More("grid-exponent symbol-limit limit-off-by-one", "R6.8-8 R6.8-7")),
        ("grids-subnormal", "a layer of subnormal numbers, each integer of another length", _regular, "grids-subnormal",
         ("colour.0", ALL, _lengths, lambda b: np.ldexp(np.ldexp(1.0, 1 + np.arange(len(b)) % 23) - 1, -149)),
         More("subnormals"))),
    *valid("packed-weights", "", "D7.13-1 R6.8-8",
        ("grids-zeros", "rows of zeros at the beginning, between and at the end of a layer, and layers of zeros",
         _regular, "grids-zeros", ("opacity.0", [0, 1], 0, 0), ("colour.0", 1, 0, 0), ("covariance.0", 2, 0, 0),
         ("opacity.-1", ALL, 0, 0), ("carm.1.-1", ALL, 0, 0), More("zero-rows")),
        ("grids-differences", "exponents that rise and fall from row to row", _regular, "grids-differences",
         ("*", ALL, _fall, _fall), More("grid-exponent")),
        ("grids-biases", "rows whose exponent is that of the bias", _regular, "grids-biases",
         ("*.0", ALL, lambda w: np.round(w) * 2, lambda b: np.round(b) + np.float32(0.5)),
         ("*.0", slice(None, None, 2), None, 1), More("grid-exponent")),
        *((f"grids-scales-{value}", f"all scale indices {value}", _one_scale, value,
           More("grid-scales raw-width", "D8.5-1 D8.7-1")) for value in (0, 255)),
        ("grids-scales", "scale indices of their own for exponents, weights and biases of each layer", _own_scales,
         More("grid-scales", "D8.5-1")),
        ("grids-escapes", "integers of each length, far beyond their scale", _low_scales,
         More("escape-prefix escape-sign raw-before-escapes", "D8.6-1 D8.7-1")),
        ("grids-lanes", "a substream of 256 lanes", lambda: replace(_regular("grids-lanes"), lanes=Lanes(0, 0, 8)),
         More("lane-order idle-lanes", "D8.3-1"))),

    # Raw because no grid contains the values.
    *valid("packed-weights", "raw-layer", "D7.13-1 R6.8-7 R6.8-3", (_regular, NAME),
        ("grids-raw-layers", "layers that are raw: -0, integers and exponents beyond the limits", *_BEYOND),
        ("grids-raw-all", "every layer raw, and a substream of no symbols", ("*", 0, None, -0.0),
         More("empty-substream"))),
    *valid("packed-weights", "raw-layer grid-exponent", "R6.8-7 R6.8-3 D7.13-1",
        ("grids-last-bias", "a layer that is raw because of its last bias alone", lambda: packed_weights(
             _small("planted-last-bias", ("opacity.0", ALL, 1, 1), ("opacity.0", 2, None, 2.0**-24), render_width=3)))),
    *valid("packed-weights", "subnormals raw-layer grid-exponent", "D7.13-1 R6.8-7",
        ("grids-raw-subnormal", "layers that are raw because of one subnormal number", lambda: packed_weights(
             settled(_small("outside-least", *_SUBNORMAL))))),

    # Raw by choice.
    *valid("packed-weights", "raw-layer", "D7.13-1 R6.8-7 R6.8-5", (_chosen, NAME),
        ("grids-raw-by-choice", "every second layer raw, all of which could be packed", lambda n: np.arange(n) % 2,
         More("canonical-form")),
        ("grids-raw-all-by-choice",
         "every layer raw, none of which has to be: as in mode 0, but for the models and the substream", np.zeros,
         More("empty-substream canonical-form")),
        ("grids-packed-one", "the last layer packed, all others raw", lambda n: np.arange(n) == n - 1)),
    *valid("packed-weights", "raw-layer", "D7.13-1",
        ("grids-raw-of-zeros", "raw layers of zeros, and packed ones", lambda: _some_raw(
             settled(with_weights(scene("grids-raw-of-zeros", 2, SMALLEST), *_NOTHING)), "opacity.0", "colour.1"),
         More("zero-rows", "R6.8-7")),
        ("grids-raw-at-the-limit",
         "the largest integer in one row and a far smaller number in another, in a raw and in a packed layer",
         lambda: _some_raw(_small("planted-scaled", *_SCALED, render_width=2), "opacity.0"),
         More("limit-off-by-one", "R6.8-7")),
        ("grids-no-inputs-packed", "a layer of F_h that has no inputs, packed", _chosen, "grids-no-inputs-packed",
         np.ones, CONSTANT, More("grid-exponent empty-refused", "R6.8-8")),
        ("grids-no-inputs-raw", "a layer of F_h that has no inputs, raw", _chosen, "grids-no-inputs-raw", np.zeros,
         CONSTANT, More("grid-exponent empty-refused", "R6.8-7"))),
]
