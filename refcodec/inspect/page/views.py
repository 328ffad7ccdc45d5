"""Anchors as points of a picture: from three sides, and as a camera sees them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...bitstream.cameras import NamedCamera
from .pictures import Bytes2, coloured

F64 = NDArray[np.float64]

# Columns and rows of a picture, and the share of anchors that a side view leaves out at either end of an axis, so that
# a few far away do not make all others small.
SIDE = 440
OUTSIDE = 0.01


@dataclass(frozen=True)
class View:
    """Anchors in a picture. name: of the view. points: float64 [n, 2], columns and rows, 0 to SIDE. seen: bool [n]."""

    name: str
    points: F64
    seen: NDArray[np.bool_]


def _upright(up_axis: int) -> F64:
    """SPEC 5.5: returns the rotation to x right, y to the back and z up, float64 [3, 3]. up_axis: that of the file."""
    up = np.zeros(3)
    up[up_axis // 2] = 1 - 2 * (up_axis % 2)
    # The axis after the one that points up is to the right.
    right = np.zeros(3)
    right[(up_axis // 2 + 1) % 3] = 1
    return np.stack([right, np.cross(up, right), up])


def side_views(positions: F64, up_axis: int) -> list[View]:
    """Returns the anchors from above, from the front and from the side, all three in one scale.

    positions: float64 [n, 3], world units, at least one.
    """
    place = positions @ _upright(up_axis).T
    low, high = np.quantile(place, [OUTSIDE, 1 - OUTSIDE], axis=0)
    middle, reach = (low + high) / 2, max(float((high - low).max()) * 0.52, 1e-9)
    unit = (place - middle) / (2 * reach)
    found = []
    for name, across, down in (("from above", 0, 1), ("from the front", 0, 2), ("from the side", 1, 2)):
        points = np.stack([0.5 + unit[:, across], 0.5 - unit[:, down]], axis=1) * SIDE
        found.append(View(name, points, np.asarray(((points >= 0) & (points < SIDE)).all(axis=1))))
    return found


def projected(positions: F64, camera: NamedCamera, near: float) -> tuple[F64, NDArray[np.bool_]]:
    """SPEC 14.2: returns where a camera sees points, float64 [n, 2] pixels, and whether it does, bool [n].

    positions: float64 [n, 3], world units. near: depth in world units below which nothing is seen.
    """
    quaternion = np.array(camera.rotation)
    # It is scaled first, since squares of large numbers are infinite.
    quaternion /= np.abs(quaternion).max()
    w, x, y, z = quaternion / np.linalg.norm(quaternion)
    rotation = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        at = positions @ rotation.T + np.array(camera.translation)
        points = np.array(camera.focal) * at[:, :2] / at[:, 2:] + np.array(camera.principal_point)
        inside = (at[:, 2] > near) & (points >= 0).all(axis=1)
        inside &= (points[:, 0] < camera.width) & (points[:, 1] < camera.height)
    return np.where(inside[:, None], points, 0.0), np.asarray(inside)


def camera_view(positions: F64, camera: NamedCamera, near: float) -> View:
    """Returns the anchors as a camera sees them, in a square that holds its picture."""
    points, seen = projected(positions, camera, near)
    scale = SIDE / max(camera.width, camera.height)
    size = np.array([camera.width, camera.height]) * scale
    return View("from the camera of the default view", points * scale + (SIDE - size) / 2, seen)


def drawn(view: View, values: F64, low: float, high: float) -> Bytes2:
    """Returns a picture of a view, as indices of colours, uint8 [SIDE, SIDE].

    A pixel has the colour of the mean of the anchors on it. values: float64 [n]. low, high: the ends of the scale.
    """
    points = view.points[view.seen].astype(np.int64)
    each = values[view.seen]
    # Few points are drawn larger, so that they are seen.
    size = int(np.clip(round(2.2 * SIDE / max(len(points), 1) ** 0.5), 2, 7))
    total, count = np.zeros(SIDE * SIDE), np.zeros(SIDE * SIDE)
    for down in range(size):
        for across in range(size):
            place = points + np.array([across - size // 2, down - size // 2])
            fits = ((place >= 0) & (place < SIDE)).all(axis=1)
            at = place[fits, 1] * SIDE + place[fits, 0]
            total += np.bincount(at, each[fits], SIDE * SIDE)
            count += np.bincount(at, minlength=SIDE * SIDE)
    mean = total / np.maximum(count, 1)
    return np.where(count > 0, coloured(mean, low, high), 0).astype(np.uint8).reshape(SIDE, SIDE)
