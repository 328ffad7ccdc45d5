"""The inputs of F_h from the planes (SPEC.md 7.5.4), and their gradient: the kernel of PlaneSamples.query_torch.

One pass over the anchors replaces four gathers, two weighted sums and their copies. One thread sums the gradients of
the planes of one scale in one order, and no result depends on the number of threads.
"""

import math
from typing import Any

import numpy as np
import torch
from numba import prange
from numpy.typing import NDArray
from torch import Tensor

from ...bitstream.networks import ACTIVATION_MAX
from ...rendering.compiled import compiled
from ...rendering.simd import WIDTH, fma, load, splat, store
from ..rate_model.units import PLANE_SHIFT

F32 = NDArray[np.float32]
I64 = NDArray[np.int64]

_UNIT, _MOST = np.float32(2.0**PLANE_SHIFT), np.float32(ACTIVATION_MAX)


@compiled(inline="always")
def _plane(scale: int, i: int, j: int, size: int) -> Any:
    """The plane of the value at row i and column j of a scale, and its place there (SPEC 6.9)."""
    if scale == 0:
        return 0, i * size + j
    return 1 + 2 * (i // size) + j // size, (i % size) * size + j % size


@compiled(parallel=True)
def _tables(symbols: F32) -> Any:
    """The planes of both scales [side^2, ch] of symbols [5, ch, B, B], one after the other."""
    channels, size = symbols.shape[1], symbols.shape[2]
    flat = symbols.reshape(symbols.shape[0], channels, size * size)
    tables = np.empty((5 * size * size, channels), np.float32)
    for scale in prange(2):
        side, begin = (scale + 1) * size, scale * size * size
        for i in range(side):
            for j in range(side):
                plane, at = _plane(scale, i, j, size)
                for c in range(channels):
                    tables[begin + i * side + j, c] = flat[plane, c, at]
    return tables


@compiled(parallel=True)
def _forward(symbols: F32, rows: I64, corners: I64, shares: F32, gamma: F32, rounding: bool) -> Any:
    channels, size = symbols.shape[1], symbols.shape[2]
    tables = _tables(symbols)
    inputs = np.empty((rows.shape[0], 2 * channels + gamma.shape[1]), np.float32)
    inside = np.empty((rows.shape[0], 2 * channels), np.bool_)
    for r in prange(rows.shape[0]):
        for scale in range(2):
            at, across = corners[scale, rows[r], 0], (scale + 1) * size
            s = shares[scale, rows[r]]
            at += scale * size * size
            for c in range(channels):
                value = s[0] * tables[at, c] + s[1] * tables[at + 1, c]
                value += s[2] * tables[at + across, c] + s[3] * tables[at + across + 1, c]
                value *= _UNIT
                if rounding:
                    value = math.floor(value + np.float32(0.5))
                inside[r, scale * channels + c] = abs(value) <= _MOST
                inputs[r, scale * channels + c] = min(max(value, -_MOST), _MOST)
        for c in range(gamma.shape[1]):
            inputs[r, 2 * channels + c] = gamma[rows[r], c]
    return inputs, inside


@compiled(parallel=True)
def _backward(upstream: F32, inside: NDArray[np.bool_], rows: I64, corners: I64, shares: F32, size: int) -> F32:
    channels = inside.shape[1] // 2
    # Rows of whole lanes: anchors near each other add to the same rows, and wait for each other's sums.
    room = (channels + WIDTH - 1) // WIDTH * WIDTH
    tables = np.zeros((5 * size * size, room), np.float32)
    flat = tables.reshape(-1)
    gradient = np.zeros((5, channels, size * size), np.float32)
    for scale in prange(2):
        side, begin = (scale + 1) * size, scale * size * size
        along = np.zeros(room, np.float32)
        for r in range(rows.shape[0]):
            row = rows[r]
            at = (begin + corners[scale, row, 0]) * room
            s0, s1 = splat(shares[scale, row, 0]), splat(shares[scale, row, 1])
            s2, s3 = splat(shares[scale, row, 2]), splat(shares[scale, row, 3])
            for c in range(channels):
                k = scale * channels + c
                along[c] = upstream[r, k] * _UNIT if inside[r, k] else np.float32(0)
            for c in range(0, room, WIDTH):
                g, here = load(along, c), at + c
                below = here + side * room
                store(flat, here, fma(s0, g, load(flat, here)))
                store(flat, here + room, fma(s1, g, load(flat, here + room)))
                store(flat, below, fma(s2, g, load(flat, below)))
                store(flat, below + room, fma(s3, g, load(flat, below + room)))
        for i in range(side):
            for j in range(side):
                plane, at = _plane(scale, i, j, size)
                for c in range(channels):
                    gradient[plane, c, at] = tables[begin + i * side + j, c]
    return gradient


class Query(torch.autograd.Function):
    """Query.apply(symbols, rows, corners, shares, gamma, rounding) -> inputs of F_h, float32 [n, 2 ch + G].

    symbols: float32 [5, ch, B, B]; only these have a gradient. rows: int64 [n]. corners: int64 [2, N, 4], of the
    planes of both scales, and shares: float32 [2, N, 4], their weights. gamma: float32 [N, G]. rounding: whether the
    contexts are rounded, with the identity's gradient.
    """

    @staticmethod
    def forward(
        ctx: Any, symbols: Tensor, rows: Tensor, corners: Tensor, shares: Tensor, gamma: Tensor, rounding: bool
    ) -> Tensor:
        arrays = [v.numpy() for v in (symbols.detach().contiguous(), rows, corners, shares, gamma)]
        inputs, inside = _forward(*arrays, rounding)
        ctx.given = (inside, *arrays[1:4], symbols.shape)
        return torch.from_numpy(inputs)

    @staticmethod
    def backward(ctx: Any, *upstream: Tensor) -> tuple[Tensor | None, ...]:
        *arrays, shape = ctx.given
        gradient = _backward(upstream[0].contiguous().numpy(), *arrays, shape[-1])
        return torch.from_numpy(gradient).reshape(shape), None, None, None, None, None
