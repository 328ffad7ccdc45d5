"""Gaussians of anchors, and their gradients: the kernels of spawn.spawn_torch.

It takes one pass each way over the Gaussians that are drawn, where autograd takes a dozen over arrays of all offsets.
One thread sums an anchor's gradients in one order, and the result does not depend on the number of threads.
"""

import math
from typing import Any

import numpy as np
import torch
from numba import prange
from numpy.typing import NDArray
from torch import Tensor

from ...rendering.compiled import compiled
from ..harmonics import harmonics_torch

F32 = NDArray[np.float32]
I64 = NDArray[np.int64]


_ONE = np.float32(1)


# A Python number beside a float32 would make numba compute in float64, which takes four times as long.
@compiled(inline="always")
def _logistic(x: np.float32) -> np.float32:
    return _ONE / (_ONE + math.exp(-x))


# share: the derivative of the logarithm of a length by its network output is one minus it.
@compiled(parallel=True)
def _forward(chosen: I64, k: int, position: F32, offsets: F32, scalings: F32, covariance: F32, static: bool) -> Any:
    n = chosen.shape[0]
    mean, lengths = np.empty((n, 3), np.float32), np.empty((n, 3), np.float32)
    quaternion, share = np.empty((n, 4), np.float32), np.zeros((n, 3), np.float32)
    for i in prange(n):
        anchor, offset = chosen[i] // k, chosen[i] % k
        for j in range(3):
            mean[i, j] = position[anchor, j] + offsets[anchor, 3 * offset + j] * math.exp(scalings[anchor, j])
            if static:
                lengths[i, j] = math.exp(scalings[anchor, 3 + j] + covariance[anchor, 7 * offset + j])
            else:
                share[i, j] = _logistic(covariance[anchor, 7 * offset + j])
                lengths[i, j] = math.exp(scalings[anchor, 3 + j]) * share[i, j]
        for j in range(4):
            quaternion[i, j] = covariance[anchor, 7 * offset + 3 + j]
    return mean, quaternion, lengths, share


@compiled(parallel=True)
def _colours(chosen: I64, k: int, colour: F32, basis: F32) -> F32:
    n, count = basis.shape
    rgb = np.empty((n, 3), np.float32)
    for i in prange(n):
        anchor, offset = chosen[i] // k, chosen[i] % k
        for j in range(3):
            if count == 0:
                rgb[i, j] = _logistic(colour[anchor, 3 * offset + j])
                continue
            total = np.float32(0.5)
            for c in range(count):
                total += basis[i, c] * colour[anchor, 3 * (count * offset + c) + j]
            rgb[i, j] = max(total, np.float32(0))
    return rgb


@compiled(parallel=True)
def _backward(first: I64, chosen: I64, k: int, offsets: F32, scalings: F32, made: Any, upstream: Any) -> Any:
    (share, lengths, rgb, basis), (d_mean, d_quaternion, d_lengths, d_rgb) = made, upstream
    n, count = scalings.shape[0], basis.shape[1]
    d_offsets, d_scalings = np.zeros((n, 3 * k), np.float32), np.zeros((n, 6), np.float32)
    d_covariance, d_colour = np.zeros((n, 7 * k), np.float32), np.zeros((n, 3 * max(count, 1) * k), np.float32)
    for anchor in prange(n):
        for j in range(3):
            spread = math.exp(scalings[anchor, j])
            for i in range(first[anchor], first[anchor + 1]):
                at = 3 * (chosen[i] % k) + j
                d_offsets[anchor, at] = d_mean[i, j] * spread
                d_scalings[anchor, j] += d_mean[i, j] * offsets[anchor, at] * spread
                if count == 0:
                    d_colour[anchor, at] = d_rgb[i, j] * rgb[i, j] * (_ONE - rgb[i, j])
                elif rgb[i, j] > 0:
                    for c in range(count):
                        d_colour[anchor, 3 * (count * (chosen[i] % k) + c) + j] = d_rgb[i, j] * basis[i, c]
        for i in range(first[anchor], first[anchor + 1]):
            at = 7 * (chosen[i] % k)
            for j in range(3):
                along = d_lengths[i, j] * lengths[i, j]
                d_scalings[anchor, 3 + j] += along
                d_covariance[anchor, at + j] = along * (_ONE - share[i, j])
            for j in range(4):
                d_covariance[anchor, at + 3 + j] = d_quaternion[i, j]
    return d_offsets, d_scalings, d_covariance, d_colour


class Spawn(torch.autograd.Function):
    """Spawn.apply(chosen, k, position, offsets, scalings, covariance, colour, centre), as spawn.spawn_torch."""

    @staticmethod
    def forward(ctx: Any, chosen: Tensor, k: int, position: Tensor, *given: Any) -> tuple[Tensor, ...]:
        offsets, scalings, covariance, colour, centre = given
        arrays = [v.detach().contiguous().numpy() for v in (position, offsets, scalings, covariance, colour)]
        *gaussians, share = _forward(chosen.numpy(), k, *arrays[:-1], centre is not None)
        mean, quaternion, lengths = (torch.from_numpy(v) for v in gaussians)
        basis = torch.empty(len(chosen), 0)
        if centre is not None:
            basis = harmonics_torch(mean - centre, colour.shape[1] // (3 * k)).contiguous()
        rgb = torch.from_numpy(_colours(chosen.numpy(), k, arrays[-1], basis.numpy()))
        ctx.save_for_backward(chosen, offsets, scalings, torch.from_numpy(share), lengths, rgb, basis)
        ctx.k = k
        return mean, quaternion, lengths, rgb

    @staticmethod
    def backward(ctx: Any, *upstream: Tensor) -> tuple[Tensor | None, ...]:
        chosen, *values = (v.contiguous() for v in ctx.saved_tensors)
        offsets, scalings, *made = (v.detach().numpy() for v in values)
        first = torch.searchsorted(chosen, torch.arange(len(scalings) + 1) * ctx.k).numpy()
        along = tuple(g.contiguous().numpy() for g in upstream)
        gradients = _backward(first, chosen.numpy(), ctx.k, offsets, scalings, tuple(made), along)
        return (None, None, None, *(torch.from_numpy(g) for g in gradients), None)
