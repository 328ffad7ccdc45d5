"""Anchors as points of a picture: along three axes, and in the image of a camera."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...bitstream.cameras import NamedCamera
from ...bitstream.frame import Frame
from .pictures import coloured, png

F64 = NDArray[np.float64]

# Columns and rows of a picture, and the share of anchors that a side view leaves out at either end of an axis, because
# a few distant ones would make the others small.
SIDE = 440
OUTSIDE = 0.005
# Empty rows that a picture has above and below.
_MARGIN = 12


@dataclass(frozen=True)
class View:
    """Anchors in a picture. name: of the view. points: float64 [n, 2], columns and rows, 0 to SIDE. seen: bool [n]."""

    name: str
    points: F64
    seen: NDArray[np.bool_]


def _axes(frame: Frame | None) -> F64:
    """SPEC 7.5.1: returns the principal axes of the file, or those of the world without a frame, float64 [3, 3]."""
    if frame is None:
        return np.eye(3)
    # A row of zeros is allowed and remains.
    rows = frame.matrix.astype(np.float64)
    return np.asarray(rows / np.maximum(np.linalg.norm(rows, axis=1, keepdims=True), 1.0))


def side_views(positions: F64, frame: Frame | None) -> list[View]:
    """Returns the anchors along each of the principal axes, all three in one scale.

    The first one lies as the planes do: columns along the first axis, rows along the second.

    positions: float64 [n, 3], world units, at least one. frame: that of the file.
    """
    place = positions @ _axes(frame).T
    low, high = np.quantile(place, [OUTSIDE, 1 - OUTSIDE], axis=0)
    middle, reach = (low + high) / 2, max(float((high - low).max()) * 0.52, 1e-9)
    unit = (place - middle) / (2 * reach)
    kind = "axis of the world" if frame is None else "principal axis"
    found = []
    for name, across, down in (("third", 0, 1), ("second", 0, 2), ("first", 1, 2)):
        points = np.stack([0.5 + unit[:, across], 0.5 + unit[:, down]], axis=1) * SIDE
        seen = np.asarray(((points >= 0) & (points < SIDE)).all(axis=1))
        found.append(View(f"along the {name} {kind}", points, seen))
    return found


def projected(positions: F64, camera: NamedCamera, near: float) -> tuple[F64, NDArray[np.bool_]]:
    """SPEC 14.2: returns the image points, float64 [n, 2] pixels, and their visibility, bool [n].

    positions: float64 [n, 3], world units. near: depth of the near plane, world units.
    """
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        at = positions @ camera.matrix().T + np.array(camera.translation)
        points = np.array(camera.focal) * at[:, :2] / at[:, 2:] + np.array(camera.principal_point)
        inside = (at[:, 2] > near) & (points >= 0).all(axis=1)
        inside &= (points[:, 0] < camera.width) & (points[:, 1] < camera.height)
    return np.where(inside[:, None], points, 0.0), np.asarray(inside)


def camera_view(positions: F64, camera: NamedCamera, near: float) -> View:
    """Returns the anchors in the image of a camera, scaled to fit a square."""
    points, seen = projected(positions, camera, near)
    scale = SIDE / max(camera.width, camera.height)
    size = np.array([camera.width, camera.height]) * scale
    return View("from the camera of the default view", points * scale + (SIDE - size) / 2, seen)


def drawn(view: View, values: F64, low: float, high: float) -> bytes:
    """Returns a view as PNG, SIDE pixels wide, without the empty rows above and below.

    A pixel has the colour of the mean of the anchors on it. values: float64 [n]. low, high: the ends of the scale.
    """
    points = view.points[view.seen].astype(np.int64)
    each = values[view.seen]
    # Few points are drawn larger, for visibility.
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
    pixels = np.where(count > 0, coloured(mean, low, high), 0).astype(np.uint8).reshape(SIDE, SIDE)
    used = np.flatnonzero(pixels.any(axis=1))
    first, last = (int(used[0]), int(used[-1])) if len(used) else (0, 0)
    return png(pixels[max(0, first - _MARGIN) : last + _MARGIN + 1])
