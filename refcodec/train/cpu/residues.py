"""Attributes with noise in place of rounding, or rounded, and their gradients: the kernels of stages.quantisation.

The noise is that of SplitMix64 (Steele et al. 2014), whose i-th number does not depend on the numbers before it. Both
passes compute the same noise, and no result depends on the number of threads.
"""

import math
from typing import Any

import numpy as np
import torch
from numba import prange
from numpy.typing import NDArray
from torch import Tensor

from ...rendering.compiled import compiled
from .likelihood import array

F32 = NDArray[np.float32]

_GOLDEN, _MIX_1, _MIX_2 = np.uint64(0x9E3779B97F4A7C15), np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)
_30, _27, _31, _40 = np.uint64(30), np.uint64(27), np.uint64(31), np.uint64(40)
_HALF, _FINE = np.float32(0.5), np.float32(2.0**-24)


@compiled(inline="always")
def _noise(seed: np.uint64, index: int) -> np.float32:
    """SplitMix64's number at an index, from 0: one of 2^24 values in [-0.5, 0.5)."""
    z = seed + (np.uint64(index) + np.uint64(1)) * _GOLDEN
    z = (z ^ (z >> _30)) * _MIX_1
    z = (z ^ (z >> _27)) * _MIX_2
    z ^= z >> _31
    return np.float32(np.int64(z >> _40)) * _FINE - _HALF


@compiled(parallel=True)
def _shown(values: F32, steps: F32, kind: int, seed: np.uint64, rounds: bool) -> F32:
    shown = np.empty(values.shape, np.float32)
    for r in prange(values.shape[0]):
        step = steps[r, kind]
        if rounds:
            for c in range(values.shape[1]):
                shown[r, c] = math.floor(values[r, c] / step + _HALF) * step
        else:
            for c in range(values.shape[1]):
                shown[r, c] = values[r, c] + _noise(seed, r * values.shape[1] + c) * step
    return shown


# A sum along a row may be taken in eight parts, which is a third of the time.
@compiled(parallel=True, fastmath={"reassoc", "nsz"})
def _shown_backward(values: F32, steps: F32, kind: int, seed: np.uint64, rounds: bool, upstream: F32, to: F32) -> None:
    for r in prange(values.shape[0]):
        total, step = np.float32(0), steps[r, kind]
        if rounds:
            for c in range(values.shape[1]):
                scaled = values[r, c] / step
                total += upstream[r, c] * (math.floor(scaled + _HALF) - scaled)
        else:
            for c in range(values.shape[1]):
                total += upstream[r, c] * _noise(seed, r * values.shape[1] + c)
        to[r, kind] = total


@compiled(parallel=True)
def _symbols(values: F32, steps: F32, kind: int, seed: np.uint64, rounds: bool, to: F32, begin: int) -> None:
    for r in prange(values.shape[0]):
        step = steps[r, kind]
        if rounds:
            for c in range(values.shape[1]):
                to[r, begin + c] = math.floor(values[r, c] / step + _HALF)
        else:
            for c in range(values.shape[1]):
                to[r, begin + c] = values[r, c] / step + _noise(seed, r * values.shape[1] + c)


@compiled(parallel=True, fastmath={"reassoc", "nsz"})
def _symbols_backward(values: F32, steps: F32, kind: int, upstream: F32, begin: int, to: F32) -> F32:
    gradient = np.empty(values.shape, np.float32)
    for r in prange(values.shape[0]):
        total, per_step = np.float32(0), np.float32(1) / steps[r, kind]
        for c in range(values.shape[1]):
            along = upstream[r, begin + c] * per_step
            gradient[r, c] = along
            total -= along * values[r, c] * per_step
        to[r, kind] = total
    return gradient


def _seeds(seed: int, count: int) -> list[np.uint64]:
    """The seeds of some streams, which are far from each other."""
    return [np.uint64((seed + (i << 48)) % (1 << 64)) for i in range(count)]


class WithResidues(torch.autograd.Function):
    """WithResidues.apply(steps, seed, *values) -> a tensor for each: values + residue * step, which the image shows.

    The residue is rounding's, or noise in [-0.5, 0.5). It has no gradient: a value has the gradient of the result, a
    step has it times the residue.

    steps: float32 [n, k]. values: k tensors, float32 [n, w]. seed: of the noise, in [0, 2^63); None to round.
    """

    @staticmethod
    def forward(ctx: Any, steps: Tensor, seed: int | None, *values: Tensor) -> tuple[Tensor, ...]:
        ctx.save_for_backward(steps, *values)
        ctx.seed = seed
        seeds, size = _seeds(seed or 0, len(values)), array(steps)
        shown = [_shown(array(v), size, i, seeds[i], seed is None) for i, v in enumerate(values)]
        return tuple(torch.from_numpy(v) for v in shown)

    @staticmethod
    def backward(ctx: Any, *upstream: Tensor) -> tuple[Tensor | None, ...]:
        steps, *values = ctx.saved_tensors
        seeds, size = _seeds(ctx.seed or 0, len(values)), array(steps)
        gradient = np.empty(size.shape, np.float32)
        for i, (v, g) in enumerate(zip(values, upstream, strict=True)):
            _shown_backward(array(v), size, i, seeds[i], ctx.seed is None, array(g), gradient)
        return torch.from_numpy(gradient), None, *upstream


class Symbols(torch.autograd.Function):
    """Symbols.apply(steps, seed, *values) -> float32 [n, sum of w]: values / step + residue, of which bits are counted.

    The arguments are those of WithResidues.
    """

    @staticmethod
    def forward(ctx: Any, steps: Tensor, seed: int | None, *values: Tensor) -> Tensor:
        ctx.save_for_backward(steps, *values)
        seeds, size, begin = _seeds(seed or 0, len(values)), array(steps), 0
        symbols = np.empty((len(size), sum(v.shape[1] for v in values)), np.float32)
        for i, v in enumerate(values):
            _symbols(array(v), size, i, seeds[i], seed is None, symbols, begin)
            begin += v.shape[1]
        return torch.from_numpy(symbols)

    @staticmethod
    def backward(ctx: Any, *upstream: Tensor) -> tuple[Tensor | None, ...]:
        steps, *values = ctx.saved_tensors
        size, given, begin = array(steps), array(upstream[0]), 0
        gradient, gradients = np.empty(size.shape, np.float32), []
        for i, v in enumerate(values):
            gradients.append(torch.from_numpy(_symbols_backward(array(v), size, i, given, begin, gradient)))
            begin += v.shape[1]
        return torch.from_numpy(gradient), None, *gradients
