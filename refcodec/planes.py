"""Planes (SPEC.md 7.3): SARM and the five substreams in wavefront order."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .entropy import Coder
from .networks import IntNetwork, activation
from .tables import tables

# SPEC 7.3: one plane of r = 1 and four quadrants of r = 2.
PLANES = 5
# SPEC 6.9: a plane symbol is an i16, -32768 excluded.
PLANE_SYMBOL_MAX = (1 << 15) - 1
PLANE_NAMES = ("r1", "r2.top_left", "r2.top_right", "r2.bottom_left", "r2.bottom_right")


def wavefront(t: int, size: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """SPEC 7.3: rows and columns (i, j) with j + 2 i = t, rows ascending."""
    i = np.arange(max(0, (t - size + 2) // 2), min(size - 1, t // 2) + 1)
    return i, t - 2 * i


def code_planes(coder: Coder, sarm: IntNetwork, channels: int, size: int, given: NDArray[np.int16] | None = None) -> NDArray[np.int16]:
    """Codes the five planes, int16 [5, ch, B, B], in either direction (SPEC 7.3)."""
    # A border of zeros above, left and right is the padding.
    padded = np.zeros((PLANES, channels, size + 1, size + 2), dtype=np.int64)
    flat = padded.reshape(-1)
    width = size + 2
    block = np.arange(PLANES * channels)[:, None] * ((size + 1) * width)
    for t in range(3 * size - 2):
        i, j = wavefront(t, size)
        at = (block + ((i + 1) * width + j + 1)).reshape(-1)
        # SPEC 7.3: the context is (i-1, j-1), (i-1, j), (i-1, j+1), (i, j-1).
        near = np.stack([flat[at - width - 1], flat[at - width], flat[at - width + 1], flat[at - 1]], axis=1)
        parameters = sarm(activation(near)).astype(np.int64)
        known = None if given is None else given[:, :, i, j].reshape(-1).astype(np.int64)

        def name(plane: int, index: int, i: list[int] = i.tolist(), j: list[int] = j.tolist()) -> str:  # noqa: B008
            channel, row = divmod(index, len(i))
            return f"planes.{PLANE_NAMES[plane]}[{channel},{i[row]},{j[row]}]"

        counts = [channels * len(i)] * PLANES
        flat[at] = coder.values(tables().laplace, parameters[:, 0], parameters[:, 1], counts, PLANE_SYMBOL_MAX, name, known)
    return padded[:, :, 1:, 1:-1].astype(np.int16)
