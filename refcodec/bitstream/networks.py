"""Clause 7.2: integer networks, from fp32 weights to integers, and the forward pass.

A float32 matrix product may compute the integers: no partial sum reaches 2^24, so every order of summation, fused or
not, gives the same exact result. If a faulty BLAS does not, the self-test chooses int64.
"""

from collections.abc import Callable, Container, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .conventions import F32, Int64, clamp, rshift_round
from .dimensions import RENDERING

# SPEC 7.2: the largest activation, the largest integer weight, the bound of accumulators, the largest exponent.
ACTIVATION_MAX = 1023
WEIGHT_MAX = 1023
ACCUMULATOR_BOUND = 1 << 24
EXPONENT_MAX = 20
# The number of rows of a product that are computed at once. It affects only speed.
BLOCK_ROWS = 8192
Layer = tuple[F32, F32]


class BoundError(ValueError):
    """A row whose integers could reach the accumulator bound. `row` is its number in the layer named `layer`."""

    row: int
    layer: str
    found: str
    allowed: str

    def __init__(self, row: int, layer: str = "layer") -> None:
        self.row, self.layer = row, layer
        self.found = f"row {row}, which exceeds a bound at every exponent"
        self.allowed = f"rows within the bounds at an exponent from 0 to {EXPONENT_MAX}"
        super().__init__(f"weights of the network layer {layer}, row {row}, are too large for 32-bit integers")


@dataclass(frozen=True)
class IntLayer:
    """SPEC 7.2: a layer of integers. weight: int64 [out, in]. bias, exponent: int64 [out]."""

    weight: Int64
    bias: Int64
    exponent: Int64


def derive_layer(weight: F32, bias: F32) -> IntLayer:
    """SPEC 7.2, DERIVE_ROW: returns a layer of integers. Each row has the largest exponent within the bounds.

    weight: float32 [out, in]. bias: float32 [out]. Both are finite. Raises BoundError for a row without an exponent.
    """
    out = len(bias)
    w64, b64 = weight.astype(np.float64), bias.astype(np.float64)
    exponent = np.full(out, -1, dtype=np.int64)
    chosen_w = np.zeros(weight.shape, dtype=np.int64)
    chosen_b = np.zeros(out, dtype=np.int64)
    # The cut keeps values beyond the bound, which violate it anyway, within int64.
    cut = 2.0 * ACCUMULATOR_BOUND
    for e in range(EXPONENT_MAX, -1, -1):
        # Exact in float64: a 24-bit significand times a power of two, plus 1/2.
        w = np.floor(np.clip(w64 * 2.0**e, -cut, cut) + 0.5).astype(np.int64)
        b = np.floor(np.clip(b64 * 2.0**e, -cut, cut) + 0.5).astype(np.int64)
        worst = np.abs(w).sum(axis=1) * ACTIVATION_MAX + np.abs(b) + ((1 << e) >> 1)
        fits = (exponent < 0) & (worst < ACCUMULATOR_BOUND) & (np.abs(w).max(axis=1, initial=0) <= WEIGHT_MAX)
        exponent[fits] = e
        chosen_w[fits], chosen_b[fits] = w[fits], b[fits]
    if (exponent < 0).any():
        raise BoundError(int(np.argmax(exponent < 0)))
    return IntLayer(chosen_w, chosen_b, exponent)


class IntNetwork:
    """SPEC 7.2, NETWORK: integer layers, with a clamp to [0, 1023] between them and none after the last."""

    exact_float: bool
    block_rows: int

    def __init__(self, layers: list[IntLayer], exact_float: bool | None = None, block_rows: int | None = None) -> None:
        """exact_float: whether to compute in float32. None leaves it to the self-test.
        block_rows: rows that are computed at once. None means BLOCK_ROWS. No result depends on either.
        """
        self.layers = layers
        self.exact_float = float32_is_exact() if exact_float is None else exact_float
        self.block_rows = block_rows or BLOCK_ROWS
        self._float = self._float_layers()

    def _float_layers(self) -> list[tuple[F32, F32, F32]]:
        """Returns the float32 operands of each layer.

        They are weights [in, out], biases plus the rounding term [out], and the units of outputs [out].
        """
        floats = []
        for layer in self.layers:
            half = (np.int64(1) << layer.exponent) >> 1
            weight = np.ascontiguousarray(layer.weight.T.astype(np.float32))
            unit = np.ldexp(np.float32(1), -layer.exponent).astype(np.float32)
            floats.append((weight, (layer.bias + half).astype(np.float32), unit))
        return floats

    def __call__(self, inputs: NDArray[np.signedinteger]) -> NDArray[np.int32]:
        """Returns the outputs, int32 [rows, out]. inputs: integers [rows, in], each in [-1023, 1023]."""
        out = np.empty((len(inputs), len(self.layers[-1].bias)), dtype=np.int32)
        forward = self._forward_float if self.exact_float else self._forward_int
        for start in range(0, len(inputs), self.block_rows):
            rows = slice(start, start + self.block_rows)
            out[rows] = forward(inputs[rows])
        return out

    def _forward_float(self, a: NDArray[Any]) -> NDArray[Any]:
        x = a.astype(np.float32)
        last = len(self._float) - 1
        for i, (weight, bias, unit) in enumerate(self._float):
            x = x @ weight
            x += bias
            x *= unit
            np.floor(x, out=x)
            if i < last:
                np.clip(x, 0, ACTIVATION_MAX, out=x)
        return x

    def _forward_int(self, a: NDArray[Any]) -> NDArray[Any]:
        x = a.astype(np.int64)
        last = len(self.layers) - 1
        for i, layer in enumerate(self.layers):
            x = rshift_round(x @ layer.weight.T + layer.bias, layer.exponent)
            if i < last:
                x = clamp(x, 0, ACTIVATION_MAX)
        return x


def derive_networks(networks: Mapping[str, list[Layer]], names: Container[str] | None = None) -> dict[str, IntNetwork]:
    """SPEC 7.2: returns integer networks by name. Raises BoundError, which names the layer.

    names: those of the networks, or None for F_h, SARM and CARM.
    """
    integers = {}
    for name, layers in networks.items():
        if name in RENDERING if names is None else name not in names:
            continue
        derived = []
        for index, layer in enumerate(layers):
            try:
                derived.append(derive_layer(*layer))
            except BoundError as error:
                raise BoundError(error.row, f"{name}.{index}") from None
        integers[name] = IntNetwork(derived)
    return integers


def activation(a: Int64) -> Int64:
    """SPEC 7.2, ACTIVATION: returns a clamped to [-1023, 1023], the range of a network's inputs."""
    return clamp(a, -ACTIVATION_MAX, ACTIVATION_MAX)


def mixed(rows: int, columns: int, bound: int) -> Int64:
    """Returns pseudo-random numbers from -bound to bound, int64 [rows, columns].

    They are multiples of an odd number modulo 2^64. Importing NumPy's generators takes longer than the self-test.
    """
    numbers = np.arange(1, rows * columns + 1, dtype=np.uint64) * np.uint64(0x9E3779B97F4A7C15) >> np.uint64(32)
    return (numbers.astype(np.int64) % (2 * bound + 1) - bound).reshape(rows, columns)


def is_exact(product: Callable[[F32, F32], NDArray[Any]]) -> bool:
    """SPEC 13.3: whether products of float32 matrices are exact integers, over shapes that the decoder uses.

    product: of two matrices, [n, m] and [m, k]. Sums near the bound are compared with int64. This detects a faulty BLAS
    and a mode of reduced precision.
    """
    for rows, fan_in, width in ((1, 4, 16), (7, 36, 100), (65, 100, 175), (33, 128, 128), (257, 30, 100)):
        largest = min(WEIGHT_MAX, (ACCUMULATOR_BOUND - 1) // (ACTIVATION_MAX * fan_in))
        w, a = mixed(fan_in, width, largest), mixed(rows, fan_in, ACTIVATION_MAX)
        w[:, 0], a[0] = largest, ACTIVATION_MAX
        if not np.array_equal(product(a.astype(np.float32), w.astype(np.float32)).astype(np.int64), a @ w):
            return False
    return True


@cache
def float32_is_exact() -> bool:
    """Whether NumPy's float32 products are exact on this machine: the self-test of SPEC 13.3, at the first use."""
    return is_exact(np.matmul)
