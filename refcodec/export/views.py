"""The views that Gaussians are fitted to, and those that the fit is measured in."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..bitstream.cameras import NamedCamera
from ..render.camera import Camera, poses
from ..render.view import DISTANCE, View, own_camera, spiral

# The longest side in pixels of a view. Blending weights need no more, and the work grows with the pixels.
SIDE = 400
# A file with fewer cameras than these says too little of where people look from.
FEW = 8
# The views around the scene where there are too few cameras. Every ninth one measures the fit, from the middle one of
# the first nine on. The outermost ones are for the fit.
AROUND, AROUND_TEST_EVERY = 72, 9
# The sines of the lowest and the highest elevation of these views.
LOWEST, HIGHEST = -0.1, 0.95
# Their distance from the middle is that of the file's own camera, within these multiples of the scene's radius.
NEAREST, FARTHEST = 1.2, 3.0


@dataclass(frozen=True)
class Views:
    """The cameras of a fit. fit: those that it sees. test: those that measure it. source: where they are from."""

    fit: list[Camera]
    test: list[Camera]
    source: str


def sized(camera: Camera) -> Camera:
    """Returns the camera with an image whose longest side is at most SIDE."""
    longer = max(camera.width, camera.height)
    if longer <= SIDE:
        return camera
    return camera.resized(max(camera.width * SIDE // longer, 1), max(camera.height * SIDE // longer, 1))


def views_of(view: View, stated: Sequence[NamedCamera]) -> Views:
    """Returns the views of a scene without photographs.

    stated: the cameras of the file. They are the views of the fit if there are FEW or more: the networks of a scene are
    right near the cameras that it was trained from. Views between them measure it. Otherwise views are spread over the
    upper part of a sphere around the scene, and the stated ones go with them.
    """
    own = [sized(own_camera(camera)) for camera in stated]
    if len(own) >= FEW:
        return Views(own, _between(own), f"{len(own)} cameras of the file")
    # Without a camera, the distance is that of the orbit.
    middle, radius = view.extent
    distance = DISTANCE * radius
    if stated:
        away = math.dist(own_camera(view.camera).centre, middle)
        distance = min(max(away, NEAREST * radius), FARTHEST * radius)
    spread = _around(view, distance)
    test = spread[AROUND_TEST_EVERY // 2 :: AROUND_TEST_EVERY]
    fit = [camera for camera in spread if camera not in test]
    return Views(own + fit, test, f"{len(fit)} cameras around the scene")


def _between(cameras: Sequence[Camera]) -> list[Camera]:
    """Returns a camera half way between each camera and the one that is nearest to it, once for each pair."""
    from scipy.spatial.transform import Rotation, Slerp  # noqa: PLC0415 (only here)

    seen = poses(cameras)
    apart = np.linalg.norm(seen[:, None] - seen, axis=2)
    np.fill_diagonal(apart, np.inf)
    found = []
    for one, other in sorted({(min(i, j), max(i, j)) for i, j in enumerate(apart.argmin(axis=1).tolist())}):
        ends = cameras[one], cameras[other]
        turn = Slerp([0, 1], Rotation.from_matrix([camera.rotation for camera in ends]))
        rotation, centre = turn(0.5).as_matrix(), (ends[0].centre + ends[1].centre) / 2
        name = f"between-{one:04d}-{other:04d}"
        found.append(replace(ends[0], name=name, rotation=rotation, translation=-rotation @ centre))
    return found


def _around(view: View, distance: float) -> list[Camera]:
    """Returns cameras on a spiral that is spread evenly over a part of a sphere. distance: its radius, world units."""
    return [
        sized(view.around(f"around-{number:04d}", math.asin(height), turn, distance))
        for number, (height, turn) in enumerate(zip(*spiral(AROUND, LOWEST, HIGHEST), strict=True))
    ]
