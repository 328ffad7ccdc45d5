"""Spherical harmonics of splats: their values, their orthonormality, and the gradients of colours."""

from __future__ import annotations

import math

import numpy as np
import pytest

pytest.importorskip("torch")

import torch
from torch import Tensor

from refcodec.convert.harmonics import basis, colours
from refcodec.rendering.harmonics import REST, ZERO, degree_of


def test_known_values() -> None:
    """Along the axes most harmonics are 0 by symmetry. The others are those of tables of real spherical harmonics."""
    along = basis(torch.eye(3, dtype=torch.float64), 3).numpy()
    pi = math.pi
    one, two, two_zonal = math.sqrt(3 / (4 * pi)), math.sqrt(15 / (16 * pi)), math.sqrt(5 / (16 * pi))
    three, three_one, three_zonal = math.sqrt(35 / (32 * pi)), math.sqrt(21 / (32 * pi)), math.sqrt(7 / (16 * pi))
    x = {2: -one, 5: -two_zonal, 7: two, 12: three_one, 14: -three}
    y = {0: -one, 5: -two_zonal, 7: -two, 8: three, 10: three_one}
    z = {1: one, 5: 2 * two_zonal, 11: 2 * three_zonal}
    for row, values in zip(along, (x, y, z), strict=True):
        wanted = np.zeros(15)
        wanted[list(values)] = list(values.values())
        np.testing.assert_allclose(row, wanted, atol=1e-12)
    assert pytest.approx(1 / math.sqrt(4 * pi)) == ZERO


def test_they_are_orthonormal() -> None:
    """By a quadrature that is exact for these polynomials: Gauss's in the height, even steps around."""
    height, weight = np.polynomial.legendre.leggauss(8)
    turn = 2 * math.pi * np.arange(16) / 16
    flat = np.sqrt(1 - height**2)
    direction = [np.outer(flat, np.cos(turn)), np.outer(flat, np.sin(turn)), np.outer(height, np.ones(16))]
    values = basis(torch.from_numpy(np.stack([d.reshape(-1) for d in direction], axis=1)), 3).numpy()
    area = np.repeat(weight, 16) * 2 * math.pi / 16
    np.testing.assert_allclose(values.T @ (values * area[:, None]), np.eye(15), atol=1e-12)
    np.testing.assert_allclose(area @ values, np.zeros(15), atol=1e-12)


@pytest.mark.parametrize("degree", range(4))
def test_gradients_of_colours(degree: int) -> None:
    """By the coefficients and by the means, against finite differences."""
    centre, random = torch.tensor([5.0, -4.0, 6.0], dtype=torch.float64), torch.Generator().manual_seed(degree)
    shapes = ((10, 3), (10, REST[degree], 3), (10, 3))
    # Far from the cut at 0, where the colour has no derivative.
    inputs = [torch.randn(s, generator=random, dtype=torch.float64).mul_(0.3).requires_grad_() for s in shapes]
    assert degree_of(REST[degree]) == degree

    def found(base: Tensor, rest: Tensor, mean: Tensor) -> Tensor:
        return colours(base + 20, rest, mean, centre, degree)

    assert torch.autograd.gradcheck(found, inputs)


def test_a_colour_is_not_negative() -> None:
    base = torch.tensor([[-10.0, 0.0, 1.0]])
    found = colours(base, torch.zeros(1, 0, 3), torch.zeros(1, 3), torch.ones(3), 0)
    assert found[0].tolist() == pytest.approx([0, 0.5, 0.5 + ZERO])


def test_other_numbers_of_harmonics_are_refused() -> None:
    with pytest.raises(ValueError, match="4 harmonics"):
        degree_of(4)
