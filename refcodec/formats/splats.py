"""Plain 3D Gaussians with spherical harmonics, as in 3DGS files."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .harmonics import degree_of, snapped, turned_harmonics

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


def moved(splats: Splats, matrix: F64, offset: F64) -> Splats:
    """Returns Gaussians after a map of the world, x to matrix x + offset, with means of float64 if the offset is not 0.

    matrix: [3, 3], a scale other than 0 times an orthogonal matrix. offset: [3]. The bits of what does not change stay.
    """
    scale = float(snapped(np.cbrt(np.abs(np.linalg.det(matrix)))))
    turn = snapped(matrix / scale)
    if scale == 1 and not offset.any() and (turn == np.eye(3)).all():
        return splats
    with np.errstate(all="ignore"):
        if (turn != np.eye(3)).any():
            # A Gaussian is the same as its mirror image in its mean, so that a mirror turns it as its negative does.
            w, x, y, z = quaternion_of(turn * np.linalg.det(turn))
            product = np.array([[w, -x, -y, -z], [x, w, -z, y], [y, z, w, -x], [z, -y, x, w]])
            quaternion = (splats.unit_quaternions() @ product.T).astype(np.float32)
            splats = replace(splats, quaternion=quaternion, rest=turned_harmonics(splats.rest, turn))
        mean = splats.mean.astype(np.float64) @ (turn * scale).T + offset
        parts: dict[str, NDArray[Any]] = {"mean": mean if offset.any() else mean.astype(np.float32)}
        return replace(splats, scale=splats.scale + np.float32(np.log(scale)), **parts)


def quaternion_of(turn: F64) -> F64:
    """Returns the unit quaternion w, x, y, z of a rotation matrix, [3, 3]."""
    # The products of its components, times four, are sums of the entries of the matrix.
    (a, b, c), (d, e, f), (g, h, i) = turn.tolist()
    rows = [[1 + a + e + i, h - f, c - g, d - b], [h - f, 1 + a - e - i, b + d, c + g]]
    rows += [[c - g, b + d, 1 - a + e - i, f + h], [d - b, c + g, f + h, 1 - a - e + i]]
    row = np.array(rows[int(np.argmax(np.diag(rows)))])
    return row / np.linalg.norm(row)


def joined(parts: Sequence[Splats]) -> Splats:
    """Returns the Gaussians of all parts. Harmonics that a part lacks are 0."""
    most = max(part.rest.shape[1] for part in parts)
    rest = [np.pad(part.rest, ((0, 0), (0, most - part.rest.shape[1]), (0, 0))) for part in parts]
    columns = zip(*(vars(replace(part, rest=own)).values() for part, own in zip(parts, rest, strict=True)), strict=True)
    return parts[0] if len(parts) == 1 else Splats(*map(np.concatenate, columns))


def rows_of(splats: Splats, rows: NDArray[Any]) -> Splats:
    """Returns some of the Gaussians. rows: their numbers, or bool [n]."""
    return Splats(*(values[rows] for values in vars(splats).values()))
