"""Clause 14.2: cameras."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from numbers import Integral, Real
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..bitstream.cameras import NamedCamera
from ..files.documents import parse_json

F64 = NDArray[np.float64]
# The name of the camera that a file states.
OWN = "default"

# The most bytes of a stated camera, which has some hundred.
CAMERA_MAX = 1 << 16
# SPEC 6.5 has 16 bits for each side of an image.
SIDE_MAX = 65535
# The most pixels of an image. Drawing takes about 40 bytes for each of them.
PIXELS_MAX = 100_000_000
# How far rotation @ rotation.T of a stated camera may be from the identity. The camera's centre follows from the
# rotation's transpose, so a matrix that is none would show another place.
ROTATION_TOLERANCE = 1e-3


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

    @property
    def centre(self) -> F64:
        """The position of the camera in the world, float64 [3]."""
        return -self.rotation.T @ self.translation

    def resized(self, width: int, height: int) -> Camera:
        """Returns the camera of the same view, with an image of another number of pixels."""
        x, y = width / self.width, height / self.height
        return replace(self, width=width, height=height, fx=self.fx * x, fy=self.fy * y, cx=self.cx * x, cy=self.cy * y)


def check_camera(camera: Camera) -> None:
    """Raises ValueError for what is no camera.

    Its rotation and translation are finite arrays of their shapes. Its focal lengths are above 0, and its other numbers
    are finite. Its image has sides of whole numbers above 0, and at most PIXELS_MAX pixels.
    """
    if not isinstance(camera, Camera):
        raise ValueError(f"a camera is wanted, not {type(camera).__name__}")
    for name, shape in (("rotation", (3, 3)), ("translation", (3,))):
        value = getattr(camera, name)
        if not isinstance(value, np.ndarray) or value.dtype.kind not in "fiu" or value.shape != shape:
            raise ValueError(f"{name}: numbers of shape {shape} are wanted")
        if not np.isfinite(value).all():
            raise ValueError(f"{name}: finite values are wanted")
    numbers = (camera.fx, camera.fy, camera.cx, camera.cy)
    if not all(isinstance(n, Real) and math.isfinite(n) for n in numbers) or min(camera.fx, camera.fy) <= 0:
        raise ValueError(
            f"focal lengths {camera.fx}, {camera.fy} and centre {camera.cx}, {camera.cy}: "
            "finite and lengths above 0 are wanted"
        )
    sides = (camera.width, camera.height)
    if not all(isinstance(side, Integral) and not isinstance(side, bool) and side >= 1 for side in sides):
        raise ValueError(f"image of {camera.width} x {camera.height}: whole numbers above 0 are wanted")
    if int(camera.width) * int(camera.height) > PIXELS_MAX:
        raise ValueError(f"image of {camera.width} x {camera.height}: {PIXELS_MAX} pixels are allowed")


def default_camera(stated: NamedCamera) -> Camera:
    """SPEC 5.17 and 14.2: returns a camera that a file states."""
    return Camera(
        OWN,
        stated.width,
        stated.height,
        *stated.focal,
        *stated.principal_point,
        stated.matrix(),
        np.array(stated.translation, np.float64),
    )


def named_camera(camera: Camera) -> NamedCamera:
    """SPEC 5.17: returns a camera as a file states it, as the default view. Its numbers are rounded to float32."""
    # Decoding draws nothing, and should not wait for SciPy.
    from scipy.spatial.transform import Rotation  # noqa: PLC0415

    def rounded(values: Any) -> Any:
        return tuple(np.asarray(values).astype(np.float32).tolist())

    return NamedCamera(
        OWN,
        camera.width,
        camera.height,
        rounded([camera.fx, camera.fy]),
        rounded([camera.cx, camera.cy]),
        rounded(Rotation.from_matrix(camera.rotation).as_quat(scalar_first=True)),
        rounded(camera.translation),
    )


def up_axis(cameras: Sequence[Camera]) -> int:
    """SPEC 6.5: returns the number of the world's axis that is nearest to what is up in the cameras' images."""
    ups = -np.mean([c.rotation[1] for c in cameras], axis=0)
    axis = int(np.abs(ups).argmax())
    return 2 * axis + int(ups[axis] < 0)


def read_camera(data: bytes | str) -> Camera:
    """Returns the camera that a JSON object states (vectors/README.md).

    Its fields are width, height, focal, principal_point, rotation by rows, and translation. Raises ValueError for a
    field that is missing or has another type, a side of more than 65535 pixels, a focal length of 0 or less, and a
    rotation that is none to ROTATION_TOLERANCE.
    """
    fields = parse_json(data, CAMERA_MAX)
    if not isinstance(fields, dict):
        raise ValueError("it is no JSON object")
    width, height = (_side(fields, name) for name in ("width", "height"))
    focal, principal = _floats(fields, "focal", (2,)), _floats(fields, "principal_point", (2,))
    rotation, translation = _floats(fields, "rotation", (3, 3)), _floats(fields, "translation", (3,))
    if focal.min() <= 0:
        raise ValueError(f"focal is {focal.tolist()}, numbers above 0 are required")
    # Rows that are far too long would overflow when they are multiplied.
    right = np.abs(rotation).max() < 2 and np.abs(rotation @ rotation.T - np.eye(3)).max() <= ROTATION_TOLERANCE
    if not right or np.linalg.det(rotation) < 0:
        raise ValueError(f"rotation is no rotation to {ROTATION_TOLERANCE}")
    (fx, fy), (cx, cy) = focal.tolist(), principal.tolist()
    return Camera("stated", width, height, fx, fy, cx, cy, rotation, translation)


def _field(fields: dict[str, Any], name: str) -> Any:
    if name not in fields:
        raise ValueError(f"{name} is missing")
    return fields[name]


def _side(fields: dict[str, Any], name: str) -> int:
    value = _field(fields, name)
    if type(value) is not int or not 1 <= value <= SIDE_MAX:
        raise ValueError(f"{name} is not an integer from 1 to {SIDE_MAX}")
    return value


def _floats(fields: dict[str, Any], name: str, shape: tuple[int, ...]) -> F64:
    """Returns an array of finite numbers."""

    def right(value: Any, sides: tuple[int, ...]) -> bool:
        if not sides:
            return isinstance(value, int | float) and not isinstance(value, bool)
        return isinstance(value, list) and len(value) == sides[0] and all(right(v, sides[1:]) for v in value)

    value = _field(fields, name)
    if not right(value, shape):
        raise ValueError(f"{name} is not {' x '.join(map(str, shape))} numbers")
    return np.array(value, np.float64)
