"""Clauses 5.8, 5.9, 6.8 and 7.13: the weights, raw or as integers on grids."""

import math
import struct
from dataclasses import dataclass
from itertools import accumulate, pairwise
from typing import NamedTuple

from .conventions import (
    CARM_SHIFT_MAX,
    PLANE_SHIFT_MAX,
    SCALE_MIN,
    WEIGHT_EXPONENT_MAX,
    WEIGHT_EXPONENT_MIN,
    WEIGHT_SYMBOL_MAX,
    padded,
)
from .dimensions import shapes
from .directory import Section
from .entropy import Substream
from .errors import C3GSError, require
from .header import Header
from .networks import Network, Row, derive_row
from .syntax import check_padding
from .tables import Tables
from .trace import Trace

MODEL_LENGTH = 8
PACKED = 1


class Layer(NamedTuple):
    """A layer. values: the weights row by row, and then the biases. at: the byte at which an error in it points."""

    values: list[float]
    inputs: int
    at: int


class Model(NamedTuple):
    """A LayerModel. at: its first byte in the file. raw: the values of a raw layer, or nothing."""

    form: int
    exponent: int
    exponent_scale: int
    weight_scale: int
    bias_scale: int
    at: int
    raw: list[float]


# SPEC [R6.8-3]
def check_finite(values: list[float], at: int) -> None:
    """Refuse the file if a value is not finite. at: where the first value is in the file."""
    for n, value in enumerate(values):
        require(math.isfinite(value), "weights.not_finite", at + 4 * n)


# SPEC 5.9, [R6.8-6], [R6.8-7]
def _read_model(data: bytes, at: int) -> Model:
    """Return the LayerModel at data[at], as that of a packed layer."""
    form, exponent_scale, exponent, weight_scale, bias_scale, *reserved = struct.unpack_from("<2Bh4B", data, at)
    require(not any(reserved), "weights.reserved", at + 6)
    require(form <= PACKED, "weights.layer", at)
    require(WEIGHT_EXPONENT_MIN <= exponent <= WEIGHT_EXPONENT_MAX, "weights.layer", at + 2)
    if form != PACKED:
        for n, field in ((1, exponent_scale), (2, exponent), (4, weight_scale), (5, bias_scale)):
            require(field == 0, "weights.layer", at + n)
    return Model(form, exponent, exponent_scale, weight_scale, bias_scale, at, [])


# SPEC 5.8, [R6.8-5]
def _read_models(data: bytes, section: Section, at: int, forms: list[tuple[int, int]]) -> tuple[list[Model], int]:
    """Return the models of all layers, and where the substream begins. forms: (outputs, inputs) of each layer."""
    end = section.offset + section.length
    found = []
    for outputs, inputs in forms:
        require(at + MODEL_LENGTH <= end, "weights.length", section.offset)
        model = _read_model(data, at)
        at += MODEL_LENGTH
        if model.form != PACKED:
            count = outputs * (inputs + 1)
            require(at + 4 * count <= end, "weights.length", section.offset)
            model = model._replace(raw=list(struct.unpack_from(f"<{count}f", data, at)))
            at += 4 * count
        found.append(model)
    return found, at


# SPEC 7.13, PACKED_LAYER, [R6.8-8]
def _unpacked(model: Model, steps: list[int], biases: list[int], weights: list[int]) -> list[float]:
    inputs = len(weights) // len(biases)
    exponents = list(accumulate(steps, initial=model.exponent))[1:]
    before = True
    for n, (step, exponent, bias) in enumerate(zip(steps, exponents, biases)):
        row = [*weights[n * inputs : (n + 1) * inputs], bias]
        right = WEIGHT_EXPONENT_MIN <= exponent <= WEIGHT_EXPONENT_MAX
        if any(row):
            right = right and any(x & 1 for x in row) and (step == 0 or not before)
            before = False
        else:
            right = right and step == 0
        require(right, "weights.exponent", model.at)
    require(not before or model.exponent == 0, "weights.exponent", model.at)
    values = [math.ldexp(x, -exponents[n // inputs]) for n, x in enumerate(weights)]
    return values + [math.ldexp(x, -exponent) for x, exponent in zip(biases, exponents)]


# SPEC 7.13, DECODE_WEIGHTS, 10.1: a raw layer may be one that can be packed
def read_grids(
    data: bytes,
    header: Header,
    section: Section,
    at: int,
    forms: list[tuple[int, int]],
    tables: Tables,
    trace: tuple[Trace, list[str]] | None,
) -> list[Layer]:
    """Return the layers of a section in mode 1, whose first LayerModel is at data[at].

    forms: (outputs, inputs) of each layer. trace: a trace and the names of the layers.
    """
    models, stream_at = _read_models(data, section, at, forms)
    stream = Substream(data, stream_at, section.offset + section.length - stream_at, header["attribute_lanes_log2"])
    first, second = [], []
    for (outputs, inputs), model in zip(forms, models):
        if model.form:
            first += [(0, SCALE_MIN + model.exponent_scale)] * outputs
            first += [(0, SCALE_MIN + model.bias_scale)] * outputs
            second += [(0, SCALE_MIN + model.weight_scale)] * (outputs * inputs)
    few_values = stream.values(tables.laplace, first, WEIGHT_SYMBOL_MAX)
    many_values = stream.values(tables.gauss, second, WEIGHT_SYMBOL_MAX)
    if trace:
        packed = [(name, *form) for name, form, model in zip(trace[1], forms, models) if model.form]
        trace[0].weights([(f"{name}.{part}", n) for name, n, _ in packed for part in ("exponent", "bias")], few_values)
        trace[0].weights([(f"{name}.weight", outputs * inputs) for name, outputs, inputs in packed], many_values)
    stream.finish()
    few, many = iter(few_values), iter(many_values)
    layers = []
    for (outputs, inputs), model in zip(forms, models):
        values = model.raw
        if model.form:
            steps, biases = ([next(few) for _ in range(outputs)] for _ in range(2))
            values = _unpacked(model, steps, biases, [next(many) for _ in range(outputs * inputs)])
        else:
            check_finite(values, model.at + MODEL_LENGTH)
        layers.append(Layer(values, inputs, model.at))
    return layers


@dataclass(frozen=True)
class Weights:
    """The section of weights.

    networks: F_h, SARM and CARM, by name. raw: the bytes of all values as f32.
    """

    plane_shift: int
    carm_shift: list[int]
    networks: dict[str, Network]
    raw: bytes


# SPEC 5.8, 6.8, 10.1
def read_weights(data: bytes, header: Header, section: Section, tables: Tables, trace: Trace | None) -> Weights:
    """Read the section of weights, check it, and return it."""
    at = section.offset
    shifts_at, shifts_end = at + 2, at + 2 + header.carm_inputs
    values_at = at + padded(2 + header.carm_inputs)
    require(values_at <= at + section.length, "weights.length", at)
    require(data[at] <= (PLANE_SHIFT_MAX if header["plane_channels"] else 0), "weights.scale", at)
    require(data[at + 1] == header.carm_inputs, "weights.scale", at + 1)
    shifts = list(data[shifts_at:shifts_end])
    for n, shift in enumerate(shifts):
        require(shift <= CARM_SHIFT_MAX, "weights.scale", shifts_at + n)
    check_padding(data, shifts_end, "weights.padding")
    named = [(f"{shape.name}.{n}", b, a) for shape in shapes(header) for n, (a, b) in enumerate(pairwise(shape.widths))]
    forms = [(outputs, inputs) for _, outputs, inputs in named]
    if section.mode:
        layers = read_grids(
            data, header, section, values_at, forms, tables, (trace, [name for name, _, _ in named]) if trace else None
        )
    else:
        layers = []
        for outputs, inputs in forms:
            values = list(struct.unpack_from(f"<{outputs * (inputs + 1)}f", data, values_at))
            check_finite(values, values_at)
            layers.append(Layer(values, inputs, values_at))
            values_at += 4 * len(values)
    rest = iter(layers)
    networks = {}
    for shape in shapes(header):
        if shape.integer:
            found = [next(rest) for _ in shape.widths[1:]]
            networks[shape.name] = Network([_derive_layer(layer, section.mode == 0) for layer in found])
    raw = b"".join(struct.pack(f"<{len(layer.values)}f", *layer.values) for layer in layers)
    return Weights(data[at], shifts, networks, raw)


# SPEC [R6.8-4], 7.2
def _derive_layer(layer: Layer, each_row: bool) -> list[Row]:
    """Return the integers of a layer. each_row: whether an error points at the row, not at the layer."""
    outputs = len(layer.values) // (layer.inputs + 1)
    rows = []
    for n in range(outputs):
        start = n * layer.inputs
        row = derive_row(tuple(layer.values[start : start + layer.inputs]), layer.values[outputs * layer.inputs + n])
        if row is None:
            # A row without inputs has a bias alone, and the biases are all that the layer has.
            inside = start if layer.inputs else n
            raise C3GSError("weights.bound", layer.at + 4 * inside if each_row else layer.at)
        rows.append(row)
    return rows
