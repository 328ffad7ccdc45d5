"""Clauses 5.8, 6.8 and 7.2: the weights and the integer networks."""

import struct
from dataclasses import dataclass
from itertools import pairwise
from operator import mul
from typing import NamedTuple

from .container import Header, Section
from .errors import C3GSError, require
from .operators import (
    ACCUMULATOR_BOUND,
    ACTIVATION_MAX,
    CARM_SHIFT_MAX,
    EXPONENT_MAX,
    PLANE_SHIFT_MAX,
    WEIGHT_MAX,
    clamp,
    round_ratio,
    shift_round,
)
from .tables import Tables
from .trace import Trace
from .weights import Layer, check_finite, read_grids


class Row(NamedTuple):
    """One output of a layer."""

    weights: list[int]
    bias: int
    exponent: int


class Shape(NamedTuple):
    """A network as 5.8 lists it: its widths from inputs to outputs."""

    name: str
    widths: list[int]
    integer: bool


class Network:
    """A network of integer weights."""

    def __init__(self, layers: list[list[Row]]) -> None:
        self._hidden = layers[:-1]
        self._last = layers[-1]

    # SPEC 7.2
    def __call__(self, inputs: list[int]) -> list[int]:
        for layer in self._hidden:
            inputs = [clamp(value, 0, ACTIVATION_MAX) for value in _layer(layer, inputs)]
        return _layer(self._last, inputs)


# SPEC 7.2
def _layer(rows: list[Row], inputs: list[int]) -> list[int]:
    return [shift_round(sum(map(mul, row.weights, inputs)) + row.bias, row.exponent) for row in rows]


# SPEC 5.8
def shapes(header: Header) -> list[Shape]:
    """The networks in file order."""
    k, f, d = header["offset_count"], header.features, header.channels
    slices = header["slice_width"]
    context = 2 * header["plane_channels"] + 2 * header["frequency_count"]
    out = [
        Shape("hyper", [context, *header["hyper_width"], 2 * d + 3], True),
        Shape("sarm", [4, *header["sarm_width"], 2], True),
    ]
    out += [Shape(f"carm.{i}", [sum(slices[:i]), *header["carm_width"], 2 * slices[i]], True) for i in range(1, len(slices))]
    rendering = (("opacity", k), ("covariance", 7 * k), ("colour", 3 * k))
    return out + [Shape(name, [f + 4, header["render_width"], outputs], False) for name, outputs in rendering]


# SPEC 5.8, [R6.6-5]
def weight_count(header: Header) -> int:
    """W, the number of values."""
    return sum((a + 1) * b for shape in shapes(header) for a, b in zip(shape.widths, shape.widths[1:]))


# SPEC 7.2
def derive_row(weights: tuple[float, ...], bias: float) -> Row | None:
    """The row with the largest exponent that keeps the bounds, or None."""
    ratios = [(n, d.bit_length() - 1) for n, d in (x.as_integer_ratio() for x in (*weights, bias))]
    for exponent in range(EXPONENT_MAX, -1, -1):
        *integers, integer_bias = [round_ratio(n, d, exponent) for n, d in ratios]
        if max(map(abs, integers)) > WEIGHT_MAX:
            continue
        rounding = (1 << exponent) >> 1
        if sum(map(abs, integers)) * ACTIVATION_MAX + abs(integer_bias) + rounding < ACCUMULATOR_BOUND:
            return Row(integers, integer_bias, exponent)
    return None


@dataclass(frozen=True)
class Weights:
    """The scales, the integer networks, and the bytes of all values."""

    plane_shift: int
    carm_shift: list[int]
    networks: dict[str, Network]
    raw: bytes


# SPEC 6.8, 10.1 step 4
def read_weights(data: bytes, header: Header, section: Section, tables: Tables, trace: Trace | None) -> Weights:
    """Parse and check the section of weights."""
    at = section.offset
    require(section.length >= 2 + header.carm_inputs, "weights.length", at)
    require(data[at] <= PLANE_SHIFT_MAX, "weights.scale", at)
    require(data[at + 1] == header.carm_inputs, "weights.scale", at + 1)
    shifts_at, values_at = at + 2, at + 2 + header.carm_inputs
    shifts = list(data[shifts_at:values_at])
    for n, shift in enumerate(shifts):
        require(shift <= CARM_SHIFT_MAX, "weights.scale", shifts_at + n)
    named = [(f"{shape.name}.{n}", b, a) for shape in shapes(header) for n, (a, b) in enumerate(pairwise(shape.widths))]
    forms = [(outputs, inputs) for _, outputs, inputs in named]
    if header.weight_mode:
        layers = read_grids(data, header, section, values_at, forms, tables, (trace, [name for name, _, _ in named]) if trace else None)
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
            networks[shape.name] = Network([_derive_layer(layer, header.weight_mode == 0) for layer in found])
    raw = b"".join(struct.pack(f"<{len(layer.values)}f", *layer.values) for layer in layers)
    return Weights(data[at], shifts, networks, raw)


# SPEC [R6.8-3], 7.2
def _derive_layer(layer: Layer, each_row: bool) -> list[Row]:
    outputs = len(layer.values) // (layer.inputs + 1)
    rows = []
    for n in range(outputs):
        start = n * layer.inputs
        row = derive_row(tuple(layer.values[start : start + layer.inputs]), layer.values[outputs * layer.inputs + n])
        if row is None:
            raise C3GSError("weights.bound", layer.at + 4 * start if each_row else layer.at)
        rows.append(row)
    return rows
