"""Clause 14.2: cameras."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..bitstream.header import RenderInfo

F64 = NDArray[np.float64]
# The name of the camera that a file states.
OWN = "default"


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


def rotation_matrix(quaternion: F64) -> F64:
    """SPEC 14.4, ROTATION: returns the matrices, float64 [..., 3, 3], of unit quaternions w, x, y, z, [..., 4]."""
    w, x, y, z = np.moveaxis(np.asarray(quaternion, np.float64), -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))


def default_camera(info: RenderInfo) -> Camera:
    """SPEC 5.5 and 14.2: returns the camera that a file states."""
    quaternion = np.array(info.camera_rotation, np.float64)
    # The quaternion is scaled first. Every finite one but zero is allowed, and squares of large numbers are infinite.
    quaternion /= np.abs(quaternion).max()
    return Camera(
        OWN,
        info.camera_width,
        info.camera_height,
        *info.camera_focal,
        info.camera_width / 2,
        info.camera_height / 2,
        rotation_matrix(quaternion / np.linalg.norm(quaternion)),
        np.array(info.camera_translation, np.float64),
    )


def read_camera(text: str) -> Camera:
    """Returns the camera that a JSON object states (vectors/README.md).

    Its fields are width, height, focal, principal_point, rotation by rows, and translation. Raises ValueError.
    """
    try:
        c = json.loads(text)
        (fx, fy), (cx, cy) = c["focal"], c["principal_point"]
        rotation, translation = np.array(c["rotation"], np.float64), np.array(c["translation"], np.float64)
        camera = Camera(
            "stated",
            int(c["width"]),
            int(c["height"]),
            float(fx),
            float(fy),
            float(cx),
            float(cy),
            rotation,
            translation,
        )
    except (KeyError, TypeError) as error:
        raise ValueError(str(error)) from None
    if rotation.shape != (3, 3) or translation.shape != (3,):
        raise ValueError("rotation is not 3 x 3, or translation is not 3 numbers")
    return camera
