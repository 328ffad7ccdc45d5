"""Curves of PSNR in dB against bytes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

# Bytes and PSNR of each rate, the smallest file first.
Curve = Sequence[tuple[float, float]]


def at_bytes(curve: Curve, size: float) -> float:
    """A curve's PSNR at a file's size, on lines through its points by the logarithm of bytes.

    Beyond its points the first or last line goes on. Raises ValueError for a curve of fewer than two points.
    """
    if len(curve) < 2:
        raise ValueError("one rate makes no curve")
    x, y = np.log2([cell[0] for cell in curve]), np.array([cell[1] for cell in curve])
    k = int(np.clip(np.searchsorted(x, np.log2(size)) - 1, 0, len(x) - 2))
    return float(y[k] + (y[k + 1] - y[k]) * (np.log2(size) - x[k]) / (x[k + 1] - x[k]))
