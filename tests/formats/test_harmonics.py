"""Spherical harmonics of splats: their values, their orthonormality, and the gradients of colours."""

import math

import numpy as np
import pytest

from refcodec.formats.harmonics import REST, ZERO, degree_of, harmonics, rest_harmonics


def test_known_values() -> None:
    """Along the axes most harmonics are 0 by symmetry. The others are those of tables of real spherical harmonics."""
    along = np.array(rest_harmonics(np.eye(3), 3)).T
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
    mean = np.stack([d.reshape(-1) for d in direction], axis=1)
    values = harmonics(5 * mean.astype(np.float64), np.zeros(3), 3)
    area = np.repeat(weight, 16) * 2 * math.pi / 16
    np.testing.assert_allclose(values.T @ (values * area[:, None]), np.eye(16), atol=1e-12)


@pytest.mark.parametrize("degree", range(4))
def test_colours_and_their_gradients(degree: int) -> None:
    """The colours of training are the sum of the harmonics, at least 0. Their gradients are finite differences."""
    torch = pytest.importorskip("torch")
    pytest.importorskip("numba")
    from refcodec.convert.drawing import colours  # noqa: PLC0415 (torch)

    centre, random = torch.tensor([5.0, -4.0, 6.0], dtype=torch.float64), torch.Generator().manual_seed(degree)
    shapes = ((10, 3), (10, REST[degree], 3), (10, 3))
    # Far from the cut at 0, where the colour has no derivative.
    inputs = [torch.randn(s, generator=random, dtype=torch.float64).mul_(0.3).requires_grad_() for s in shapes]
    assert torch.autograd.gradcheck(lambda base, *others: colours(base + 20, *others, centre, degree), inputs)
    base, rest, mean = (value.detach().numpy() for value in inputs)
    basis = harmonics(mean, centre.numpy(), degree)
    wanted = 0.5 + np.einsum("nk,nkc->nc", basis, np.concatenate([base[:, None], rest], axis=1))
    restored = colours(*inputs, centre, degree).detach().numpy()
    np.testing.assert_allclose(restored, np.maximum(wanted, 0), atol=1e-12)
    assert (restored == 0).any() == (wanted < 0).any()


def test_other_numbers_of_harmonics_are_refused() -> None:
    with pytest.raises(ValueError, match="4 harmonics"):
        degree_of(4)
