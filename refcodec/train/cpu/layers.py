"""A layer on integer activations (SPEC.md 7.2) with its gradient in few passes: the kernel of FoldedMlp.run_torch."""

import math
from typing import Any, NamedTuple

import numpy as np
import torch
from numba import prange
from numpy.typing import NDArray
from torch import Tensor

from ...bitstream.networks import ACTIVATION_MAX
from ...rendering.compiled import compiled

F32 = NDArray[np.float32]
Mask = NDArray[np.bool_]

_HALF, _MOST = np.float32(0.5), np.float32(ACTIVATION_MAX)


@compiled()
def fold(weight: F32, bias: F32, before: F32, after: F32, step: F32, gridded: bool) -> Any:
    """Converts weights and biases of order one, [out, in] and [out], to those of the file."""
    by_weight, by_bias = np.empty(weight.shape, np.float32), np.empty(bias.shape, np.float32)
    for o in range(weight.shape[0]):
        for i in range(weight.shape[1]):
            value = weight[o, i] * (after[o] / before[i])
            by_weight[o, i] = math.floor(value / step[o] + _HALF) * step[o] if gridded else value
        value = bias[o] * after[o]
        by_bias[o] = math.floor(value / step[o] + _HALF) * step[o] if gridded else value
    return by_weight, by_bias


@compiled()
def unfold(weight: F32, bias: F32, before: F32, after: F32) -> None:
    """Converts gradients of the file's weights and biases to those of order one."""
    for o in range(weight.shape[0]):
        for i in range(weight.shape[1]):
            weight[o, i] *= after[o] / before[i]
        bias[o] *= after[o]


@compiled(parallel=True)
def _rectify(values: F32, rounding: bool) -> Mask:
    """Turns sums [n, out] into activations. Returns where they have a gradient."""
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
    gradient = np.empty(upstream.shape, np.float32)
    for r in prange(upstream.shape[0]):
        for c in range(upstream.shape[1]):
            gradient[r, c] = upstream[r, c] if inside[r, c] else np.float32(0)
    return gradient


class Plan(NamedTuple):
    """The properties of a layer besides its weights.

    before [in], after [out]: the integers that stand for one at inputs and outputs, powers of two. step [out]: of each
    row's weights and bias in the file, which count if gridded. The result is activations if it rectifies, which are
    integers if rounding, or else sums. Roundings have the identity's gradient.
    """

    before: F32
    after: F32
    step: F32
    gridded: bool
    rectifies: bool
    rounding: bool


class Trace(NamedTuple):
    """The values of the forward pass that the backward pass needs."""

    x: Tensor
    by_weight: Tensor
    inside: Mask | None
    plan: Plan


def layer_forward(plan: Plan, x: Tensor, weight: Tensor, bias: Tensor) -> tuple[Tensor, Trace]:
    """The outputs [n, out] of a layer for x, float32 [n, in], with weights [out, in] and biases [out] of order one."""
    folded = fold(weight.detach().numpy(), bias.detach().numpy(), *plan[:4])
    by_weight, by_bias = (torch.from_numpy(v) for v in folded)
    values = torch.addmm(by_bias, x, by_weight.T)
    inside = _rectify(values.numpy(), plan.rounding) if plan.rectifies else None
    return values, Trace(x, by_weight, inside, plan)


def layer_backward(trace: Trace, upstream: Tensor, reaches_inputs: bool) -> tuple[Tensor | None, Tensor, Tensor]:
    """Gradients of inputs, None if they do not matter, of weights and of biases."""
    along = upstream
    if trace.inside is not None:
        along = torch.from_numpy(_through(along.contiguous().numpy(), trace.inside))
    weight, bias = along.T @ trace.x, along.sum(dim=0)
    unfold(weight.numpy(), bias.numpy(), *trace.plan[:2])
    return along @ trace.by_weight if reaches_inputs else None, weight, bias


class FoldedLayer(torch.autograd.Function):
    """FoldedLayer.apply(plan, x, weight, bias) -> float32 [n, out], as layer_forward."""

    @staticmethod
    def forward(ctx: Any, plan: Plan, x: Tensor, weight: Tensor, bias: Tensor) -> Tensor:
        values, ctx.trace = layer_forward(plan, x, weight, bias)
        return values

    @staticmethod
    def backward(ctx: Any, *upstream: Tensor) -> tuple[Tensor | None, ...]:
        return None, *layer_backward(ctx.trace, upstream[0], ctx.needs_input_grad[1])
