"""Adam on some rows of a table: the kernels of adam.adam_torch and adam.added."""

import numpy as np
from numba import prange
from numpy.typing import NDArray

from ...rendering.compiled import compiled
from ..adam import ADAM_EPSILON
from ..adam import BETA_1 as _BETA_1
from ..adam import BETA_2 as _BETA_2

F32 = NDArray[np.float32]
I64 = NDArray[np.int64]

BETA_1, BETA_2, EPSILON = np.float32(_BETA_1), np.float32(_BETA_2), np.float32(ADAM_EPSILON)
_REST_1, _REST_2 = np.float32(1) - BETA_1, np.float32(1) - BETA_2


@compiled()
def share_rows(rows: I64, gradient: F32, place: I64, to: F32) -> I64:
    """Adds gradients [n, D] of the anchors `rows` [n] to the rows of to [m, D] that `place` [N] gives them.

    place is -1 where an anchor has no such row. Returns which of the n are of such anchors, ascending.
    """
    apart = np.empty(rows.shape[0], np.int64)
    count = 0
    for r in range(rows.shape[0]):
        at = place[rows[r]]
        if at < 0:
            apart[count] = r
            count += 1
        else:
            for c in range(to.shape[1]):
                to[at, c] += gradient[r, c]
    return apart[:count]


@compiled(parallel=True)
def adam_rows(
    table: F32, first: F32, second: F32, steps: int, rows: I64, gradient: F32, learning_rate: np.float32
) -> None:
    """One step of Adam on table[rows].

    first, second: its moments, shaped like the table. steps: of training, from 1, for the correction of the moments'
    bias. rows: int64 [n], each at most once. gradient [n, D].

    The definition is adam.adam_torch.
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
            table[i, c] -= learning_rate * (m * by_first) / (np.sqrt(v * by_second) + EPSILON)
