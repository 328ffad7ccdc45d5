"""Clauses 5.8, 5.16, 6.8 and 7.13: the weights, raw or as integers on grids."""

from __future__ import annotations

from dataclasses import dataclass

import construct as cs
import numpy as np
from numpy.typing import NDArray

from . import syntax
from .conventions import Int64
from .dimensions import Dimensions, layers_of
from .entropy import Coder, Decoder, Encoder, Trace, parse_substream
from .errors import BitstreamError
from .networks import F32, BoundError, Layer
from .tables import SCALE_MIN, tables

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
    scales: uint8 [layers, 3], as Scene.weight_scales. None in mode 0.
    starts: the offset of each layer, by the layer's name. In mode 0 it is that of the values, in mode 1 of the model.
    """

    plane_shift: int
    carm_shift: NDArray[np.uint8]
    networks: Networks
    scales: NDArray[np.uint8] | None
    starts: dict[str, int]


def bound_error(weights: ParsedWeights, d: Dimensions, error: BoundError) -> BitstreamError:
    """SPEC [R6.8-3]: returns the error weights.bound of a row.

    It points at the row's first weight, or in mode 1 at the layer's model.
    """
    at = weights.starts[error.layer]
    if weights.scales is None:
        fan_in = next(fan_in for name, _, fan_in in layers_of(d) if name == error.layer)
        at += 4 * fan_in * error.row
    return BitstreamError("weights.bound", at, f"weights.{error.layer}", error.found, error.allowed)


@dataclass(frozen=True)
class GridLayer:
    """SPEC 7.13: the integers of a packed layer.

    exponent: that of the layer's model. difference: int64 [out], of each row's exponent to that of the row before.
    weight: int64 [out, in]. bias: int64 [out].
    """

    exponent: int
    difference: Int64
    weight: Int64
    bias: Int64


def _regrouped(d: Dimensions, layers: list[Layer]) -> Networks:
    """Returns the layers, given in file order, by network."""
    rest = iter(layers)
    return {name: [next(rest) for _ in shapes] for name, shapes in d.network_shapes().items()}


def least_exponents(values: F32) -> tuple[Int64, NDArray[np.bool_]]:
    """SPEC 7.13, LEAST_EXPONENT: returns the least exponent of each row, and whether the row has one.

    values: float32 [rows, n], finite. The results are int64 [rows] and bool [rows]. A row of zeros has no exponent.
    """
    significand, exponent = np.frexp(values.astype(np.float64))
    # The lowest set bit of a significand is its least power of two. All of it is exact in float64.
    integer = np.abs(significand * 2.0**53).astype(np.int64)
    lowest = np.frexp((integer & -integer).astype(np.float64))[1] - 1 + exponent - 53
    some = values != 0
    return -np.where(some, lowest, 1 << 10).min(axis=1).astype(np.int64), np.asarray(some.any(axis=1))


def to_grid(layer: Layer) -> GridLayer | None:
    """SPEC 6.8 and 7.13, CAN_BE_PACKED: returns a finite layer as integers, or None if it has to be raw."""
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
    # A row of zeros has the exponent of the row before. The first rows, if zero, have that of the first other row.
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

    Returns for each of them (differences, biases), int64 [out], and for each of them its weights, int64 [out, in].
    shapes: (name, outputs, inputs) of each. scales: uint8 [layers, 3]. given: the layers if they are encoded.
    """
    few_counts = [out for _, out, _ in shapes for _ in range(2)]
    many_counts = [out * fan_in for _, out, fan_in in shapes]
    few_names = [f"weights.{name}.{part}" for name, _, _ in shapes for part in ("exponent", "bias")]
    many_names = [f"weights.{name}.weight" for name, _, _ in shapes]
    known: list[Int64 | None] = [None, None]
    if given is not None:
        known = [np.concatenate([np.zeros(0, np.int64), *parts]) for parts in (
            [part for g in given for part in (g.difference, g.bias)],
            [g.weight.reshape(-1) for g in given],
        )]  # fmt: skip
    found = []
    for models, scale, counts, names, values in (
        (tables().laplace, scales[:, [0, 2]].reshape(-1), few_counts, few_names, known[0]),
        (tables().gauss, scales[:, 1], many_counts, many_names, known[1]),
    ):
        ends = np.cumsum([0, *counts])

        def name(_: int, index: int, ends: Int64 = ends, names: list[str] = names) -> str:
            part = int(np.searchsorted(ends, index, side="right")) - 1
            return f"{names[part]}[{index - ends[part]}]"

        each = np.repeat(scale.astype(np.int64) + SCALE_MIN, counts)
        coded = coder.values(models, np.zeros(len(each), np.int64), each, [len(each)], WEIGHT_SYMBOL_MAX, name, values)
        found.append(np.split(coded, ends[1:-1]) if counts else [])
    few, many = found
    return list(zip(few[0::2], few[1::2], strict=True)), [w.reshape(s[1:]) for w, s in zip(many, shapes, strict=True)]


def _finite(values: F32, start: int, path: str) -> None:
    """SPEC [R6.8-2]: raises BitstreamError weights.not_finite for the first value that is not finite."""
    finite = np.isfinite(values)
    if not finite.all():
        first = int(np.argmin(finite))
        raise BitstreamError(
            "weights.not_finite", start + 4 * first, f"weights.{path}", values[first], "finite numbers"
        )


def _raw_layer(data: bytes, at: int, out: int, fan_in: int) -> F32:
    return np.frombuffer(data, "<f4", out * (fan_in + 1), at).astype(np.float32)


def _as_layer(values: F32, out: int, fan_in: int) -> Layer:
    return values[: out * fan_in].reshape(out, fan_in), values[out * fan_in :]


def parse_weights(
    data: bytes, start: int, end: int, mode: int, d: Dimensions, lanes: int, trace: Trace | None = None
) -> ParsedWeights:
    """SPEC 5.8 and 6.8: returns the weights of the section data[start:end].

    lanes: the lanes of the substream in mode 1. Raises BitstreamError 411, 412, 414 to 417, or that of the substream.
    """

    def bad(offset: int, field: str, value: int, low: int, high: int) -> BitstreamError:
        return BitstreamError("weights.scale", offset, f"weights.{field}", value, f"{low} to {high}")

    # Only mode 1 can fail here. In mode 0 the length is known to be right.
    if end - start < 2 + d.carm_inputs:
        raise BitstreamError(
            "weights.length", start, "weights", f"{end - start} bytes", f"at least {2 + d.carm_inputs}"
        )
    # The count is checked before the array that it sizes is read.
    if data[start] > PLANE_SHIFT_MAX:
        raise bad(start, "plane_shift", data[start], 0, PLANE_SHIFT_MAX)
    if data[start + 1] != d.carm_inputs:
        raise bad(start + 1, "carm_input_count", data[start + 1], d.carm_inputs, d.carm_inputs)
    fields, size = syntax.parse("WeightScales", data, start)
    for i, shift in enumerate(fields.carm_shift):
        if shift > CARM_SHIFT_MAX:
            raise bad(start + 2 + i, f"carm_shift[{i}]", shift, 0, CARM_SHIFT_MAX)
    carm_shift = np.array(fields.carm_shift, dtype=np.uint8)
    at = start + size
    if mode:
        packed, scales, models = _parse_packed(data, start, at, end, d, lanes, trace)
        return ParsedWeights(fields.plane_shift, carm_shift, _regrouped(d, packed), scales, models)
    layers = []
    starts: dict[str, int] = {}
    for name, out, fan_in in layers_of(d):
        values = _raw_layer(data, at, out, fan_in)
        _finite(values, at, name)
        starts[name] = at
        at += 4 * len(values)
        layers.append(_as_layer(values, out, fan_in))
    return ParsedWeights(fields.plane_shift, carm_shift, _regrouped(d, layers), None, starts)


def _parse_model(data: bytes, at: int, name: str) -> cs.Container:
    """SPEC 5.16 and [R6.8-5]: returns the LayerModel at data[at:]. Raises BitstreamError weights.layer."""
    model, _ = syntax.parse("LayerModel", data, at)
    elements = {row.path: row for row in syntax.parse_elements("LayerModel", data, at)}
    checks = [("form", 0, 1), ("exponent", WEIGHT_EXPONENT_MIN, WEIGHT_EXPONENT_MAX)]
    if not model.form:
        checks += [(field, 0, 0) for field in ("exponent", "exponent_scale", "weight_scale", "bias_scale")]
    for field, low, high in checks:
        if not low <= model[field] <= high:
            raise BitstreamError(
                "weights.layer", elements[field].start, f"weights.{name}.{field}", model[field], f"{low} to {high}"
            )
    return model


def _parse_packed(
    data: bytes, section: int, at: int, end: int, d: Dimensions, lanes: int, trace: Trace | None
) -> tuple[list[Layer], NDArray[np.uint8], dict[str, int]]:
    """SPEC 7.13: returns the layers, their scales, and where each model starts. The first model is at data[at:]."""
    model_bytes = syntax.SCHEMAS["LayerModel"].sizeof(at=None)
    shapes, models, starts, raw = layers_of(d), [], {}, {}
    for name, out, fan_in in shapes:
        if at + model_bytes > end:
            raise BitstreamError(
                "weights.length", section, "weights", "a section that ends before a layer's model", "all layers"
            )
        starts[name] = at
        models.append(_parse_model(data, at, name))
        at += model_bytes
        if not models[-1].form:
            if at + 4 * out * (fan_in + 1) > end:
                raise BitstreamError(
                    "weights.length",
                    section,
                    "weights",
                    "a section that ends before a raw layer's values",
                    "all layers",
                )
            raw[name] = _raw_layer(data, at, out, fan_in)
            at += 4 * out * (fan_in + 1)
    scales = np.array([[m.exponent_scale, m.weight_scale, m.bias_scale] for m in models], dtype=np.uint8)
    packed = [i for i, (name, _, _) in enumerate(shapes) if name not in raw]
    decoder = Decoder([parse_substream(data, at, end, lanes, "weights")], trace)
    few, many = code_grids(decoder, [shapes[i] for i in packed], scales[packed])
    error = decoder.finish()[0]
    if error:
        raise error
    grids = dict(zip(packed, zip(few, many, strict=True), strict=True))
    layers = []
    for i, (name, out, fan_in) in enumerate(shapes):
        if name in raw:
            _finite(raw[name], starts[name] + model_bytes, name)
            layer = _as_layer(raw[name], out, fan_in)
            if to_grid(layer) is not None:
                raise BitstreamError(
                    "weights.raw", starts[name], f"weights.{name}", "form 0", "form 1: the layer can be packed"
                )
        else:
            (difference, bias), weight = grids[i]
            found = from_grid(GridLayer(models[i].exponent, difference, weight, bias))
            if found is None:
                raise BitstreamError(
                    "weights.exponent", starts[name], f"weights.{name}", "an exponent of a row", "the least one"
                )
            layer = found
        layers.append(layer)
    return layers, scales, starts


def emit_weights(
    plane_shift: int,
    carm_shift: NDArray[np.uint8],
    networks: Networks,
    scales: NDArray[np.uint8] | None,
    d: Dimensions,
    lanes: int,
) -> bytes:
    """SPEC 5.8: returns the bytes of the section, in mode 0 if scales is None, and otherwise in mode 1.

    Raw values keep all their bits. carm_shift: uint8 [CARM inputs]. scales: as Scene.weight_scales. lanes: the lanes of
    the substream in mode 1.
    """
    shifts = carm_shift.tolist()
    parts = [
        syntax.build(
            "WeightScales", {"plane_shift": plane_shift, "carm_input_count": len(shifts), "carm_shift": shifts}
        )
    ]
    layers = [layer for network in networks.values() for layer in network]
    raw = [b"".join(value.astype("<f4").tobytes() for value in layer) for layer in layers]
    if scales is None:
        return b"".join([*parts, *raw])
    grids = [to_grid(layer) for layer in layers]
    for grid, content, (exponent_scale, weight_scale, bias_scale) in zip(grids, raw, scales.tolist(), strict=True):
        fields = {"exponent_scale": exponent_scale, "weight_scale": weight_scale, "bias_scale": bias_scale}
        parts.append(
            syntax.build(
                "LayerModel", {"form": int(grid is not None), "exponent": grid.exponent if grid else 0, **fields}
            )
        )
        parts.append(content if grid is None else b"")
    packed = [i for i, grid in enumerate(grids) if grid is not None]
    encoder = Encoder(1, lanes)
    shapes = layers_of(d)
    code_grids(encoder, [shapes[i] for i in packed], scales[packed], [grid for grid in grids if grid is not None])
    return b"".join([*parts, *encoder.finish()])
