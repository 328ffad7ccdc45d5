"""Clause 14.2: cameras."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from numbers import Integral, Real
from typing import Annotated, Any

import numpy as np
from msgspec import Meta, Struct
from numpy.typing import ArrayLike, NDArray

from ..bitstream.cameras import NamedCamera
from ..bitstream.header import RenderInfo
from ..files.documents import checked, parse_json

F64 = NDArray[np.float64]
# The name of the camera that a file states.
OWN = "default"

# How many cameras of a training a scene states. Each one takes 60 bytes of a file.
STATED = 16
# The most bytes of a stated camera, which has some hundred.
CAMERA_MAX = 1 << 16
# SPEC 6.5 has 16 bits for each side of an image.
SIDE_MAX = 65535
# The most pixels of an image. Drawing takes about 40 bytes for each of them.
PIXELS_MAX = 100_000_000
# How far rotation @ rotation.T of a stated camera may be from the identity. The camera's centre follows from the
# rotation's transpose, so a matrix that is none would show another place.
ROTATION_TOLERANCE = 1e-3
# Of what is up (up_direction). The rows of images say it if they are spread in a plane: if the mean of their squares
# across the mean row is at least ROWS_SPREAD, a spread of 13 degrees, and that out of the plane at most ROWS_LEVEL of
# it.
ROWS_SPREAD, ROWS_LEVEL = 0.05, 0.25
# Images whose mean top is within 12 degrees of the horizontal do not say which end of a line is up.
UPRIGHT = 0.2
# A mean of unit vectors that is shorter is one of vectors that point different ways.
MIXED = 0.5
# A shorter mean has no meaningful direction.
SHORT = 1e-6
# The fewest points that make a plane, and the thickness of a plane beside its breadth, both as standard deviations.
POINTS_LEAST, FLAT = 16, 0.2
# The ground is under the cameras if its normal is within so much of a right angle to the images' rows (as a cosine),
# and if they moved upwards in their images by more than this share of their distance to it.
LEAN, CLIMBED = 0.3, 0.25


@dataclass(frozen=True, eq=False)
class Camera:
    """SPEC 14.2: a pinhole camera.

    name: the name of its image.
    width, height: the size of the image in pixels.
    fx, fy: the focal lengths in pixels.
    cx, cy: the principal point in pixels.
    rotation: float64 [3, 3], from the world to the camera.
    translation: float64 [3], from the world to the camera, in world units.
    """

    name: str
    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    rotation: F64
    translation: F64

    @classmethod
    def look_at(cls, eye: ArrayLike, target: ArrayLike, up: ArrayLike, width: int, height: int, fov: float) -> Camera:
        """Returns a camera at one point that looks at another one. Its pixels are square, and its axis is central.

        Args:
            eye: the position of the camera, [3], world units.
            target: the point in the middle of the image, [3], world units.
            up: the direction that is upwards in the image, [3], of any length, such as `scene.up`.
            width: of the image in pixels.
            height: of the image in pixels.
            fov: the vertical angle of view, in degrees, above 0 and below 180.

        Raises:
            ValueError: a value is not as above, the target is at the eye, or `up` is parallel to the view.
        """
        at, to, above = (_point(name, value) for name, value in (("eye", eye), ("target", target), ("up", up)))
        if not 0 < fov < 180:
            raise ValueError(f"fov is {fov}, but must be above 0 and below 180 degrees")
        ahead, length = to - at, np.linalg.norm(above)
        distance = np.linalg.norm(ahead)
        if not distance:
            raise ValueError("the target is at the eye: choose another point")
        if not length or np.linalg.norm(np.cross(ahead / distance, above / length)) < SHORT:
            raise ValueError("up is parallel to the view, or 0: choose another direction")
        rotation = looking(ahead, above)
        focal = height / 2 / math.tan(math.radians(fov) / 2)
        camera = cls("look_at", width, height, focal, focal, width / 2, height / 2, rotation, -rotation @ at)
        check_camera(camera)
        return camera

    @property
    def centre(self) -> F64:
        """The position of the camera in the world, float64 [3]."""
        return -self.rotation.T @ self.translation

    def resized(self, width: int, height: int) -> Camera:
        """Returns the camera of the same view, with an image of another number of pixels."""
        x, y = width / self.width, height / self.height
        return replace(self, width=width, height=height, fx=self.fx * x, fy=self.fy * y, cx=self.cx * x, cy=self.cy * y)


def moved(cameras: Sequence[Camera], offset: F64) -> list[Camera]:
    """Returns cameras at places from which an offset is subtracted, float64 [3], world units."""
    return [replace(camera, translation=camera.translation + camera.rotation @ offset) for camera in cameras]


def _point(name: str, value: ArrayLike) -> F64:
    """Returns a point or a direction, float64 [3]. Raises ValueError."""
    point = np.asarray(value, np.float64)
    if point.shape != (3,) or not np.isfinite(point).all():
        raise ValueError(f"{name} is {value!r}, but must be three finite numbers")
    return point


def looking(direction: F64, up: F64) -> F64:
    """Returns the rotation, float64 [3, 3], of a camera that looks along a direction with `up` upwards in its image.

    direction, up: float64 [3], not parallel.
    """
    z = direction / np.linalg.norm(direction)
    x = np.cross(z, up)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z])


def check_camera(camera: Camera) -> None:
    """Raises ValueError for what is no camera.

    Its rotation and translation are finite arrays of their shapes. Its focal lengths are above 0, and its other numbers
    are finite. Its image has sides of whole numbers above 0, and at most PIXELS_MAX pixels.
    """
    if not isinstance(camera, Camera):
        raise ValueError(f"the camera must be a Camera, not {type(camera).__name__}")
    for name, shape in (("rotation", (3, 3)), ("translation", (3,))):
        value = getattr(camera, name)
        if not isinstance(value, np.ndarray) or value.dtype.kind not in "fiu" or value.shape != shape:
            raise ValueError(f"{name}: numbers of shape {shape} are required")
        if not np.isfinite(value).all():
            raise ValueError(f"{name}: finite values are required")
    numbers = (camera.fx, camera.fy, camera.cx, camera.cy)
    if not all(isinstance(n, Real) and math.isfinite(n) for n in numbers) or min(camera.fx, camera.fy) <= 0:
        raise ValueError(
            f"focal lengths {camera.fx}, {camera.fy} and centre {camera.cx}, {camera.cy}: "
            "finite and lengths above 0 are required"
        )
    sides = (camera.width, camera.height)
    if not all(isinstance(side, Integral) and not isinstance(side, bool) and side >= 1 for side in sides):
        raise ValueError(f"image of {camera.width} x {camera.height}: whole numbers above 0 are required")
    if int(camera.width) * int(camera.height) > PIXELS_MAX:
        raise ValueError(f"image of {camera.width} x {camera.height}: at most {PIXELS_MAX} pixels are allowed")


def default_camera(stated: NamedCamera) -> Camera:
    """SPEC 5.17 and 14.2: returns a camera that a file states."""
    lens, translation = (*stated.focal, *stated.principal_point), np.array(stated.translation, np.float64)
    return Camera(OWN, stated.width, stated.height, *lens, stated.matrix(), translation)


def named_camera(camera: Camera, name: str = OWN) -> NamedCamera:
    """SPEC 5.17: returns a camera as a file states it, under a name. Its numbers are rounded to float32."""
    # Decoding draws nothing, and should not wait for SciPy.
    from scipy.spatial.transform import Rotation  # noqa: PLC0415

    def rounded(values: Any) -> Any:
        return tuple(np.asarray(values).astype(np.float32).tolist())

    lens = rounded([camera.fx, camera.fy]), rounded([camera.cx, camera.cy])
    turn = rounded(Rotation.from_matrix(camera.rotation).as_quat(scalar_first=True))
    return NamedCamera(name, camera.width, camera.height, *lens, turn, rounded(camera.translation))


def poses(cameras: Sequence[Camera]) -> F64:
    """Returns points whose distances say how far cameras are from each other, float64 [n, 6].

    They are the centres, in units of their spread, and the directions.
    """
    centres, ahead = np.array([c.centre for c in cameras]), np.array([c.rotation[2] for c in cameras])
    spread = np.sqrt(np.mean(np.sum((centres - centres.mean(axis=0)) ** 2, axis=1)))
    return np.concatenate([centres / spread if spread > 0 else centres, ahead], axis=1)


def spread_cameras(cameras: Sequence[Camera], count: int) -> list[NamedCamera]:
    """SPEC 5.17: returns cameras as a file states them: the first one, the default view, and others far from it.

    count: how many at most. Each one is the farthest from those before it, in place and in direction, so that the first
    few are spread as well. They are named by numbers: the names of photographs would say more than a viewer needs.
    """
    if not cameras or not count:
        return []
    seen = poses(cameras)
    chosen, distance = [0], np.sum((seen - seen[0]) ** 2, axis=1)
    while len(chosen) < count and distance.max() > 0:
        chosen.append(int(distance.argmax()))
        distance = np.minimum(distance, np.sum((seen - seen[chosen[-1]]) ** 2, axis=1))
    return [named_camera(cameras[i], str(number) if number else OWN) for number, i in enumerate(chosen)]


def level_up(cameras: Sequence[Camera]) -> F64 | None:
    """Returns the direction that the rows of the cameras' images are perpendicular to, float64 [3], or None.

    Who holds a camera keeps the horizon level, and so do drones, whether they look ahead or down. None: the rows leave
    more than one direction, since they are all parallel, or none, since the cameras are turned about their axes.
    """
    if not cameras:
        return None
    rows, down, ahead = np.moveaxis(np.array([c.rotation for c in cameras]), 1, 0)
    values, vectors = np.linalg.eigh(rows.T @ rows / len(rows))
    if values[1] < ROWS_SPREAD or values[0] > ROWS_LEVEL * values[1]:
        return None
    axis = vectors[:, 0]
    # Cameras that look straight down have what is up nowhere in their images. It is behind them.
    above = -np.mean(down @ axis)
    return axis * np.copysign(1.0, above if abs(above) > UPRIGHT else -np.mean(ahead @ axis))


def up_direction(cameras: Sequence[Camera], points: F64) -> F64:
    """Returns what is up in a scene, a unit vector, float64 [3].

    points: float64 [M, 3], of the scene, world units. The rows of the images decide if they can (level_up). If the
    cameras look all one way over flat ground, as on a flight in parallel lines, up is the normal of the ground. In all
    other cases it is the mean of what is up in the images. Cameras that all look straight at a wall are told from a
    flight by their moves alone: few people climb.
    """
    level = level_up(cameras)
    if level is not None:
        return level
    rows, down, ahead = (np.mean([c.rotation[i] for c in cameras], axis=0) for i in range(3))
    direction = -down
    ground = _ground(points)
    if np.linalg.norm(down) < MIXED < np.linalg.norm(ahead):
        # Flights turn at the end of a line. Then the images' tops point both ways.
        direction = -ahead
    elif ground is not None:
        middle, normal = ground
        centres = np.array([c.centre for c in cameras])
        distance, climbed = np.mean((middle - centres) @ ahead), np.std(centres @ down)
        if abs(normal @ rows) < LEAN and distance > 0 and climbed > CLIMBED * distance:
            direction = normal * np.copysign(1.0, np.mean((centres - middle) @ normal))
    length = np.linalg.norm(direction)
    return direction / length if length > SHORT else axis_direction(RenderInfo.up_axis)


def _ground(points: F64) -> tuple[F64, F64] | None:
    """Returns the middle and the normal of points that lie in a plane, each float64 [3], or None."""
    if len(points) < POINTS_LEAST:
        return None
    middle = np.median(points, axis=0)
    away = np.linalg.norm(points - middle, axis=1)
    # A reconstruction has points far away that belong to nothing.
    near = (points - middle)[away <= np.quantile(away, 0.9)]
    values, vectors = np.linalg.eigh(near.T @ near / len(near))
    return (middle, vectors[:, 0]) if values[0] < FLAT**2 * values[1] else None


def axis_direction(up_axis: int) -> F64:
    """Returns the unit vector of an up_axis of SPEC 6.5, float64 [3]."""
    direction = np.zeros(3)
    direction[up_axis // 2] = -1.0 if up_axis % 2 else 1.0
    return direction


def nearest_axis(direction: F64) -> int:
    """SPEC 6.5: returns the up_axis that is nearest to a direction, float64 [3]."""
    axis = int(np.abs(direction).argmax())
    return 2 * axis + int(direction[axis] < 0)


def scene_up(up_axis: int, stated: Sequence[NamedCamera]) -> F64:
    """Returns the up direction of a scene, a unit vector, float64 [3].

    up_axis states the nearest world axis (SPEC 6.5). The cameras of a file refine it to a level horizon, unless they
    contradict up_axis or do not determine it.
    """
    axis, level = axis_direction(up_axis), level_up([default_camera(camera) for camera in stated])
    if level is None:
        return axis
    level *= np.copysign(1.0, level @ axis)
    return level if nearest_axis(level) == up_axis else axis


def up_axis(cameras: Sequence[Camera], points: F64) -> int:
    """SPEC 6.5: returns the number of the world's axis that is nearest to what is up (up_direction)."""
    return nearest_axis(up_direction(cameras, points))


_Side = Annotated[int, Meta(ge=1, le=SIDE_MAX)]
_Focal = Annotated[float, Meta(gt=0)]
_Vector = tuple[float, float, float]


class _Fields(Struct):
    width: _Side
    height: _Side
    focal: tuple[_Focal, _Focal]
    principal_point: tuple[float, float]
    rotation: tuple[_Vector, _Vector, _Vector]
    translation: _Vector


def read_camera(data: bytes | str) -> Camera:
    """Returns the camera that a JSON object states (vectors/README.md).

    Its fields are width, height, focal, principal_point, rotation by rows, and translation. Raises ValueError for a
    field that is missing or has another type, a side of more than 65535 pixels, a focal length of 0 or less, and a
    rotation that is not a rotation matrix within ROTATION_TOLERANCE.
    """
    fields: _Fields = checked(parse_json(data, CAMERA_MAX), _Fields)
    rotation = np.array(fields.rotation)
    # Rows that are far too long would overflow when they are multiplied.
    right = np.abs(rotation).max() < 2 and np.abs(rotation @ rotation.T - np.eye(3)).max() <= ROTATION_TOLERANCE
    if not right or np.linalg.det(rotation) < 0:
        raise ValueError(f"rotation is not a rotation matrix within {ROTATION_TOLERANCE}")
    lens = *fields.focal, *fields.principal_point
    return Camera("stated", fields.width, fields.height, *lens, rotation, np.array(fields.translation))
