"""A layer on integer activations (SPEC.md 7.2) with its gradient in few passes, for training on CPUs."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import torch
from numba import prange
from numpy.typing import NDArray
from torch import Tensor

from ...bitstream.networks import ACTIVATION_MAX
from ...render.compiled import compiled

F32 = NDArray[np.float32]
Mask = NDArray[np.bool_]

_HALF, _MOST = np.float32(0.5), np.float32(ACTIVATION_MAX)


@compiled()
def _fold(weight: F32, bias: F32, before: F32, after: F32, step: F32, gridded: bool) -> Any:
    """The file's weights and biases, [out, in] and [out], of those of order one."""
    by_weight, by_bias = np.empty(weight.shape, np.float32), np.empty(bias.shape, np.float32)
    for o in range(weight.shape[0]):
        for i in range(weight.shape[1]):
            value = weight[o, i] * (after[o] / before[i])
            by_weight[o, i] = math.floor(value / step[o] + _HALF) * step[o] if gridded else value
        value = bias[o] * after[o]
        by_bias[o] = math.floor(value / step[o] + _HALF) * step[o] if gridded else value
    return by_weight, by_bias


@compiled()
def _unfold(weight: F32, bias: F32, before: F32, after: F32) -> None:
    """Makes gradients of the file's weights and biases those of the weights and biases of order one."""
    for o in range(weight.shape[0]):
        for i in range(weight.shape[1]):
            weight[o, i] *= after[o] / before[i]
        bias[o] *= after[o]


@compiled(parallel=True)
def _rectify(values: F32, rounding: bool) -> Mask:
    """Makes sums [n, out] activations. Returns where they have a gradient."""
    inside = np.empty(values.shape, np.bool_)
    for r in prange(values.shape[0]):
        for c in range(values.shape[1]):
            value = values[r, c]
            if rounding:
                inside[r, c] = (value > 0) & (value <= _MOST)
                values[r, c] = math.floor(min(max(value, np.float32(0)), _MOST) + _HALF)
            else:
                inside[r, c] = value > 0
                values[r, c] = max(value, np.float32(0))
    return inside


@compiled(parallel=True)
def _through(upstream: F32, inside: Mask) -> F32:
    found = np.empty(upstream.shape, np.float32)
    for r in prange(upstream.shape[0]):
        for c in range(upstream.shape[1]):
            found[r, c] = upstream[r, c] if inside[r, c] else np.float32(0)
    return found


class FoldedLayer(torch.autograd.Function):
    """FoldedLayer.apply(x, weight, bias, before, after, step, gridded, rectifies, rounding) -> float32 [n, out].

    x: float32 [n, in]. weight [out, in], bias [out]: of order one. before [in], after [out]: the integers that stand
    for one at inputs and outputs, powers of two. step [out]: of each row's weights and bias in the file, which count if
    gridded. The result is activations if it rectifies, which are integers if rounding, or else sums. Roundings have the
    identity's gradient.
    """

    @staticmethod
    def forward(
        ctx: Any,
        x: Tensor,
        weight: Tensor,
        bias: Tensor,
        before: Tensor,
        after: Tensor,
        step: Tensor,
        gridded: bool,
        rectifies: bool,
        rounding: bool,
    ) -> Tensor:
        units = before.numpy(), after.numpy()
        folded = _fold(weight.detach().numpy(), bias.detach().numpy(), *units, step.numpy(), gridded)
        by_weight, by_bias = (torch.from_numpy(v) for v in folded)
        found = torch.addmm(by_bias, x, by_weight.T)
        ctx.inside = _rectify(found.numpy(), rounding) if rectifies else None
        ctx.units = units
        ctx.save_for_backward(x, by_weight)
        return found

    @staticmethod
    def backward(ctx: Any, *upstream: Tensor) -> tuple[Tensor | None, ...]:
        x, by_weight = ctx.saved_tensors
        along = upstream[0]
        if ctx.inside is not None:
            along = torch.from_numpy(_through(along.contiguous().numpy(), ctx.inside))
        weight, bias = along.T @ x, along.sum(dim=0)
        _unfold(weight.numpy(), bias.numpy(), *ctx.units)
        inputs = along @ by_weight if ctx.needs_input_grad[0] else None
        return inputs, weight, bias, None, None, None, None, None, None
