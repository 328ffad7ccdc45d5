"""Cases of clauses 5.9, 6.8 and 7.13: weights in mode 1, as integers on grids. Raw layers are in weights_forms.py."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial

import numpy as np

from refcodec.bitstream import codec, weights
from refcodec.bitstream.dimensions import layers_of
from refcodec.bitstream.directory import WEIGHTS
from refcodec.bitstream.entropy import Coder, Encoder
from refcodec.bitstream.header import Lanes
from refcodec.bitstream.scene import Scene
from refcodec.bitstream.weights import WEIGHT_EXPONENT_MAX, WEIGHT_EXPONENT_MIN, GridLayer
from refcodec.encoder.weights import pack_weights

from .book import Book
from .checksums import resized
from .fault import Draw, Drawn, Edit, Refused, Whole, fault, one_field
from .numbers import Int64, Numbers
from .samplers import Sampler, drawn, sampled
from .scenes import (
    SMALLEST,
    TINY_DIMENSIONS,
    Networks,
    dyadic,
    packed_weights,
    scales,
    scene,
)
from .target import Target
from .targets import SEEDS, grids

# --- faults -----------------------------------------------------------------------------------------------------------


def _any_grids(draw: Draw) -> Target:
    return grids(draw.integer(0, SEEDS - 1))


@fault("weights.length")
def cut(t: Target, layer: str | None, more: int) -> Whole:
    """The section ends some bytes after the start of a layer's model, or of the section without a layer."""
    start = t.start(WEIGHTS)
    end = (start if layer is None else t.layer_at(layer)) + more
    return Whole(resized(t.data, WEIGHTS, t.data[start:end]), start)


@cut.drawn
def _(draw: Draw, t: Target) -> Drawn:
    t = _any_grids(draw)
    layer = draw.choice([None, *t.layers])
    return t, layer, draw.integer(0, 3 if layer is None else 7)


@fault("weights.layer")
def model_field(t: Target, layer: str, field: str, value: int) -> Edit:
    """A field of a layer's model is outside its limits, or not 0 for a raw layer."""
    return one_field(t, f"weights.{layer}.{field}", value)


@model_field.drawn
def _(draw: Draw, t: Target) -> Drawn:
    t = _any_grids(draw)
    raw = t.layers[0]
    wrong = [(layer, "form", value) for layer in t.layers for value in (2, 255)]
    wrong += [(layer, "exponent", value) for layer in t.layers for value in (150, -105, 32767, -32768)]
    wrong += [(raw, "exponent", value) for value in (1, -1, 149, -104)]
    wrong += [(raw, field, value) for field in ("exponent_scale", "weight_scale", "bias_scale") for value in (1, 255)]
    return t, *draw.choice(wrong)


@fault("weights.reserved")
def reserved(t: Target, layer: str, item: int, value: int) -> Edit:
    """A reserved byte of a layer's model is not zero. The first of these bytes is reported."""
    path = f"weights.{layer}.reserved"
    return Edit(t.pack({f"{path}[{item}]": value}), t.at(f"{path}[0]"))


@reserved.drawn
def _(draw: Draw, t: Target) -> Drawn:
    t = _any_grids(draw)
    return t, draw.choice(t.layers), draw.integer(0, 1), draw.integer(1, 255)


def with_integers(
    t: Target, layer: str, change: Callable[[GridLayer], GridLayer], coder: Callable[[Encoder], Coder] = lambda e: e
) -> Whole:
    """Returns the file with other integers in a packed layer, validly coded. The offset is that of the layer's model.

    coder: codes them with an encoder.
    """
    made = codec.parse(t.data).scene
    assert made.weight_scales is not None
    shapes, wrong = layers_of(made.dimensions), t.layers.index(layer)
    found = [weights.to_grid(values) for network in made.networks.values() for values in network]
    coded = {i: grid for i, grid in enumerate(found) if grid is not None}
    coded[wrong] = change(coded[wrong])
    encoder = Encoder(1, 1 << made.lanes.attribute)
    scale = made.weight_scales[list(coded)]
    weights.code_grids(coder(encoder), [shapes[i] for i in coded], scale, list(coded.values()))
    start, stream = t.start(WEIGHTS), t.substreams["weights"].start
    models = bytearray(t.data[start:stream])
    for at, value in t.pack({f"weights.{layer}.exponent": coded[wrong].exponent}).items():
        models[at - start : at - start + len(value)] = value
    return Whole(resized(t.data, WEIGHTS, bytes(models) + encoder.finish()[0]), t.layer_at(layer))


def _packed_layer(draw: Draw, t: Target) -> str:
    """Draws the name of a packed layer."""
    return draw.choice(t.layers[1:])


@fault("weights.exponent")
def even_integers(t: Target, layer: str, rows: int | None = None, exponent: int | None = None) -> Whole:
    """The first rows of a layer, or all, have only even integers. exponent: of all rows, if it changes."""

    def change(g: GridLayer) -> GridLayer:
        weight, bias = g.weight.copy(), g.bias.copy()
        weight[:rows], bias[:rows] = weight[:rows] * 2, bias[:rows] * 2
        if exponent is not None:
            g = replace(g, exponent=exponent, difference=g.difference * 0)
        return replace(g, weight=weight, bias=bias)

    return with_integers(t, layer, change)


@even_integers.drawn
def _(draw: Draw, t: Target) -> Drawn:
    t = _any_grids(draw)
    return t, _packed_layer(draw, t), draw.choice([1, None])


@fault("weights.exponent")
def first_difference(t: Target, layer: str, value: int) -> Whole:
    """The exponent of the first row is not the model's."""
    return with_integers(t, layer, lambda g: replace(g, difference=_with(g.difference, 0, value)))


@first_difference.drawn
def _(draw: Draw, t: Target) -> Drawn:
    t = _any_grids(draw)
    return t, _packed_layer(draw, t), draw.choice([1, -1, 5])


@fault("weights.exponent")
def last_difference(t: Target, layer: str, value: int) -> Whole:
    """The exponent of the last row is outside the limits."""
    return with_integers(t, layer, lambda g: replace(g, difference=_with(g.difference, -1, value)))


@last_difference.drawn
def _(draw: Draw, t: Target) -> Drawn:
    t = _any_grids(draw)
    return t, _packed_layer(draw, t), draw.choice([1000, -1000, (1 << 24) - 1, 1 - (1 << 24)])


@fault("weights.exponent")
def last_row_of_zeros(t: Target, layer: str, difference: int) -> Whole:
    """A last row of zeros has a different exponent."""

    def change(g: GridLayer) -> GridLayer:
        weight = g.weight.copy()
        weight[-1] = 0
        return GridLayer(g.exponent, _with(g.difference, -1, difference), weight, _with(g.bias, -1, 0))

    return with_integers(t, layer, change)


@last_row_of_zeros.drawn
def _(draw: Draw, t: Target) -> Drawn:
    t = _any_grids(draw)
    return t, _packed_layer(draw, t), draw.choice([1, -1, 3])


@fault("weights.exponent")
def first_row_of_zeros(t: Target, layer: str, difference: int) -> Whole:
    """A first row of zeros has a difference, which the second row cancels."""

    def change(g: GridLayer) -> GridLayer:
        differences, weight = np.zeros_like(g.difference), g.weight.copy()
        differences[:2] = [difference, -difference][: len(differences)]
        weight[0] = 0
        return GridLayer(g.exponent, differences, weight, _with(g.bias, 0, 0))

    return with_integers(t, layer, change)


@first_row_of_zeros.drawn
def _(draw: Draw, t: Target) -> Drawn:
    t = _any_grids(draw)
    return t, _packed_layer(draw, t), draw.choice([2, -2])


@fault("weights.exponent")
def layer_of_zeros(t: Target, layer: str, exponent: int) -> Whole:
    """A layer of zeros has a nonzero exponent."""

    def change(g: GridLayer) -> GridLayer:
        return GridLayer(exponent, g.difference * 0, g.weight * 0, g.bias * 0)

    return with_integers(t, layer, change)


@layer_of_zeros.drawn
def _(draw: Draw, t: Target) -> Drawn:
    t = _any_grids(draw)
    return t, _packed_layer(draw, t), draw.choice([1, 7, -104])


def _with(values: Int64, at: int, value: int) -> Int64:
    """Returns the integers with a changed one."""
    found = values.copy()
    found[at] = value
    return found


# --- the suite's refused files ----------------------------------------------------------------------------------------


def add(book: Book) -> None:
    """Adds the vectors."""
    _refused(book)
    _exponents(book)
    _valid(book)


@cache
def _last_raw() -> Target:
    """Returns a file in mode 1 with a raw last layer."""
    made = scene("planted-cut", 2, SMALLEST, lanes=Lanes(0, 0, 1))
    made.networks["colour"][1][1][0] = -0.0
    return Target(codec.emit(packed_weights(made)))


def _refused(book: Book) -> None:
    add = partial(book.add, features="packed-weights")
    behind = "and the bytes of the planes make none"
    cuts: list[tuple[str, str, Callable[[], Target], str | None, int]] = [
        ("nothing", "a section of weights without a byte", grids, None, 0),
        ("cut-in-table", "the section ends within its table", grids, None, 1),
        ("cut-in-padding", "the section ends within the padding of its table", grids, None, 3),
        ("cut-behind-table", "the section ends behind its table", grids, None, 4),
        ("cut-in-model", "the section ends within a layer's model", grids, "sarm.1", 5),
        ("cut-in-reserved", "the section ends within the reserved bytes of a layer's model", grids, "hyper.1", 7),
        ("cut-in-values", "the section ends within the values of a raw layer", grids, "hyper.0", 9),
        ("cut-before-model", f"the weights end before a layer's model, {behind}", grids, "sarm.1", 0),
        ("cut-in-exponent", f"the weights end within the exponent of a layer, {behind}", grids, "sarm.1", 2),
        ("cut-in-last-model", f"the weights end within the model of the last layer, {behind}", grids, "colour.1", 3),
        (
            "cut-in-last-values",
            "the section ends within the values of its last layer, which is raw",
            _last_raw,
            "colour.1",
            15,
        ),
        ("cut-by-one", "the section ends one byte before the values of its last layer do", _last_raw, "colour.1", 31),
    ]
    for name, title, base, layer, more in cuts:
        add(f"malformed-grids-{name}", title, cut.of(base, layer, more), flags="truncation lengths-trusted")
    for name, title, of_layer, field, value in (
        ("form-2", "form 2", "hyper.1", "form", 2),
        ("exponent-150", "exponent 150", "sarm.0", "exponent", 150),
        ("exponent-minus-105", "exponent -105", "sarm.0", "exponent", -105),
        ("raw-exponent", "a raw layer with an exponent", "hyper.0", "exponent", 1),
        ("raw-exponent-below", "a raw layer with an exponent of -1", "hyper.0", "exponent", -1),
        ("raw-exponent-scale", "a raw layer with a scale of exponents", "hyper.0", "exponent_scale", 1),
        ("raw-weight-scale", "a raw layer with a scale of weights", "hyper.0", "weight_scale", 1),
        ("raw-bias-scale", "a raw layer with a scale of biases", "hyper.0", "bias_scale", 255),
    ):
        make = model_field.of(grids, of_layer, field, value)
        add(f"invalid-grids-{name}", title, make, flags="limit-off-by-one reserved-unchecked")
    for name, of_layer, item in (("raw", "hyper.0", 0), ("packed", "opacity.1", 1), ("last", "colour.1", 1)):
        title = f"a reserved byte of a layer's model that is not zero: {name}"
        make = reserved.of(grids, of_layer, item, 1)
        add(f"unsupported-grids-reserved-{name}", title, make, flags="reserved-unchecked")


def _last_exponent(layer: str, exponent: int) -> Callable[[], Refused]:
    """Returns a function that makes a file whose last row of a layer has an exponent."""

    def made() -> Refused:
        t = grids()
        name, _, number = layer.rpartition(".")
        grid = weights.to_grid(codec.parse(t.data).scene.networks[name][int(number)])
        assert grid is not None
        return last_difference(t, layer, exponent - grid.exponent - int(grid.difference[:-1].sum()))

    return made


def _exponents(book: Book) -> None:
    add = partial(book.add, features="packed-weights")
    rows = [
        ("even", "a row whose integers are all even", even_integers.of(grids, "hyper.1")),
        ("first-difference", "a first row whose exponent is not the model's", first_difference.of(grids, "sarm.1", 1)),
        ("outside-above", "an exponent above the largest", last_difference.of(grids, "opacity.1", 1000)),
        ("outside-below", "an exponent below the least", last_difference.of(grids, "opacity.0", -1000)),
        ("of-row-150", "a row with the exponent 150", _last_exponent("hyper.1", WEIGHT_EXPONENT_MAX + 1)),
        ("of-row-minus-105", "a row with the exponent -105", _last_exponent("opacity.0", WEIGHT_EXPONENT_MIN - 1)),
        ("far-outside", "exponents of eight digits", last_difference.of(grids, "hyper.1", (1 << 24) - 1)),
        ("zero-row-differs", "a row of zeros with an exponent of its own", last_row_of_zeros.of(grids, "hyper.1", 3)),
        ("zero-layer-exponent", "a layer of zeros with an exponent", layer_of_zeros.of(grids, "sarm.1", 7)),
        (
            "zero-row-first",
            "a difference in the first row, which is all zero",
            first_row_of_zeros.of(grids, "hyper.1", 2),
        ),
    ]
    for name, title, make in rows:
        add(f"invalid-grids-exponent-{name}", title, make, flags="grid-exponent zero-rows")
    add(
        "invalid-exponent-even-first",
        "a first row whose integers are all even, odd ones behind it",
        even_integers.of(grids, "hyper.1", 1),
        requirements="D7.13-1",
        flags="grid-exponent",
    )
    add(
        "invalid-grids-exponent-even-least",
        f"rows of the exponent {WEIGHT_EXPONENT_MIN}, whose integers are all even",
        even_integers.of(grids, "opacity.0", None, WEIGHT_EXPONENT_MIN),
        requirements="D7.13-1",
        flags="grid-exponent limit-off-by-one",
    )


# --- the suite's valid files ------------------------------------------------------------------------------------------


def regular(name: str, change: Callable[[Networks], None]) -> Scene:
    """Returns a scene with changed, packed networks. The symbols are drawn after the change."""
    made = scene(name, 3)
    change(made.networks)
    return sampled(packed_weights(made), Sampler(Numbers(f"{name}/symbols")))


def _valid(book: Book) -> None:
    add = partial(book.valid, features="packed-weights")
    add(
        "packed-weights",
        "every layer packed",
        lambda: packed_weights(drawn("packed-weights", 4)),
        requirements="D7.13-1 D9.3-1",
        flags="grid-exponent",
    )
    add(
        "packed-weights-chosen",
        "weights as the reference encoder packs them",
        lambda: pack_weights(drawn("packed-weights-chosen", 4)),
        requirements="D7.13-1",
        flags="grid-exponent",
    )
    add(
        "grids-limits",
        "exponents and integers at their limits",
        partial(regular, "grids-limits", _limits),
        requirements="D7.13-1 R6.8-8 R6.8-7",
        flags="grid-exponent symbol-limit limit-off-by-one",
    )
    add(
        "grids-subnormal",
        "a layer of subnormal numbers, each integer of another length",
        partial(regular, "grids-subnormal", _subnormals),
        requirements="D7.13-1",
        flags="subnormals",
    )
    add(
        "grids-zeros",
        "rows of zeros at the beginning, between and at the end of a layer, and layers of zeros",
        partial(regular, "grids-zeros", _zeros),
        requirements="D7.13-1 R6.8-8",
        flags="zero-rows",
    )
    add(
        "grids-differences",
        "exponents that rise and fall from row to row",
        partial(regular, "grids-differences", _differences),
        requirements="D7.13-1 R6.8-8",
        flags="grid-exponent",
    )
    add(
        "grids-biases",
        "rows whose exponent is that of the bias",
        partial(regular, "grids-biases", _biases),
        requirements="D7.13-1 R6.8-8",
        flags="grid-exponent",
    )
    for value in (0, 255):
        add(
            f"grids-scales-{value}",
            f"all scale indices {value}",
            partial(_one_scale, value),
            requirements="D7.13-1 R6.8-8 D8.5-1 D8.7-1",
            flags="grid-scales raw-width",
        )
    add(
        "grids-scales",
        "scale indices of their own for exponents, weights and biases of each layer",
        _own_scales,
        requirements="D7.13-1 R6.8-8 D8.5-1",
        flags="grid-scales",
    )
    add(
        "grids-escapes",
        "integers of each length, far beyond their scale",
        _escapes,
        requirements="D7.13-1 R6.8-8 D8.6-1 D8.7-1",
        flags="escape-prefix escape-sign raw-before-escapes",
    )
    add(
        "grids-lanes",
        "a substream of 256 lanes",
        lambda: replace(regular("grids-lanes", lambda n: None), lanes=Lanes(0, 0, 8)),
        requirements="D7.13-1 R6.8-8 D8.3-1",
        flags="lane-order idle-lanes",
    )


def _limits(n: Networks) -> None:
    # The least and the largest exponent of a layer and of a row, and integers at the limit.
    w, b = n["opacity"][0]
    w[0], b[0] = 0, np.float32(2.0**-149)
    w[1], b[1] = 2.0**104, 0
    w[2], b[2] = np.float32(2.0**-149 * ((1 << 24) - 1)), 0
    w, b = n["covariance"][0]
    w[0], b[0] = 1 - (1 << 24), (1 << 24) - 1
    w[1], b[1] = 2.0**104, -(2.0**127)
    w[2], b[2] = float(np.float32(2.0**104 * ((1 << 24) - 1))), 2.0**104
    w, b = n["colour"][0]
    w[0], b[0] = 2.0**104, 0


def _subnormals(n: Networks) -> None:
    # Odd multiples of 2^-149 from 1 bit to 24, of which only those of 24 bits are normal numbers.
    w, b = n["colour"][0]
    lengths = np.arange(w.size).reshape(w.shape) % 24
    sign = np.where(lengths % 3 == 1, -1.0, 1.0)
    w[:] = sign * np.ldexp(np.ldexp(1.0, lengths) + (lengths > 0), -149)
    b[:] = np.ldexp(np.ldexp(1.0, 1 + np.arange(len(b)) % 23) - 1, -149)


def _zeros(n: Networks) -> None:
    for name, rows in (("opacity", [0, 1]), ("colour", [1]), ("covariance", [2])):
        w, b = n[name][0]
        w[rows], b[rows] = 0, 0
    # Whole layers.
    for name in ("opacity", "carm.1"):
        w, b = n[name][-1]
        w[:], b[:] = 0, 0


def _differences(n: Networks) -> None:
    for layers in n.values():
        for w, b in layers:
            rows = np.arange(len(w))
            e = (-1) ** rows * (rows % 23) if len(w) > 40 else rows * -3
            e = np.clip(e, -20, 0)
            w[:] = np.ldexp(w, e[:, None])
            b[:] = np.ldexp(b, e)


def _biases(n: Networks) -> None:
    # Only the bias is odd, or only it has the row's exponent.
    for layers in n.values():
        w, b = layers[0]
        w[:] = np.round(w) * 2
        b[:] = np.round(b) + np.float32(0.5)
        b[::2] = 1


def _one_scale(value: int) -> Scene:
    made = scene(f"grids-scales-{value}", 2, SMALLEST)
    return replace(made, weight_scales=np.full((len(layers_of(SMALLEST)), 3), value, np.uint8))


def _own_scales() -> Scene:
    layers = range(len(layers_of(TINY_DIMENSIONS)))
    rows = np.array([[40 + 13 * r % 90, 90 - 7 * r % 60, 60 + 5 * r % 50] for r in layers])
    return replace(scene("grids-scales", 2), weight_scales=rows.astype(np.uint8))


def _escapes() -> Scene:
    def change(n: Networks) -> None:
        numbers = Numbers("grids-escapes")
        w, b = n["colour"][0]
        values = [s * ((1 << z) | 1) for z in range(1, 24) for s in (1, -1)] + [(1 << 24) - 1, 1 - (1 << 24)]
        w[:] = dyadic(numbers.chosen(values, *w.shape), 0)
        b[:] = dyadic(numbers.chosen(values, len(b)), 0)

    made = regular("grids-escapes", change)
    return replace(made, weight_scales=np.minimum(scales(made.networks), 60).astype(np.uint8))
