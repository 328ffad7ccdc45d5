"""Differentiable colours of the harmonics of refcodec.rendering.harmonics."""

from __future__ import annotations

from torch import Tensor

from ..rendering.harmonics import ZERO
from ..train.harmonics import harmonics_torch


def basis(direction: Tensor, degree: int) -> Tensor:
    """Returns the harmonics of degree 1 to `degree` in directions [N, 3], not 0: [N, (degree + 1)^2 - 1]."""
    return harmonics_torch(direction, (degree + 1) ** 2)[:, 1:]


def colours(base: Tensor, rest: Tensor, mean: Tensor, centre: Tensor, degree: int) -> Tensor:
    """Returns the colours [N, 3], at least 0, of Gaussians at `mean` [N, 3] for a camera at `centre` [3].

    base: coefficients of degree 0, [N, 3]. rest: those of the other harmonics, [N, K, 3]. degree: the highest
    degree to use, at most that of rest. The colour is 0.5 plus the sum of the harmonics.
    """
    total = ZERO * base + 0.5
    if degree:
        harmonics = basis(mean - centre, degree)
        total = total + (harmonics[:, :, None] * rest[:, : harmonics.shape[1]]).sum(dim=1)
    return total.clamp_min(0)
