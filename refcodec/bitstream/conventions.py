"""Clause 2: the integer operators that every exact step is made of.

All of them act on int64 arrays. The callers keep to the widths that SPEC.md states, so nothing wraps.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Int64 = NDArray[np.int64]
F32 = NDArray[np.float32]


def rshift_round(a: Int64, s: Int64 | int) -> Int64:
    """SPEC 2.4 RSHIFT_ROUND(a, s), s >= 0: floor(a / 2^s + 1/2); s = 0 gives a. Elementwise, int64."""
    shift = np.asarray(s, dtype=np.int64)
    half = np.where(shift > 0, np.int64(1) << np.maximum(shift - 1, 0), 0)
    return (a + half) >> shift


def clamp(a: Int64, lo: int, hi: int) -> Int64:
    """SPEC 2.4 CLAMP(a, lo, hi), elementwise."""
    return np.clip(a, lo, hi)


def isqrt(a: Int64) -> Int64:
    """SPEC 2.4 ISQRT(a), 0 <= a < 2^62: the largest integer r with r * r <= a, elementwise.

    The float square root is a first guess only; the correction makes the result exact on every machine.
    """
    r = np.sqrt(a.astype(np.float64)).astype(np.int64)
    r -= r * r > a
    r += (r + 1) * (r + 1) <= a
    return r


def f32_parts(x: float) -> tuple[int, int]:
    """SPEC 2.3: (m, e) with x = m * 2^e exactly, m odd or zero, for a finite x."""
    n, d = float(x).as_integer_ratio()
    if n == 0:
        return 0, 0
    e = (n & -n).bit_length() - 1
    return n >> e, e - (d.bit_length() - 1)


def round_to_f32(a: Int64, exponent: int) -> NDArray[np.float32]:
    """SPEC 2.4 ROUND_F32(a * 2^exponent): one rounding to nearest, ties to even; |a| < 2^63.

    int64 to float32 rounds once; the power of two is exact because SPEC.md's limits keep the result normal.
    """
    return np.ldexp(a.astype(np.float32), exponent).astype(np.float32)
