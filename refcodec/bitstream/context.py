"""Clause 7.5: geometry to context."""

import numpy as np
from numpy.typing import NDArray

from .conventions import Int64, clamp, isqrt, rshift_round
from .frame import Frame
from .networks import activation
from .positions import position_integers
from .tables import SINE_LENGTH, tables

# SPEC 7.5: UNIT represents 1 in every coordinate after the frame. SPEC 7.5.1: the largest magnitude of a coordinate.
UNIT_BITS = 16
UNIT = 1 << UNIT_BITS
FRAME_CLAMP = (1 << 30) - 1
# SPEC 7.5.4: the fraction bits of an interpolation weight.
LERP_BITS = 8
# SPEC 7.3: the planes of r = 1 and r = 2, int16 [ch, B, B] and [ch, 2 B, 2 B].
JoinedPlanes = tuple[NDArray[np.int16], NDArray[np.int16]]


def frame_coordinates(frame: Frame, p: Int64) -> Int64:
    """SPEC 7.5.1: returns v, the frame coordinates in units of 2^-16. p: P of the positions. Both are int64 [n, 3]."""
    v = rshift_round(p @ frame.matrix.T + frame.translation, frame.shift)
    return clamp(v, -FRAME_CLAMP, FRAME_CLAMP)


def contract(v: Int64) -> Int64:
    """SPEC 7.5.2: returns w, the contracted coordinates. v and w are int64 [n, 3], in units of 2^-16.

    Points in the unit ball are unchanged. Others become (2 - 1/|v|) v/|v|, with floor square root and floor division.
    """
    square = (v * v).sum(axis=1)
    n = isqrt(square)[:, None]
    outside = square[:, None] > UNIT * UNIT
    divisor = np.maximum(n, 1)
    factor = (2 * n - UNIT) * UNIT // divisor
    return np.where(outside, v * factor // divisor, v)


def rescale(frame: Frame, w: Int64) -> Int64:
    """SPEC 7.5.3: returns u, which maps low to high onto 0 to 2^16 inclusive. w and u are int64 [n, 3]."""
    return clamp(((w - frame.low) << UNIT_BITS) // (frame.high - frame.low), 0, UNIT)


def query(plane: NDArray[np.int16], u: Int64, plane_shift: int) -> Int64:
    """SPEC 7.5.4: returns bilinear samples of a plane, int64 [n, channels].

    plane: int16 [channels, s, s]. u: int64 [n, 2], 0 to 2^16. u[:, 0] counts columns, u[:, 1] rows.
    """
    size = plane.shape[-1]
    grid = u * (size - 1)
    cell = np.minimum(grid >> UNIT_BITS, size - 2)
    fraction = rshift_round(grid - (cell << UNIT_BITS), UNIT_BITS - LERP_BITS)
    j, i = cell[:, 0], cell[:, 1]
    fj, fi = fraction[:, 0], fraction[:, 1]
    one = 1 << LERP_BITS
    flat = plane.reshape(len(plane), -1)
    at = i * size + j
    total = (
        flat[:, at] * ((one - fj) * (one - fi))
        + flat[:, at + 1] * (fj * (one - fi))
        + flat[:, at + size] * ((one - fj) * fi)
        + flat[:, at + size + 1] * (fj * fi)
    )
    return activation(rshift_round(total, 2 * LERP_BITS - plane_shift)).T


def positional_encoding(u: Int64, frequencies: int) -> Int64:
    """SPEC 7.5.5: returns gamma of z', int64 [n, 2 * frequencies]: the sine, then the cosine of each frequency.

    u: int64 [n], 0 to 2^16, represents z'.
    """
    k = np.arange(frequencies)
    phase = ((u[:, None] - UNIT // 2) << k) & (UNIT - 1)
    turn = rshift_round(phase, UNIT_BITS - SINE_LENGTH.bit_length() + 1)
    sine = tables().sine
    pair = [sine[turn % SINE_LENGTH], sine[(turn + SINE_LENGTH // 4) % SINE_LENGTH]]
    return np.stack(pair, axis=2).reshape(len(u), 2 * frequencies)


def context(
    frame: Frame | None, planes: JoinedPlanes, plane_shift: int, frequencies: int, positions: NDArray[np.float16]
) -> NDArray[np.int16]:
    """SPEC 7.5: returns the inputs of F_h, int16 [n, 2 ch + 2 L], each in [-1023, 1023].

    frame: None if there are no inputs. planes: the result of assemble_planes. frequencies: L.
    positions: float16 [n, 3].
    """
    if frame is None:
        return np.zeros((len(positions), 0), dtype=np.int16)
    u = rescale(frame, contract(frame_coordinates(frame, position_integers(positions))))
    parts = [query(plane, u[:, :2], plane_shift) for plane in planes if len(plane)]
    return np.concatenate([*parts, positional_encoding(u[:, 2], frequencies)], axis=1).astype(np.int16)
