"""Adam on some rows of a table (Kingma and Ba 2015): a step of training changes only the anchors that it sees."""

from __future__ import annotations

import numpy as np
from numba import prange
from numpy.typing import NDArray

from ..render.compiled import compiled

F32 = NDArray[np.float32]
I64 = NDArray[np.int64]

# 3DGS's constants. They are compiled, so they are no settings.
ADAM_EPSILON = 1e-15
BETA_1, BETA_2, EPSILON = np.float32(0.9), np.float32(0.999), np.float32(ADAM_EPSILON)
_REST_1, _REST_2 = np.float32(1) - BETA_1, np.float32(1) - BETA_2


@compiled()
def gather_rows(rows: I64, gradient: F32, total: F32, place: I64, found: I64, count: int) -> int:
    """Adds gradients [n, D] of the anchors `rows` [n] to the rows of total [M, D] that `place` [N] gives them.

    place is -1 where an anchor has no row yet. Such an anchor gets the next row, which begins with its gradient. found
    [M]: the anchor of each row. count: rows used so far. Returns the rows used now.
    """
    for r in range(rows.shape[0]):
        at = place[rows[r]]
        if at < 0:
            place[rows[r]], found[count] = count, rows[r]
            total[count] = gradient[r]
            count += 1
        else:
            total[at] += gradient[r]
    return count


@compiled(parallel=True)
def adam_rows(table: F32, first: F32, second: F32, steps: int, rows: I64, gradient: F32, rate: np.float32) -> None:
    """One step of Adam on table[rows].

    first, second: its moments, shaped like the table. steps: of training, from 1, for the correction of the moments'
    bias. rows: int64 [n], each at most once. gradient [n, D].

    As in 3DGS the correction knows of the training's steps alone. So anchors that are new, or were rarely seen, move
    faster at first.
    """
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
