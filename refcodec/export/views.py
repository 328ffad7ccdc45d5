"""The views of a fit, and those that measure it."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..bitstream.cameras import NamedCamera
from ..rendering.camera import Camera, poses
from ..rendering.view import DISTANCE, View, own_camera, spiral

# The longest side of a view in pixels. It suffices for blending weights, and the work grows with the pixels.
SIDE = 400
# Fewer cameras than these do not show from where a scene is viewed.
FEW = 8
# The views around the scene if there are too few cameras. Every ninth view measures the fit, beginning in the middle
# of the first nine, so that the outermost views are for the fit.
AROUND, AROUND_TEST_EVERY = 72, 9
# The sines of the lowest and the highest elevation of these views.
LOWEST, HIGHEST = -0.1, 0.95
# Their distance from the middle is that of the default camera, within these multiples of the scene radius.
NEAREST, FARTHEST = 1.2, 3.0


@dataclass(frozen=True)
class Views:
    """The cameras of a fit. fit: those to fit to. test: those that measure it. source: their origin, as text."""

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

    stated: the cameras of the file. If there are FEW or more, the fit uses these, because the networks of a scene are
    most accurate near its training cameras. Views between them measure it. Otherwise views are spread over the upper
    part of a sphere around the scene, in addition to the stated ones.
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
    """Returns a camera halfway between each camera and its nearest one, once for each pair."""
    from scipy.spatial.transform import Rotation, Slerp  # noqa: PLC0415 (only here)

    seen = poses(cameras)
    apart = np.linalg.norm(seen[:, None] - seen, axis=2)
    np.fill_diagonal(apart, np.inf)
    between = []
    for one, other in sorted({(min(i, j), max(i, j)) for i, j in enumerate(apart.argmin(axis=1).tolist())}):
        ends = cameras[one], cameras[other]
        turn = Slerp([0, 1], Rotation.from_matrix([camera.rotation for camera in ends]))
        rotation, centre = turn(0.5).as_matrix(), (ends[0].centre + ends[1].centre) / 2
        name = f"between-{one:04d}-{other:04d}"
        between.append(replace(ends[0], name=name, rotation=rotation, translation=-rotation @ centre))
    return between


def _around(view: View, distance: float) -> list[Camera]:
    """Returns cameras on a spiral spread evenly over a part of a sphere. distance: its radius, world units."""
    return [
        sized(view.around(f"around-{number:04d}", math.asin(height), turn, distance))
        for number, (height, turn) in enumerate(zip(*spiral(AROUND, LOWEST, HIGHEST), strict=True))
    ]
