"""Bits of symbols and their gradients in one pass, eight symbols at once, for training on CPUs."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import torch
from numba import prange
from numpy.typing import NDArray
from torch import Tensor

from ...bitstream.tables import SCALE_MIN
from ...render.compiled import compiled
from ...render.simd import WIDTH, exp2, fma, load, maximum, minimum, select, splat, store
from .units import MEAN_UNIT, SCALE_MOST, SCALE_UNIT

F32 = NDArray[np.float32]
I64 = NDArray[np.int64]

# Symbols that a thread takes at once.
_BLOCK = 1 << 13
_ZERO, _ONE, _HALF, _TWO = (np.float32(v) for v in (0, 1, 0.5, 2))
# exp2 knows no exponents below.
_LEAST = np.float32(-126)
_PER_MEAN, _PER_SCALE = np.float32(1 / MEAN_UNIT), np.float32(1 / SCALE_UNIT)
_BY_MEAN = np.float32(1 / (MEAN_UNIT * math.log(2)))
_LOW, _HIGH = np.float32(SCALE_MIN), np.float32(SCALE_MOST)
_LOG2_E, _ROOT = np.float32(-math.log2(math.e)), np.float32(math.sqrt(0.5))
_DENSITY = np.float32(1 / math.sqrt(2 * math.pi))
# exp(z^2) erfc(z) / t is a polynomial of t = 1 / (1 + z / 2) with a relative error of at most 5e-8 for z from 0 to 14:
# the one of least error among those of degree 8. The constant term comes first.
_TAIL = np.array(
    [
        0.2820843458,
        0.2824121118,
        0.2428351045,
        0.2037525624,
        -0.0291486364,
        0.2817334533,
        -0.4904065430,
        0.2861240506,
        -0.0593864843,
    ],
    np.float32,
)


@compiled(inline="always")
def _gauss(t: Any) -> Any:
    """The share of a unit Gaussian distribution above t, and its density there."""
    z = maximum(t, splat(_ZERO) - t) * splat(_ROOT)
    falls = exp2(maximum(z * z * splat(_LOG2_E), splat(_LEAST)))
    u = splat(_ONE) / fma(z, splat(_HALF), splat(_ONE))
    q = splat(_TAIL[8])
    for k in range(7, -1, -1):
        q = fma(q, u, splat(_TAIL[k]))
    above = q * u * falls * splat(_HALF)
    return select(t < splat(_ZERO), splat(_ONE) - above, above), falls * splat(_DENSITY)


@compiled(inline="always")
def _laplace(t: Any) -> Any:
    """The share of a unit Laplace distribution above t, and its density there."""
    density = exp2(maximum(maximum(t, splat(_ZERO) - t) * splat(_LOG2_E), splat(_LEAST))) * splat(_HALF)
    return select(t < splat(_ZERO), splat(_ONE) - density, density), density


@compiled(parallel=True)
def _likelihood(mean: F32, scale: F32, symbol: F32, gauss: bool, floor: np.float32, to: F32) -> None:
    """Of arrays of a multiple of eight values: probabilities, and what bits change by with means and scales: to [3, n].

    A gradient for scales past the table's smallest one is among them.
    """
    p_to, mean_to, scale_to = to[0], to[1], to[2]
    for block in prange((mean.shape[0] + _BLOCK - 1) // _BLOCK):
        zero = splat(_ZERO)
        for at in range(block * _BLOCK, min(block * _BLOCK + _BLOCK, mean.shape[0]), WIDTH):
            cut = minimum(maximum(load(scale, at), splat(_LOW)), splat(_HIGH))
            narrow = splat(_ONE) / exp2(cut * splat(_PER_SCALE))
            away = load(symbol, at) - load(mean, at) * splat(_PER_MEAN)
            a = maximum(away, zero - away)
            t0, t1 = (a - splat(_HALF)) * narrow, (a + splat(_HALF)) * narrow
            if gauss:
                p0, d0 = _gauss(t0)
                p1, d1 = _gauss(t1)
            else:
                p0, d0 = _laplace(t0)
                p1, d1 = _laplace(t1)
            p = maximum(p0 - p1, zero) + splat(floor)
            along = (d1 - d0) * narrow * splat(_BY_MEAN) / p
            store(p_to, at, p)
            store(mean_to, at, select(away < zero, zero - along, select(zero < away, along, zero)))
            store(scale_to, at, (t1 * d1 - t0 * d0) * splat(_PER_SCALE) / p)


def likelihood(mean: F32, scale: F32, symbol: F32, gauss: bool, floor: float) -> tuple[F32, F32, F32]:
    """Bits of symbols, and their derivatives by means and scales, all shaped like the contiguous inputs."""
    size = mean.size
    room = -(-size // WIDTH) * WIDTH
    inputs = [v.reshape(-1) for v in (mean, scale, symbol)]
    if room > size:
        inputs = [np.concatenate([v, np.zeros(room - size, np.float32)]) for v in inputs]
    found = np.empty((3, room), np.float32)
    _likelihood(*inputs, gauss, np.float32(floor), found)
    torch.from_numpy(found[0]).log2_().neg_()
    bits, by_mean, by_scale = (v[:size].reshape(mean.shape) for v in found)
    return bits, by_mean, by_scale


@compiled(parallel=True)
def _gather(out: F32, change: F32, columns: I64, width: int) -> Any:
    """Means and scales [n, D] of F_h's outputs [n, 2 D] and CARM's changes. columns [2, D]: in change, or -1."""
    mean, scale = np.empty((out.shape[0], width), np.float32), np.empty((out.shape[0], width), np.float32)
    for r in prange(out.shape[0]):
        for d in range(width):
            mean[r, d], scale[r, d] = out[r, d], out[r, width + d]
            if columns[0, d] >= 0:
                mean[r, d] += change[r, columns[0, d]]
                scale[r, d] += change[r, columns[1, d]]
    return mean, scale


@compiled(inline="always")
def _dropped(kept: F32, r: int, but: int) -> np.float32:
    """One minus the masks of an anchor's offsets, multiplied, but for one of them."""
    product = _ONE
    for k in range(kept.shape[1]):
        if k != but:
            product *= _ONE - kept[r, k]
    return product


@compiled(parallel=True)
def _sums(bits: F32, kept: F32, features: int) -> Any:
    """Bits of features, scalings and offsets [n, 3], and all of each part alone: [n, 2 + K]."""
    offsets = kept.shape[1]
    begin = bits.shape[1] - 3 * offsets
    found = np.empty((bits.shape[0], 3), np.float32)
    parts = np.zeros((bits.shape[0], 2 + offsets), np.float32)
    for r in prange(bits.shape[0]):
        for d in range(bits.shape[1]):
            part = 0 if d < features else (1 if d < begin else 2 + (d - begin) // 3)
            parts[r, part] += bits[r, d]
        some = _ONE - _dropped(kept, r, -1)
        found[r, 0], found[r, 1], found[r, 2] = parts[r, 0] * some, parts[r, 1] * some, _ZERO
        for k in range(offsets):
            found[r, 2] += parts[r, 2 + k] * kept[r, k]
    return found, parts


@compiled(parallel=True)
def _sums_backward(
    upstream: F32,
    parts: F32,
    kept: F32,
    features: int,
    scale: F32,
    by_mean: F32,
    by_scale: F32,
    columns: I64,
    more: int,
) -> Any:
    """Gradients of F_h's outputs, of CARM's changes [n, more], of symbols and of masks."""
    offsets, width = kept.shape[1], scale.shape[1]
    begin = width - 3 * offsets
    out, change = np.empty((scale.shape[0], 2 * width), np.float32), np.empty((scale.shape[0], more), np.float32)
    symbols, masks = np.empty(scale.shape, np.float32), np.empty(kept.shape, np.float32)
    for r in prange(scale.shape[0]):
        some = _ONE - _dropped(kept, r, -1)
        for d in range(width):
            weight = (
                upstream[r, 2] * kept[r, (d - begin) // 3] if d >= begin else upstream[r, int(d >= features)] * some
            )
            along, wider = weight * by_mean[r, d], weight * by_scale[r, d]
            # Past the table's smallest scale a gradient may lead back inside, no further out.
            if scale[r, d] <= _LOW and wider > 0:
                wider = _ZERO
            out[r, d], out[r, width + d] = along, wider
            symbols[r, d] = -along * np.float32(MEAN_UNIT)
            if columns[0, d] >= 0:
                change[r, columns[0, d]], change[r, columns[1, d]] = along, wider
        shared = upstream[r, 0] * parts[r, 0] + upstream[r, 1] * parts[r, 1]
        for k in range(offsets):
            masks[r, k] = upstream[r, 2] * parts[r, 2 + k] + shared * _dropped(kept, r, k)
    return out, change, symbols, masks


def _array(value: Tensor) -> F32:
    array: F32 = value.detach().contiguous().numpy()
    return array


class Bits(torch.autograd.Function):
    """Bits.apply(mean, scale, symbol, gauss, floor): bits.gauss_bits, or laplace_bits."""

    @staticmethod
    def forward(ctx: Any, mean: Tensor, scale: Tensor, symbol: Tensor, gauss: bool, floor: float) -> Tensor:
        found = likelihood(_array(mean), _array(scale), _array(symbol), gauss, floor)
        bits, by_mean, by_scale = (torch.from_numpy(v) for v in found)
        ctx.save_for_backward(scale)
        ctx.by = by_mean, by_scale
        return bits

    @staticmethod
    def backward(ctx: Any, *upstream: Tensor) -> tuple[Tensor | None, ...]:
        (scale,), (by_mean, by_scale) = ctx.saved_tensors, ctx.by
        along, wider = upstream[0] * by_mean, upstream[0] * by_scale
        wider.masked_fill_((scale <= SCALE_MIN) & (wider > 0), 0)
        return along, wider, -MEAN_UNIT * along if ctx.needs_input_grad[2] else None, None, None


class AttributeBits(torch.autograd.Function):
    """AttributeBits.apply(out, change, symbols, kept, columns, features, floor) -> float32 [n, 3].

    out: means and scales of F_h, [n, 2 D]. change: CARM's, [n, .]. columns: int64 [2, D], those of change that each
    mean and scale adds, or -1. symbols [n, D]. kept [n, K]. features: their number. The rest is
    model.RateModel.attribute_bits.
    """

    @staticmethod
    def forward(
        ctx: Any,
        out: Tensor,
        change: Tensor,
        symbols: Tensor,
        kept: Tensor,
        columns: Tensor,
        features: int,
        floor: float,
    ) -> Tensor:
        masks = _array(kept)
        mean, scale = _gather(_array(out), _array(change), columns.numpy(), symbols.shape[1])
        bits, by_mean, by_scale = likelihood(mean, scale, _array(symbols), True, floor)
        found, parts = _sums(bits, masks, features)
        ctx.given = parts, masks, features, scale, by_mean, by_scale, columns.numpy(), change.shape[1]
        return torch.from_numpy(found)

    @staticmethod
    def backward(ctx: Any, *upstream: Tensor) -> tuple[Tensor | None, ...]:
        gradients = _sums_backward(_array(upstream[0]), *ctx.given)
        return (*(torch.from_numpy(g) for g in gradients), None, None, None)
