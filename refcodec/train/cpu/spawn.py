"""Gaussians of anchors, and their gradients: the kernel of spawn.spawn_torch.

It takes one pass each way over the Gaussians that are drawn, where autograd takes a dozen over arrays of all offsets.
One thread sums an anchor's gradients in one order, and the result does not depend on the number of threads.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import torch
from numba import prange
from numpy.typing import NDArray
from torch import Tensor

from ...render.compiled import compiled

F32 = NDArray[np.float32]
I64 = NDArray[np.int64]


_ONE = np.float32(1)


# A Python number beside a float32 would make numba compute in float64, which takes four times as long.
@compiled(inline="always")
def _logistic(x: np.float32) -> np.float32:
    return _ONE / (_ONE + math.exp(-x))


@compiled(parallel=True)
def _forward(chosen: I64, k: int, position: F32, offsets: F32, scalings: F32, covariance: F32, colour: F32) -> Any:
    n = chosen.shape[0]
    mean, lengths = np.empty((n, 3), np.float32), np.empty((n, 3), np.float32)
    quaternion, rgb = np.empty((n, 4), np.float32), np.empty((n, 3), np.float32)
    share = np.empty((n, 3), np.float32)
    for i in prange(n):
        anchor, offset = chosen[i] // k, chosen[i] % k
        for j in range(3):
            mean[i, j] = position[anchor, j] + offsets[anchor, 3 * offset + j] * math.exp(scalings[anchor, j])
            share[i, j] = _logistic(covariance[anchor, 7 * offset + j])
            lengths[i, j] = math.exp(scalings[anchor, 3 + j]) * share[i, j]
            rgb[i, j] = _logistic(colour[anchor, 3 * offset + j])
        for j in range(4):
            quaternion[i, j] = covariance[anchor, 7 * offset + 3 + j]
    return mean, quaternion, lengths, rgb, share


@compiled(parallel=True)
def _backward(
    first: I64,
    chosen: I64,
    k: int,
    offsets: F32,
    scalings: F32,
    share: F32,
    lengths: F32,
    rgb: F32,
    d_mean: F32,
    d_quaternion: F32,
    d_lengths: F32,
    d_rgb: F32,
) -> Any:
    n = scalings.shape[0]
    d_offsets, d_scalings = np.zeros((n, 3 * k), np.float32), np.zeros((n, 6), np.float32)
    d_covariance, d_colour = np.zeros((n, 7 * k), np.float32), np.zeros((n, 3 * k), np.float32)
    for anchor in prange(n):
        for j in range(3):
            spread = math.exp(scalings[anchor, j])
            for i in range(first[anchor], first[anchor + 1]):
                at = 3 * (chosen[i] % k) + j
                d_offsets[anchor, at] = d_mean[i, j] * spread
                d_scalings[anchor, j] += d_mean[i, j] * offsets[anchor, at] * spread
                d_colour[anchor, at] = d_rgb[i, j] * rgb[i, j] * (_ONE - rgb[i, j])
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
    """Spawn.apply(chosen, k, position, offsets, scalings, covariance, colour) -> mean, quaternion, lengths, rgb.

    These are n Gaussians, whose quaternions are as long as the network makes them. Positions have no gradient.

    chosen: int64 [n], ascending, anchor * k + offset. The rest is float32. position [N, 3]. offsets [N, 3 k], in units
    of exp(scalings[:3]). scalings [N, 6], natural logarithms. covariance [N, 7 k] and colour [N, 3 k], of the networks.
    """

    @staticmethod
    def forward(
        ctx: Any,
        chosen: Tensor,
        k: int,
        position: Tensor,
        offsets: Tensor,
        scalings: Tensor,
        covariance: Tensor,
        colour: Tensor,
    ) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        given = (offsets, scalings, covariance, colour)
        arrays = [v.detach().contiguous().numpy() for v in (position, *given)]
        *gaussians, share = _forward(chosen.numpy(), k, *arrays)
        mean, quaternion, lengths, rgb = (torch.from_numpy(v) for v in gaussians)
        ctx.save_for_backward(chosen, offsets, scalings, torch.from_numpy(share), lengths, rgb)
        ctx.k = k
        return mean, quaternion, lengths, rgb

    @staticmethod
    def backward(ctx: Any, *upstream: Tensor) -> tuple[Tensor | None, ...]:
        chosen, offsets, scalings, share, lengths, rgb = (v.contiguous() for v in ctx.saved_tensors)
        first = torch.searchsorted(chosen, torch.arange(len(scalings) + 1) * ctx.k)
        arrays = [
            v.detach().numpy() for v in (offsets, scalings, share, lengths, rgb, *(g.contiguous() for g in upstream))
        ]
        gradients = _backward(first.numpy(), chosen.numpy(), ctx.k, *arrays)
        return (None, None, None, *(torch.from_numpy(g) for g in gradients))
