"""SPEC.md B.2: the frame."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..bitstream.context import UNIT, contract, frame_coordinates
from ..bitstream.frame import FRAME_SHIFT_MAX, MATRIX_BOUND, TRANSLATION_BOUND, Frame
from ..bitstream.positions import position_integers

# SPEC B.2: the share of the anchors, nearest to the median, that determine the frame.
INLIERS = 0.95


def choose_frame(positions: NDArray[np.float16]) -> Frame:
    """SPEC B.2: returns the frame of some positions, float16 [N, 3] and finite.

    Its axes are the principal axes of the 95 % of anchors nearest to the median. Its unit along an axis is one standard
    deviation. A direction without extent gets the unit of the widest direction, or one unit of P if none has an extent.
    Thus every set of positions has a frame, including the empty set.
    """
    p = position_integers(positions).astype(np.float64)
    if len(p) == 0:
        p = np.zeros((1, 3))
    away = np.abs(p - np.median(p, axis=0)).max(axis=1)
    inlier = away <= np.quantile(away, INLIERS)
    mean = p[inlier].mean(axis=0)
    centred = p[inlier] - mean
    variance, axes = np.linalg.eigh(centred.T @ centred / len(centred))
    order = np.argsort(variance)[::-1]
    deviation = np.sqrt(np.maximum(variance[order], 0))
    widest = deviation[0] if deviation[0] >= 1 else 1.0
    deviation = np.where(deviation < widest * 1e-6, widest, deviation)
    rows = axes[:, order].T / deviation[:, None] * UNIT
    matrix, translation, shift = np.zeros((3, 3), np.int64), np.zeros(3, np.int64), np.zeros(3, np.int64)
    for r in range(3):
        for s in range(FRAME_SHIFT_MAX, -1, -1):
            a = np.rint(rows[r] * 2.0**s)
            t = -float(rows[r] @ mean) * 2.0**s
            if np.abs(a).max() < MATRIX_BOUND and abs(t) < TRANSLATION_BOUND:
                matrix[r], translation[r], shift[r] = a, round(t), s
                break
    everything = Frame(matrix, translation, shift, np.full(3, -2 * UNIT), np.full(3, 2 * UNIT))
    places = positions[inlier] if len(positions) else np.zeros((1, 3), np.float16)
    w = contract(frame_coordinates(everything, position_integers(places)))
    low, high = w.min(axis=0), w.max(axis=0)
    high = np.maximum(high, low + 1)
    return replace(everything, low=low, high=high)
