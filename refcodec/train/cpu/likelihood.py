"""Bits of symbols and their gradients in one pass, eight symbols at a time: the kernel of bits.TorchBits."""

import math
from typing import Any

import numpy as np
import torch
from numba import prange
from numpy.typing import NDArray
from torch import Tensor

from ...bitstream.tables import SCALE_MIN
from ...rendering.compiled import compiled
from ...rendering.simd import WIDTH, exp2, fma, load, maximum, minimum, select, splat, store
from ..rate_model.units import MEAN_UNIT, SCALE_MOST, SCALE_UNIT

F32 = NDArray[np.float32]

# Symbols that a thread takes at once.
_BLOCK = 1 << 13
_ZERO, _ONE, _HALF, _TWO = (np.float32(v) for v in (0, 1, 0.5, 2))
# exp2 accepts no exponents below this one.
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
        *(0.2820843458, 0.2824121118, 0.2428351045, 0.2037525624, -0.0291486364),
        *(0.2817334533, -0.4904065430, 0.2861240506, -0.0593864843),
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


@compiled(inline="always")
def one_likelihood(mean: Any, scale: Any, symbol: Any, gauss: bool, floor: np.float32) -> Any:
    """The probabilities of eight symbols, and the derivatives of their bits by means and scales.

    They include a gradient for scales below the table's smallest one.
    """
    zero = splat(_ZERO)
    narrow = splat(_ONE) / exp2(minimum(maximum(scale, splat(_LOW)), splat(_HIGH)) * splat(_PER_SCALE))
    away = symbol - mean * splat(_PER_MEAN)
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
    by_mean = select(away < zero, zero - along, select(zero < away, along, zero))
    return p, by_mean, (t1 * d1 - t0 * d0) * splat(_PER_SCALE) / p


@compiled(parallel=True)
def _likelihood(mean: F32, scale: F32, symbol: F32, floor: np.float32, to: F32) -> None:
    """Writes one_likelihood of arrays of a multiple of eight values to [3, n]."""
    p_to, mean_to, scale_to = to[0], to[1], to[2]
    for block in prange((mean.shape[0] + _BLOCK - 1) // _BLOCK):
        for at in range(block * _BLOCK, min(block * _BLOCK + _BLOCK, mean.shape[0]), WIDTH):
            p, by_mean, by_scale = one_likelihood(load(mean, at), load(scale, at), load(symbol, at), True, floor)
            store(p_to, at, p)
            store(mean_to, at, by_mean)
            store(scale_to, at, by_scale)


def likelihood(mean: F32, scale: F32, symbol: F32, floor: float) -> tuple[F32, F32, F32]:
    """Bits of attributes, and their derivatives by means and scales, all shaped like the contiguous inputs."""
    size = mean.size
    room = -(-size // WIDTH) * WIDTH
    inputs = [v.reshape(-1) for v in (mean, scale, symbol)]
    if room > size:
        inputs = [np.concatenate([v, np.zeros(room - size, np.float32)]) for v in inputs]
    results = np.empty((3, room), np.float32)
    _likelihood(*inputs, np.float32(floor), results)
    torch.from_numpy(results[0]).log2_().neg_()
    bits, by_mean, by_scale = (v[:size].reshape(mean.shape) for v in results)
    return bits, by_mean, by_scale


def array(value: Tensor) -> F32:
    contiguous: F32 = value.detach().contiguous().numpy()
    return contiguous
