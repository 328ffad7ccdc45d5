"""SPEC.md 14.6, HARMONICS, in training."""

import torch
from torch import Tensor
from torch.nn import functional

from ..formats.harmonics import ZERO, degree_of, rest_harmonics


def harmonics_torch(away: Tensor, count: int) -> Tensor:
    """The first `count` harmonics for directions [n, 3] of any length: [n, count]."""
    direction = functional.normalize(away, dim=1).T
    return torch.stack([torch.full_like(direction[0], ZERO), *rest_harmonics(direction, degree_of(count - 1))], dim=1)
