"""Which anchors a camera may see: the kernel of visible.visible_torch."""

import math
from typing import Any

import numpy as np
from numba import prange
from numpy.typing import NDArray

from ...rendering.compiled import compiled

F32 = NDArray[np.float32]


@compiled(parallel=True)
def visible_rows(
    position: F32, offsets: F32, scalings: F32, length: np.float32, view: F32, near: np.float32, sides: F32, bounds: Any
) -> NDArray[np.bool_]:
    """bool [N]. view: [3, 4], of rotation and translation. length: the logarithm of a training unit's.

    sides: [2, 3], see visible._sides. bounds: visible.REACH and visible.EXTENT.
    """
    factor, extent = bounds
    seen = np.empty(position.shape[0], np.bool_)
    for r in prange(position.shape[0]):
        square = np.float32(0)
        for j in range(3):
            most = np.float32(0)
            for at in range(j, offsets.shape[1], 3):
                most = max(most, abs(offsets[r, at]))
            most *= math.exp(scalings[r, j] - length)
            square += most * most
        longest = math.exp(max(scalings[r, 3], scalings[r, 4], scalings[r, 5]) - length)
        reach = factor * (math.sqrt(square) + extent * longest)
        x, y, z = position[r, 0], position[r, 1], position[r, 2]
        depth = view[2, 0] * x + view[2, 1] * y + view[2, 2] * z + view[2, 3]
        inside = depth > near - reach
        for axis in range(2):
            across = view[axis, 0] * x + view[axis, 1] * y + view[axis, 2] * z + view[axis, 3]
            away = abs(across - sides[axis, 0] * depth) - sides[axis, 1] * depth
            inside &= away < reach * sides[axis, 2]
        seen[r] = inside
    return seen
