"""Clause 7.2: integer networks, from fp32 weights to integers, and the forward pass."""

from operator import mul
from typing import NamedTuple

from .conventions import ACCUMULATOR_BOUND, ACTIVATION_MAX, EXPONENT_MAX, WEIGHT_MAX, clamp, round_ratio, shift_round


class Row(NamedTuple):
    """The integers of one output of a layer."""

    weights: list[int]
    bias: int
    exponent: int


class Network:
    """A network that acts on integers."""

    def __init__(self, layers: list[list[Row]]) -> None:
        self._hidden = layers[:-1]
        self._last = layers[-1]

    # SPEC 7.2
    def __call__(self, inputs: list[int]) -> list[int]:
        """Return the outputs. inputs: integers from -ACTIVATION_MAX to ACTIVATION_MAX."""
        for layer in self._hidden:
            inputs = [clamp(value, 0, ACTIVATION_MAX) for value in _layer(layer, inputs)]
        return _layer(self._last, inputs)


# SPEC 7.2
def _layer(rows: list[Row], inputs: list[int]) -> list[int]:
    return [shift_round(sum(map(mul, row.weights, inputs)) + row.bias, row.exponent) for row in rows]


# SPEC 7.2
def derive_row(weights: tuple[float, ...], bias: float) -> Row | None:
    """Return the integers with the largest exponent that keeps the bounds, or None if no exponent does."""
    ratios = [(n, d.bit_length() - 1) for n, d in (x.as_integer_ratio() for x in (*weights, bias))]
    for exponent in range(EXPONENT_MAX, -1, -1):
        *integers, integer_bias = [round_ratio(n, d, exponent) for n, d in ratios]
        if max(map(abs, integers), default=0) > WEIGHT_MAX:
            continue
        rounding = (1 << exponent) >> 1
        if sum(map(abs, integers)) * ACTIVATION_MAX + abs(integer_bias) + rounding < ACCUMULATOR_BOUND:
            return Row(integers, integer_bias, exponent)
    return None
