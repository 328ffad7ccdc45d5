"""Clause 2: the integer operators of all exact steps.

They act on int64 arrays element by element. Callers observe the bounds of SPEC.md 7.11, so nothing overflows.
"""

import numpy as np
from numpy.typing import NDArray

Int64 = NDArray[np.int64]
F32 = NDArray[np.float32]


def rshift_round(a: Int64, s: Int64 | int) -> Int64:
    """SPEC 2.4, RSHIFT_ROUND: returns floor(a / 2^s + 1/2), for s >= 0. int64, a and s broadcast."""
    shift = np.asarray(s, dtype=np.int64)
    half = np.where(shift > 0, np.int64(1) << np.maximum(shift - 1, 0), 0)
    return (a + half) >> shift


def clamp(a: Int64, lo: int, hi: int) -> Int64:
    """SPEC 2.4, CLAMP: returns the integers from lo to hi that are nearest to a. int64, shape of a."""
    return np.clip(a, lo, hi)


def isqrt(a: Int64) -> Int64:
    """SPEC 2.4, ISQRT: returns the largest integer r with r * r <= a, for 0 <= a < 2^62. int64, shape of a.

    The floating-point square root is only an estimate. The corrections make the result exact on every machine.
    """
    r = np.sqrt(a.astype(np.float64)).astype(np.int64)
    r -= r * r > a
    r += (r + 1) * (r + 1) <= a
    return r


def f32_parts(x: float) -> tuple[int, int]:
    """SPEC 2.3: returns (m, e) with x = m * 2^e exactly, for a finite x. m is odd. For x = 0 both are 0."""
    n, d = float(x).as_integer_ratio()
    if n == 0:
        return 0, 0
    e = (n & -n).bit_length() - 1
    return n >> e, e - (d.bit_length() - 1)


def round_to_f32(a: Int64, exponent: int) -> NDArray[np.float32]:
    """SPEC 2.4, ROUND_F32: returns the float32 nearest to a * 2^exponent, ties to even. |a| < 2^63.

    The conversion of a to float32 rounds. The power of two is exact, since SPEC.md's limits keep the result normal.
    """
    return np.ldexp(a.astype(np.float32), exponent).astype(np.float32)
