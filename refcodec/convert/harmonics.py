"""Differentiable colours of the harmonics of refcodec.render.harmonics."""

from __future__ import annotations

import torch
from torch import Tensor

from ..render.harmonics import ZERO, rest_harmonics


def basis(direction: Tensor, degree: int) -> Tensor:
    """Returns the harmonics of degree 1 to `degree` in unit directions [N, 3]: [N, (degree + 1)^2 - 1]."""
    functions = rest_harmonics(direction.unbind(dim=1), degree)
    return torch.stack(functions, dim=1) if functions else direction[:, :0]


def colours(base: Tensor, rest: Tensor, mean: Tensor, centre: Tensor, degree: int) -> Tensor:
    """Returns the colours [N, 3], at least 0, of Gaussians at `mean` [N, 3] for a camera at `centre` [3].

    base: coefficients of degree 0, [N, 3]. rest: those of the other harmonics, [N, K, 3]. degree: the highest
    degree to use, at most that of rest. The colour is 0.5 plus the sum of the harmonics.
    """
    total = ZERO * base + 0.5
    if degree:
        away = mean - centre
        harmonics = basis(away / away.norm(dim=1, keepdim=True).clamp_min(1e-12), degree)
        total = total + (harmonics[:, :, None] * rest[:, : harmonics.shape[1]]).sum(dim=1)
    return total.clamp_min(0)
