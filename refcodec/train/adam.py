"""Adam on some rows of a table (Kingma and Ba 2015): a step of training sees a part of the anchors, and changes only these."""

from __future__ import annotations

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

F32 = NDArray[np.float32]
I64 = NDArray[np.int64]

# 3DGS's constants.
BETA_1, BETA_2, EPSILON = np.float32(0.9), np.float32(0.999), np.float32(1e-15)
_REST_1, _REST_2 = np.float32(1) - BETA_1, np.float32(1) - BETA_2


@njit(cache=True, error_model="numpy")
def gather_rows(rows: I64, gradient: F32, total: F32, place: I64, found: I64, count: int) -> int:
    """Adds gradient [n, D] to the rows of total [M, D] that `place` [N] gives the anchors `rows` [n]; place is -1 where an anchor has none
    yet, and then gets the next row, which begins with this gradient. found [M]: the anchor of each row. Returns the rows used."""
    for r in range(rows.shape[0]):
        at = place[rows[r]]
        if at < 0:
            place[rows[r]], found[count] = count, rows[r]
            total[count] = gradient[r]
            count += 1
        else:
            total[at] += gradient[r]
    return count


@njit(cache=True, parallel=True, error_model="numpy")
def adam_rows(table: F32, first: F32, second: F32, steps: int, rows: I64, gradient: F32, rate: np.float32) -> None:
    """One step of Adam on table[rows]. first, second: its moments, shaped like the table; steps: of training, from 1, for the correction
    of the moments' bias. gradient [n, D]; rows: int64 [n], each at most once.

    As in 3DGS the correction knows of the training's steps alone: anchors that are new, or were rarely seen, move faster at first."""
    by_first = np.float32(1 / (1 - 0.9**steps))
    by_second = np.float32(1 / (1 - 0.999**steps))
    for r in prange(rows.shape[0]):
        i = rows[r]
        for c in range(table.shape[1]):
            g = gradient[r, c]
            m = BETA_1 * first[i, c] + _REST_1 * g
            v = BETA_2 * second[i, c] + _REST_2 * g * g
            first[i, c], second[i, c] = m, v
            table[i, c] -= rate * (m * by_first) / (np.sqrt(v * by_second) + EPSILON)
