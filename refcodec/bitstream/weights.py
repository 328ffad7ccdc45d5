"""Clauses 5.8, 5.9, 6.8 and 7.13: the weights, raw or as integers on grids."""

from dataclasses import dataclass

import construct as cs
import numpy as np
from numpy.typing import NDArray

from ..native.library import Kernel
from ..native.scene import weight_symbols
from . import syntax
from .conventions import Int64
from .dimensions import Dimensions, layers_of
from .entropy import Coder, Decoder, Encoder, Trace, ValueGroup, parse_substream
from .errors import BitstreamError
from .kernel import substream_error
from .networks import F32, BoundError, Layer
from .source import Piece, pad4
from .tables import SCALE_MIN, tables, tables_bytes

# SPEC 6.8
PLANE_SHIFT_MAX = 10
CARM_SHIFT_MAX = 16
WEIGHT_EXPONENT_MIN, WEIGHT_EXPONENT_MAX = -104, 149
# SPEC 7.13
WEIGHT_SYMBOL_MAX = (1 << 24) - 1
Networks = dict[str, list[Layer]]


@dataclass(frozen=True, eq=False)
class ParsedWeights:
    """SPEC 5.8: the section of weights.

    carm_shift: uint8 [CARM inputs].
    networks: the layers of each network, by name.
    scales, forms: uint8 [layers, 3] and uint8 [layers], as in Scene. None in mode 0.
    starts: the offset of each layer, by the layer's name: of its values in mode 0, of its LayerModel in mode 1.
    """

    plane_shift: int
    carm_shift: NDArray[np.uint8]
    networks: Networks
    scales: NDArray[np.uint8] | None
    forms: NDArray[np.uint8] | None
    starts: dict[str, int]


def bound_error(weights: ParsedWeights, d: Dimensions, error: BoundError) -> BitstreamError:
    """SPEC [R6.8-4]: returns the error weights.bound of a row.

    Its offset is that of the row's first weight, or of its bias if it has no weights, or in mode 1 of the LayerModel.
    """
    at = weights.starts[error.layer]
    if weights.scales is None:
        fan_in = next(fan_in for name, _, fan_in in layers_of(d) if name == error.layer)
        at += 4 * max(fan_in, 1) * error.row
    return BitstreamError("weights.bound", at, f"weights.{error.layer}", error.found, error.allowed)


@dataclass(frozen=True)
class GridLayer:
    """SPEC 7.13: the integers of a packed layer.

    exponent: of the LayerModel. difference: int64 [out], of each row's exponent from that of the previous row.
    weight: int64 [out, in]. bias: int64 [out].
    """

    exponent: int
    difference: Int64
    weight: Int64
    bias: Int64


def _regrouped(d: Dimensions, layers: list[Layer]) -> Networks:
    """Returns layers, given in file order, by network."""
    rest = iter(layers)
    return {name: [next(rest) for _ in shapes] for name, shapes in d.network_shapes().items()}


def least_exponents(values: F32) -> tuple[Int64, NDArray[np.bool_]]:
    """SPEC 7.13: returns the least exponent of each row, and whether the row has one.

    values: float32 [rows, n], finite. The results are int64 [rows] and bool [rows]. A row of zeros has no exponent.
    """
    significand, exponent = np.frexp(values.astype(np.float64))
    # The lowest set bit of a significand is its least power of two. This is exact in float64.
    integer = np.abs(significand * 2.0**53).astype(np.int64)
    lowest = np.frexp((integer & -integer).astype(np.float64))[1] - 1 + exponent - 53
    some = values != 0
    return -np.where(some, lowest, 1 << 10).min(axis=1).astype(np.int64), np.asarray(some.any(axis=1))


def to_grid(layer: Layer) -> GridLayer | None:
    """SPEC 7.13: returns a finite layer as integers, or None if it must be raw."""
    values = np.concatenate([layer[0], layer[1][:, None]], axis=1)
    if (values.view(np.uint32) == 0x80000000).any():
        return None
    least, some = least_exponents(values)
    least, inside = np.where(some, least, 0), (least >= WEIGHT_EXPONENT_MIN) & (least <= WEIGHT_EXPONENT_MAX)
    if not (inside | ~some).all():
        return None
    scaled = np.ldexp(values.astype(np.float64), least[:, None])
    if np.abs(scaled).max() > WEIGHT_SYMBOL_MAX:
        return None
    # A row of zeros has the exponent of the previous row. The first rows, if zero, have that of the first other row.
    row = np.maximum.accumulate(np.where(some, np.arange(len(some)), 0))
    row[: int(np.argmax(some))] = int(np.argmax(some))
    exponent = least[row]
    integers = scaled.astype(np.int64)
    return GridLayer(int(exponent[0]), np.diff(exponent, prepend=exponent[:1]), integers[:, :-1], integers[:, -1])


def from_grid(grid: GridLayer) -> Layer | None:
    """SPEC 7.13, PACKED_LAYER: returns the values of a layer, or None if an exponent is wrong."""
    integers = np.concatenate([grid.weight, grid.bias[:, None]], axis=1)
    exponent = grid.exponent + np.cumsum(grid.difference)
    odd, zero = (integers & 1).any(axis=1), ~integers.any(axis=1)
    first: NDArray[np.bool_] = np.cumsum(~zero) - ~zero == 0
    right = (exponent >= WEIGHT_EXPONENT_MIN) & (exponent <= WEIGHT_EXPONENT_MAX) & (odd | zero)
    right &= (grid.difference == 0) | ~(zero | first)
    if not right.all() or (zero.all() and grid.exponent):
        return None
    values = np.ldexp(integers.astype(np.float64), -exponent[:, None]).astype(np.float32)
    return np.ascontiguousarray(values[:, :-1]), np.ascontiguousarray(values[:, -1])


def code_grids(
    coder: Coder, shapes: list[tuple[str, int, int]], scales: NDArray[np.uint8], given: list[GridLayer] | None = None
) -> tuple[list[tuple[Int64, Int64]], list[Int64]]:
    """SPEC 7.13, DECODE_WEIGHTS: codes the packed layers, in either direction.

    Returns a list of (differences, biases), int64 [out], and a list of weights, int64 [out, in], both by layer. shapes:
    (name, outputs, inputs) of each. scales: uint8 [layers, 3]. given: the layers, for encoding.
    """
    known: list[Int64 | None] = [None, None]
    if given is not None:
        known = [np.concatenate([np.zeros(0, np.int64), *parts]) for parts in (
            [part for g in given for part in (g.difference, g.bias)],
            [g.weight.reshape(-1) for g in given],
        )]  # fmt: skip
    grids = []
    families = (tables().laplace, tables().gauss)
    for models, parts, scale, values in zip(families, _parts(shapes), _scales(shapes, scales), known, strict=True):
        ends = np.cumsum([0, *(count for _, count in parts)])

        def name(_: int, index: int, ends: Int64 = ends, parts: list[tuple[str, int]] = parts) -> str:
            part = int(np.searchsorted(ends, index, side="right")) - 1
            return f"{parts[part][0]}[{index - ends[part]}]"

        each = scale.astype(np.int64) + SCALE_MIN
        mean, counts = np.zeros(len(each), np.int64), [len(each)]
        grids.append(coder.values(ValueGroup(models, mean, each, counts, WEIGHT_SYMBOL_MAX, name, values)))
    return _by_layer(shapes, grids)


def _parts(shapes: list[tuple[str, int, int]]) -> tuple[list[tuple[str, int]], list[tuple[str, int]]]:
    """SPEC 7.13: returns the parts of both groups, each as a name and a number of symbols."""
    few = [(f"weights.{name}.{part}", out) for name, out, _ in shapes for part in ("exponent", "bias")]
    return few, [(f"weights.{name}.weight", out * fan_in) for name, out, fan_in in shapes]


def _scales(shapes: list[tuple[str, int, int]], scales: NDArray[np.uint8]) -> list[NDArray[np.uint8]]:
    """SPEC 7.13: returns for both groups the scale index of each symbol, less SCALE_MIN, uint8 [symbols]."""
    own = (scales[:, [0, 2]].reshape(-1), scales[:, 1])
    return [np.repeat(s, [count for _, count in parts]) for s, parts in zip(own, _parts(shapes), strict=True)]


def _by_layer(shapes: list[tuple[str, int, int]], groups: list[Int64]) -> tuple[list[tuple[Int64, Int64]], list[Int64]]:
    """Returns the result of code_grids from the symbols of both groups."""
    ends = [np.cumsum([count for _, count in parts]) for parts in _parts(shapes)]
    few, many = (np.split(group, end[:-1]) if shapes else [] for group, end in zip(groups, ends, strict=True))
    return list(zip(few[0::2], few[1::2], strict=True)), [w.reshape(s[1:]) for w, s in zip(many, shapes, strict=True)]


def _decode(
    piece: Piece,
    lanes: int,
    shapes: list[tuple[str, int, int]],
    scales: NDArray[np.uint8],
    trace: Trace | None,
    used: Kernel | None,
) -> tuple[list[tuple[Int64, Int64]], list[Int64]]:
    """SPEC 7.13: returns the result of code_grids. piece: the substream. Raises its BitstreamError."""
    if used is None:
        decoder = Decoder([parse_substream(piece, lanes, "weights")], trace)
        grids = code_grids(decoder, shapes, scales)
        error = decoder.finish()[0]
        if error:
            raise error
        return grids
    few, many = _scales(shapes, scales)
    symbols, verdict = weight_symbols(used, tables_bytes(), piece.data, lanes, np.concatenate([few, many]), len(few))
    if verdict.status:
        raise substream_error(verdict, piece, lanes, "weights")
    each = symbols.astype(np.int64)
    return _by_layer(shapes, [each[: len(few)], each[len(few) :]])


def _finite(values: F32, start: int, path: str) -> None:
    """SPEC [R6.8-3]: raises BitstreamError weights.not_finite for the first value that is not finite."""
    finite = np.isfinite(values)
    if not finite.all():
        first = int(np.argmin(finite))
        raise BitstreamError(
            "weights.not_finite", start + 4 * first, f"weights.{path}", values[first], "finite numbers"
        )


def _raw_layer(section: Piece, at: int, out: int, fan_in: int) -> F32:
    return np.frombuffer(section.data, "<f4", out * (fan_in + 1), at).astype(np.float32)


def _as_layer(values: F32, out: int, fan_in: int) -> Layer:
    return values[: out * fan_in].reshape(out, fan_in), values[out * fan_in :]


def parse_weights(
    section: Piece, mode: int, d: Dimensions, lanes: int, trace: Trace | None = None, used: Kernel | None = None
) -> ParsedWeights:
    """SPEC 5.8, 5.9 and 6.8: returns the weights of the section. In mode 0 its length has been checked.

    lanes: the lanes of the substream in mode 1. used: decodes it instead of NumPy, without a trace. Raises
    BitstreamError 411, 412, 414 to 418, or the error of the substream.
    """

    def bad(at: int, field: str, value: int, low: int, high: int) -> BitstreamError:
        return section.error("weights.scale", at, f"weights.{field}", value, f"{low} to {high}")

    # SPEC [R6.8-5]: only mode 1 can fail here.
    size = pad4(2 + d.carm_inputs)
    if len(section) < size:
        raise section.error("weights.length", 0, "weights", f"{len(section)} bytes", f"at least {size}")
    # SPEC [R6.8-1]: the count is checked before the array that it sizes is read.
    plane_shift, count, highest = section.data[0], section.data[1], PLANE_SHIFT_MAX if d.plane_channels else 0
    if plane_shift > highest:
        raise bad(0, "plane_shift", plane_shift, 0, highest)
    if count != d.carm_inputs:
        raise bad(1, "carm_input_count", count, d.carm_inputs, d.carm_inputs)
    carm_shift = np.frombuffer(section.data, np.uint8, count, 2)
    for i, shift in enumerate(carm_shift.tolist()):
        if shift > CARM_SHIFT_MAX:
            raise bad(2 + i, f"carm_shift[{i}]", shift, 0, CARM_SHIFT_MAX)
    # SPEC [R6.8-2]
    section.require_zero("weights.padding", 2 + count, size, "weights.carm_shift")
    if mode:
        return _parse_packed(section, size, d, lanes, trace, used, plane_shift, carm_shift)
    layers, starts, at = [], {}, size
    for name, out, fan_in in layers_of(d):
        values = _raw_layer(section, at, out, fan_in)
        # SPEC [R6.8-3]
        _finite(values, section.start + at, name)
        starts[name] = section.start + at
        at += 4 * len(values)
        layers.append(_as_layer(values, out, fan_in))
    return ParsedWeights(plane_shift, carm_shift, _regrouped(d, layers), None, None, starts)


def _parse_model(section: Piece, at: int, name: str) -> cs.Container:
    """SPEC 5.9, [R6.8-6] and [R6.8-7]: returns the LayerModel at byte `at` of the section.

    Raises BitstreamError weights.reserved or weights.layer.
    """
    struct = syntax.Struct("LayerModel", section, at, f"weights.{name}")
    model = struct.fields
    if any(model.reserved):
        raise struct.error("weights.reserved", "reserved", list(model.reserved), 0)
    checks = [("form", 0, 1), ("exponent", WEIGHT_EXPONENT_MIN, WEIGHT_EXPONENT_MAX)]
    if not model.form:
        checks += [(field, 0, 0) for field in ("exponent_scale", "exponent", "weight_scale", "bias_scale")]
    for field, low, high in checks:
        struct.require_within("weights.layer", field, model[field], low, high)
    return model


def _parse_packed(
    section: Piece,
    at: int,
    d: Dimensions,
    lanes: int,
    trace: Trace | None,
    used: Kernel | None,
    plane_shift: int,
    carm_shift: NDArray[np.uint8],
) -> ParsedWeights:
    """SPEC 7.13: returns the weights of mode 1. at: the byte of the section where the first LayerModel starts."""

    def short(what: str) -> BitstreamError:
        return section.error("weights.length", 0, "weights", f"a section that ends before {what}", "all layers")

    model_bytes = syntax.size_of("LayerModel")
    shapes, models, starts, raw = layers_of(d), [], {}, {}
    for name, out, fan_in in shapes:
        # SPEC [R6.8-5]
        if at + model_bytes > len(section):
            raise short("a LayerModel")
        starts[name] = section.start + at
        models.append(_parse_model(section, at, name))
        at += model_bytes
        if not models[-1].form:
            size = 4 * out * (fan_in + 1)
            if at + size > len(section):
                raise short("a raw layer's values")
            raw[name] = _raw_layer(section, at, out, fan_in)
            at += size
    scales = np.array([[m.exponent_scale, m.weight_scale, m.bias_scale] for m in models], dtype=np.uint8)
    packed = [i for i, (name, _, _) in enumerate(shapes) if name not in raw]
    piece = section.cut(at, len(section))
    few, many = _decode(piece, lanes, [shapes[i] for i in packed], scales[packed], trace, used)
    grids = dict(zip(packed, zip(few, many, strict=True), strict=True))
    layers = []
    for i, (name, out, fan_in) in enumerate(shapes):
        if name in raw:
            # SPEC [R6.8-3]
            _finite(raw[name], starts[name] + model_bytes, name)
            layers.append(_as_layer(raw[name], out, fan_in))
            continue
        (difference, bias), weight = grids[i]
        layer = from_grid(GridLayer(models[i].exponent, difference, weight, bias))
        # SPEC [R6.8-8]
        if layer is None:
            raise BitstreamError(
                "weights.exponent", starts[name], f"weights.{name}", "an exponent of a row", "the least one"
            )
        layers.append(layer)
    forms = np.array([m.form for m in models], dtype=np.uint8)
    return ParsedWeights(plane_shift, carm_shift, _regrouped(d, layers), scales, forms, starts)


def packable(networks: Networks) -> NDArray[np.uint8]:
    """Returns the forms of layers, uint8 [layers], packed for every layer that can be packed."""
    layers = [layer for network in networks.values() for layer in network]
    return np.array([to_grid(layer) is not None for layer in layers], dtype=np.uint8)


def emit_weights(
    plane_shift: int,
    carm_shift: NDArray[np.uint8],
    networks: Networks,
    scales: NDArray[np.uint8] | None,
    d: Dimensions,
    lanes: int,
    forms: NDArray[np.uint8] | None = None,
) -> bytes:
    """SPEC 5.8: returns the bytes of the section, in mode 0 if scales is None, and otherwise in mode 1.

    Raw values keep all their bits. carm_shift: uint8 [CARM inputs]. scales: as Scene.weight_scales. lanes: the lanes of
    the substream in mode 1. forms: as Scene.weight_forms, or None for those of `packable`. Raises ValueError for a
    layer of form 1 that cannot be packed.
    """
    shifts = carm_shift.tolist()
    table = {"plane_shift": plane_shift, "carm_input_count": len(shifts), "carm_shift": shifts}
    parts = [syntax.build("WeightScales", table)]
    layers = [layer for network in networks.values() for layer in network]
    raw = [b"".join(value.astype("<f4").tobytes() for value in layer) for layer in layers]
    if scales is None:
        return b"".join([*parts, *raw])
    shapes, packed, grids = layers_of(d), [], []
    wanted = packable(networks) if forms is None else forms
    for i, (form, layer) in enumerate(zip(wanted.tolist(), layers, strict=True)):
        grid = to_grid(layer) if form else None
        if form and grid is None:
            raise ValueError(f"the layer {shapes[i][0]} cannot be packed (SPEC.md 7.13)")
        exponent_scale, weight_scale, bias_scale = scales[i].tolist()
        model = {
            "form": form,
            "exponent_scale": exponent_scale,
            "exponent": grid.exponent if grid else 0,
            "weight_scale": weight_scale,
            "bias_scale": bias_scale,
            "reserved": [0, 0],
        }
        parts.append(syntax.build("LayerModel", model))
        if grid is None:
            parts.append(raw[i])
        else:
            packed.append(i)
            grids.append(grid)
    encoder = Encoder(1, lanes)
    code_grids(encoder, [shapes[i] for i in packed], scales[packed], grids)
    return b"".join([*parts, *encoder.finish()])
