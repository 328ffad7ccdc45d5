"""Plain 3D Gaussians with spherical harmonics, as in 3DGS files."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .harmonics import degree_of

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Splats:
    """n plain 3D Gaussians, the same for all views. All arrays are float32, with the numbers of 3DGS PLY files.

    mean: [n, 3], world units.
    base: [n, 3], coefficients of the harmonic of degree 0: red, green and blue.
    rest: [n, K, 3], those of the other harmonics in the order of 3DGS, K is 0, 3, 8 or 15. The colour is 0.5 plus the
    sum of the harmonics of the direction from the camera to the mean, times their coefficients (SPEC 14.6).
    opacity: [n], logits: the opacity is 1 / (1 + exp(-logit)).
    scale: [n, 3], natural logarithms of the lengths of the axes, which are in world units.
    quaternion: [n, 4], w, x, y, z, of any length but 0. It turns the axes of the Gaussian to those of the world.
    """

    mean: F32
    base: F32
    rest: F32
    opacity: F32
    scale: F32
    quaternion: F32

    @property
    def degree(self) -> int:
        """The degree of the harmonics. Raises ValueError if their number fits no degree."""
        return degree_of(self.rest.shape[1])

    @property
    def coefficients(self) -> F32:
        """The coefficients of all harmonics, [n, 1 + K, 3]."""
        return np.concatenate([self.base[:, None], self.rest], axis=1)

    def unit_quaternions(self) -> F64:
        """Returns the quaternions with length 1, [n, 4]."""
        quaternion = self.quaternion.astype(np.float64)
        return quaternion / np.linalg.norm(quaternion, axis=1, keepdims=True)


def narrowed(**arrays: NDArray[Any]) -> Splats:
    """Returns Gaussians of arrays of any dtype. Numbers beyond float32 become infinite."""
    with np.errstate(over="ignore"):
        return Splats(**{name: values.astype(np.float32, copy=False) for name, values in arrays.items()})


def rows_of(splats: Splats, rows: NDArray[Any]) -> Splats:
    """Returns some of the Gaussians. rows: their numbers, or bool [n]."""
    return Splats(*(values[rows] for values in vars(splats).values()))
