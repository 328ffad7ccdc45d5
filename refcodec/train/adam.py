"""Adam on some rows of a table (Kingma and Ba 2015): a step of training changes only the anchors that it sees.

adam_rows and share_rows are compiled for CPUs. adam_anywhere, joined and added do the same with torch on any device.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from numba import prange
from numpy.typing import NDArray
from torch import Tensor

from ..render.compiled import compiled

F32 = NDArray[np.float32]
I64 = NDArray[np.int64]

# 3DGS's constants. They are compiled, so they are no settings.
ADAM_EPSILON = 1e-15
BETA_1, BETA_2, EPSILON = np.float32(0.9), np.float32(0.999), np.float32(ADAM_EPSILON)
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


def joined(rows: Sequence[Tensor]) -> tuple[Tensor, Tensor]:
    """The union of sets of anchors, each int64 [n]: int64 [M], ascending, and the place of each given row in it."""
    union, place = torch.unique(torch.cat(list(rows)), return_inverse=True)
    return union, place


def added(place: Tensor, gradients: Sequence[Tensor], count: int) -> Tensor:
    """The sums of gradients [n, D] of the same anchors, float32 [count, D]. place: that of each row, of `joined`."""
    every = torch.cat(list(gradients))
    return torch.zeros(count, every.shape[1], device=every.device).index_add_(0, place, every)


def adam_anywhere(
    table: Tensor, first: Tensor, second: Tensor, steps: int, rows: Tensor, gradient: Tensor, rate: float
) -> None:
    """What adam_rows does, on the device of the tensors."""
    m = first[rows].mul_(float(BETA_1)).add_(gradient, alpha=float(_REST_1))
    v = second[rows].mul_(float(BETA_2)).addcmul_(gradient, gradient, value=float(_REST_2))
    first[rows], second[rows] = m, v
    away = (m / (1 - 0.9**steps)) / ((v / (1 - 0.999**steps)).sqrt_() + ADAM_EPSILON)
    table[rows] -= rate * away
