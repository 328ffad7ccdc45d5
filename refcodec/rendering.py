"""Rendering (SPEC.md chapter 14): from a scene and a camera to Gaussians, in floating point. Images are refcodec.rasterise's."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from .networks import Layer
from .reconstruction import Reconstruction
from .scene import RenderInfo

F64 = NDArray[np.float64]
RENDERING = ("opacity", "covariance", "colour")


@dataclass(frozen=True, eq=False)
class Camera:
    """SPEC 14.2: a pinhole camera.

    name: the image's name in its dataset; width, height, fx, fy, cx, cy: pixels; rotation: float64 [3, 3], world to camera;
    translation: float64 [3], world units.
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
        """Where the camera is in the world, float64 [3]."""
        return -self.rotation.T @ self.translation

    def resized(self, width: int, height: int) -> Camera:
        """The camera of the same image with another number of pixels."""
        x, y = width / self.width, height / self.height
        return replace(self, width=width, height=height, fx=self.fx * x, fy=self.fy * y, cx=self.cx * x, cy=self.cy * y)


def rotation_matrix(quaternion: F64) -> F64:
    """SPEC 14.4, ROTATION: float64 [..., 3, 3] of unit quaternions w, x, y, z [..., 4]."""
    w, x, y, z = np.moveaxis(np.asarray(quaternion, np.float64), -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))


def default_camera(info: RenderInfo) -> Camera:
    """SPEC 5.5 and 14.2: the camera that a file states."""
    quaternion = np.array(info.camera_rotation, np.float64)
    # Scaled first: any finite quaternion but zero is allowed, and squares of large ones are not finite.
    quaternion /= np.abs(quaternion).max()
    return Camera(
        "default",
        info.camera_width,
        info.camera_height,
        *info.camera_focal,
        info.camera_width / 2,
        info.camera_height / 2,
        rotation_matrix(quaternion / np.linalg.norm(quaternion)),
        np.array(info.camera_translation, np.float64),
    )


def read_camera(text: str) -> Camera:
    """A camera from JSON (vectors/README.md): width, height, focal, principal_point, rotation by rows, translation. Raises ValueError."""
    try:
        c = json.loads(text)
        (fx, fy), (cx, cy) = c["focal"], c["principal_point"]
        rotation, translation = np.array(c["rotation"], np.float64), np.array(c["translation"], np.float64)
        camera = Camera("stated", int(c["width"]), int(c["height"]), float(fx), float(fy), float(cx), float(cy), rotation, translation)
    except (KeyError, TypeError) as error:
        raise ValueError(str(error)) from None
    if rotation.shape != (3, 3) or translation.shape != (3,):
        raise ValueError("rotation is not 3 x 3, or translation is not 3 numbers")
    return camera


@dataclass(frozen=True, eq=False)
class Gaussians:
    """What an image is made of, arrays of one floating type: mean [n, 3], world units; lengths [n, 3] of the axes, world units;
    quaternion [n, 4], w x y z, of length 1; opacity [n]; colour [n, 3]. anchor, offset: int64 [n], where each comes from."""

    mean: NDArray
    lengths: NDArray
    quaternion: NDArray
    opacity: NDArray
    colour: NDArray
    anchor: NDArray[np.int64]
    offset: NDArray[np.int64]


def _network(layers: list[Layer], values: NDArray) -> NDArray:
    """SPEC 14.3, RENDER_NETWORK."""
    for number, (weight, bias) in enumerate(layers):
        values = values @ weight.T.astype(values.dtype) + bias.astype(values.dtype)
        if number < len(layers) - 1:
            values = np.maximum(values, 0)
    return values


def _logistic(x: NDArray) -> NDArray:
    """1 / (1 + exp(-x)) without overflow."""
    tail = np.exp(-np.abs(x))
    return np.where(x >= 0, 1 / (1 + tail), tail / (1 + tail))


# A file may hold any finite numbers; a Gaussian with one that overflows is not drawn.
@np.errstate(over="ignore", invalid="ignore")
def gaussians(
    values: Reconstruction,
    masks: NDArray[np.bool_],
    networks: dict[str, list[Layer]],
    camera: Camera,
    dtype: DTypeLike = np.float32,
) -> Gaussians:
    """SPEC 14.3: the Gaussians that a camera sees or not, in the order of anchors and offsets. masks: bool [N, K]."""
    count, k = masks.shape
    # Positions lose what they share with the camera before they lose digits.
    away = (values.positions.astype(np.float64) - camera.centre).astype(dtype)
    distance = np.linalg.norm(away, axis=1, keepdims=True)
    direction = np.divide(away, distance, out=np.zeros_like(away), where=distance > 0)
    inputs = np.concatenate([values.features.astype(dtype), direction, distance], axis=1)
    opacity, covariance, colour = (_network(networks[name], inputs) for name in RENDERING)
    opacity = np.tanh(opacity)
    anchor, offset = np.nonzero(masks & (opacity > 0))
    chosen = covariance.reshape(count, k, 7)[anchor, offset]
    lengths = np.exp(values.scalings.astype(dtype))
    quaternion = chosen[:, 3:]
    # Scaled first, as squares of small components vanish.
    quaternion = quaternion / np.maximum(np.abs(quaternion).max(axis=1, keepdims=True), np.finfo(dtype).tiny)
    norm = np.linalg.norm(quaternion, axis=1, keepdims=True)
    unit = np.array([1, 0, 0, 0], dtype)
    return Gaussians(
        values.positions.astype(dtype)[anchor] + values.offsets.astype(dtype)[anchor, offset] * lengths[anchor, :3],
        lengths[anchor, 3:] * _logistic(chosen[:, :3]),
        np.where(norm > 0, np.divide(quaternion, norm, where=norm > 0, out=np.zeros_like(quaternion)), unit),
        opacity[anchor, offset],
        _logistic(colour.reshape(count, k, 3)[anchor, offset]),
        anchor,
        offset,
    )


def gaussians_document(found: Gaussians) -> dict[str, Any]:
    """Gaussians as JSON values (vectors/README.md)."""
    kinds = ("anchor", "offset", "mean", "lengths", "quaternion", "opacity", "colour")
    columns = [getattr(found, kind).tolist() for kind in kinds]
    return {"gaussians": [dict(zip(kinds, row, strict=True)) for row in zip(*columns, strict=True)]}
