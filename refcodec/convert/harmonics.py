"""Colours from real spherical harmonics of degree 0 to 3, with the signs and the order that 3DGS's files have.

The basis is orthonormal on the sphere. Its constants are made from the definition: N(l, m) is the square root of
(2 l + 1) (l - m)! / (4 pi (l + m)!), times the square root of 2 where m is not 0, times (-1)^m (Condon and Shortley).
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from .splat_arrays import RESTS, ZERO


def _constant(degree: int, order: int) -> float:
    """N(l, m) of the module's text."""
    share = math.factorial(degree - order) / math.factorial(degree + order)
    plain = math.sqrt((2 * degree + 1) / (4 * math.pi) * share)
    return (-1) ** order * plain * (math.sqrt(2) if order else 1)


# Each polynomial below is the harmonic over its constant; Legendre's factors (3, 15, 1/2, 3/2) stand in the constant.
_ONE = (_constant(1, 1), _constant(1, 0), _constant(1, 1))
_TWO = (2 * 3 * _constant(2, 2), 3 * _constant(2, 1), _constant(2, 0) / 2, 3 * _constant(2, 1), 3 * _constant(2, 2))
_THREE = (
    15 * _constant(3, 3),
    15 * 2 * _constant(3, 2),
    1.5 * _constant(3, 1),
    _constant(3, 0) / 2,
    1.5 * _constant(3, 1),
    15 * _constant(3, 2),
    15 * _constant(3, 3),
)


def degree_of(rest: int) -> int:
    """The degree that has `rest` harmonics beside the first. Raises ValueError if none has."""
    if rest not in RESTS:
        raise ValueError(f"{rest} harmonics beside the first; {', '.join(map(str, RESTS))} are wanted")
    return RESTS.index(rest)


def basis(direction: Tensor, degree: int) -> Tensor:
    """The harmonics of degree 1 to `degree` in unit directions [N, 3]: [N, (degree + 1)^2 - 1]."""
    x, y, z = direction.unbind(dim=1)
    found: list[Tensor] = []
    if degree > 0:
        found += [c * p for c, p in zip(_ONE, (y, z, x), strict=True)]
    if degree > 1:
        xx, yy, zz = x * x, y * y, z * z
        found += [c * p for c, p in zip(_TWO, (x * y, y * z, 2 * zz - xx - yy, x * z, xx - yy), strict=True)]
    if degree > 2:
        ring = 4 * zz - xx - yy
        inner = (y * (3 * xx - yy), x * y * z, y * ring, z * (2 * zz - 3 * xx - 3 * yy), x * ring, z * (xx - yy))
        found += [c * p for c, p in zip(_THREE, (*inner, x * (xx - 3 * yy)), strict=True)]
    return torch.stack(found, dim=1) if found else direction[:, :0]


def colours(base: Tensor, rest: Tensor, mean: Tensor, centre: Tensor, degree: int) -> Tensor:
    """What a camera at `centre` [3] sees of Gaussians at `mean` [N, 3]: colours [N, 3], none below 0.

    base: coefficients of degree 0, [N, 3]. rest: those of the other harmonics, [N, K, 3]. degree: the highest that is
    used, at most that of rest. The colour is 0.5 plus the sum of the harmonics.
    """
    found = ZERO * base + 0.5
    if degree:
        away = mean - centre
        harmonics = basis(away / away.norm(dim=1, keepdim=True).clamp_min(1e-12), degree)
        found = found + (harmonics[:, :, None] * rest[:, : harmonics.shape[1]]).sum(dim=1)
    return found.clamp_min(0)
