"""Adam on some rows of a table (Kingma and Ba 2015): a step of training changes only the anchors that it sees."""

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

# 3DGS's constants, which the kernels have compiled in. They are not settings for that reason.
ADAM_EPSILON = 1e-15
BETA_1, BETA_2 = np.float32(0.9), np.float32(0.999)


def adam_torch(
    table: Tensor, first: Tensor, second: Tensor, steps: int, rows: Tensor, gradient: Tensor, learning_rate: float
) -> None:
    """One step of Adam on table[rows], in place.

    As in 3DGS, the bias correction counts the steps of the training, not those of a row. Anchors that are new, or were
    rarely seen, therefore move faster at first.

    Args:
        table: float32 [N, D].
        first, second: its moments, float32 [N, D], changed in place.
        steps: steps of the training, from 1, for the bias correction of the moments.
        rows: int64 [n], each at most once.
        gradient: float32 [n, D].
        learning_rate: a factor.
    """
    assert first.shape == second.shape == table.shape
    assert gradient.shape == (len(rows), table.shape[1])
    m = first[rows].mul_(float(BETA_1)).add_(gradient, alpha=float(np.float32(1) - BETA_1))
    v = second[rows].mul_(float(BETA_2)).addcmul_(gradient, gradient, value=float(np.float32(1) - BETA_2))
    first[rows], second[rows] = m, v
    away = (m / (1 - 0.9**steps)) / ((v / (1 - 0.999**steps)).sqrt_() + ADAM_EPSILON)
    table[rows] -= learning_rate * away


def joined(rows: Sequence[Tensor]) -> tuple[Tensor, Tensor]:
    """The union of sets of anchors, each int64 [n]: int64 [M], ascending, and the place of each given row in it."""
    union, place = torch.unique(torch.cat(list(rows)), return_inverse=True)
    return union, place


def added(place: Tensor, gradients: Sequence[Tensor], count: int) -> Tensor:
    """The sums of gradients [n, D] of the same anchors, float32 [count, D]. place: that of each row, of `joined`."""
    every = torch.cat(list(gradients))
    return torch.zeros(count, every.shape[1], device=every.device).index_add_(0, place, every)
