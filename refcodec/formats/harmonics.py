"""Real spherical harmonics of degree 0 to 3, with the signs and the order of 3DGS files.

The basis is orthonormal on the sphere. Its constants follow from the definition: N(l, m) is the square root of
(2 l + 1) (l - m)! / (4 pi (l + m)!), times the square root of 2 where m is not 0, times (-1)^m (Condon and Shortley).
"""

import math
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

DEGREE_MAX = 3
# Harmonics beside that of degree 0, by degree.
REST = tuple((degree + 1) ** 2 - 1 for degree in range(DEGREE_MAX + 1))


def _constant(degree: int, order: int) -> float:
    """Returns N(l, m), see above."""
    share = math.factorial(degree - order) / math.factorial(degree + order)
    plain = math.sqrt((2 * degree + 1) / (4 * math.pi) * share)
    return (-1) ** order * plain * (math.sqrt(2) if order else 1)


ZERO = _constant(0, 0)
# Each polynomial below is the harmonic divided by its constant, which includes the Legendre factors (3, 15, 1/2, 3/2).
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
    """Returns the degree with `rest` harmonics besides the first. Raises ValueError if there is none."""
    if rest not in REST:
        raise ValueError(f"{rest} harmonics besides the first; {', '.join(map(str, REST))} are allowed")
    return REST.index(rest)


def rest_harmonics(direction: Iterable[Any], degree: int) -> list[Any]:
    """Returns the harmonics of degree 1 to `degree` in the order of the files: (degree + 1)^2 - 1 values.

    direction: x, y and z of unit vectors, as NumPy arrays or torch tensors of one shape, which is that of the values.
    """
    x, y, z = direction
    values: list[Any] = []
    if degree > 0:
        values += [c * p for c, p in zip(_ONE, (y, z, x), strict=True)]
    if degree > 1:
        xx, yy, zz = x * x, y * y, z * z
        values += [c * p for c, p in zip(_TWO, (x * y, y * z, 2 * zz - xx - yy, x * z, xx - yy), strict=True)]
    if degree > 2:
        ring = 4 * zz - xx - yy
        inner = (y * (3 * xx - yy), x * y * z, y * ring, z * (2 * zz - 3 * xx - 3 * yy), x * ring, z * (xx - yy))
        values += [c * p for c, p in zip(_THREE, (*inner, x * (xx - 3 * yy)), strict=True)]
    return values


def turned_harmonics(rest: NDArray[np.float32], matrix: NDArray[np.float64]) -> NDArray[np.float32]:
    """Returns coefficients of degree 1 and more, [n, K, 3], of the same colours after an orthogonal map of the world.

    matrix: the map, [3, 3]. Mirrors are allowed. Exact for maps that only negate axes.
    """
    # More directions than harmonics, in no special position.
    direction = np.random.default_rng(0).normal(size=(64, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    degree = degree_of(rest.shape[1])
    after, before = (np.array(rest_harmonics(seen.T, degree)).T for seen in (direction, direction @ matrix))
    change = np.linalg.lstsq(after, before)[0] if degree else np.zeros((0, 0))
    return np.matmul(snapped(change).astype(np.float32), rest)


def snapped(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns numbers of which those that are nearly integers are exactly so."""
    whole = np.rint(values)
    return np.where(np.abs(values - whole) < 1e-9, whole, values)


# SPEC 14.6
def harmonics(mean: NDArray[np.float32], centre: NDArray[np.float64], degree: int) -> NDArray[np.float64]:
    """SPEC 14.6, HARMONICS: returns all harmonics for the directions from a place to Gaussians, [n, (degree + 1)^2].

    mean: [n, 3]. centre: the place, [3]. The direction to the place itself is zero.
    """
    away = mean.astype(np.float64) - centre
    distance = np.linalg.norm(away, axis=1, keepdims=True)
    direction = np.divide(away, distance, out=np.zeros_like(away), where=distance > 0)
    return np.stack([np.full(len(away), ZERO), *rest_harmonics(direction.T, degree)], axis=1)
