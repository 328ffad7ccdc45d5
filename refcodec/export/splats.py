"""Ordinary 3D Gaussians with spherical harmonics, as in 3DGS files, and their images."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..bitstream.reconstruction import Reconstruction, gaussians
from ..bitstream.scene import Scene
from ..bitstream.splat import HARMONICS, LENGTHS, LOGIT, MEAN, QUATERNION
from ..rendering.camera import Camera
from ..rendering.gaussians import check_static
from ..rendering.harmonics import degree_of, harmonics

if TYPE_CHECKING:
    from ..rendering.rasterise import Rendering, Settings

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
# Opacities from this to 1 minus this have finite logits in float32.
OPACITY_LEAST = 1e-6


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


@dataclass(frozen=True, eq=False)
class Packed:
    """A file of Gaussians. data: its bytes. splats: the values that programs read from it, float32."""

    data: bytes
    splats: Splats


# SPEC 9.4
def static_splats(scene: Scene, values: Reconstruction | None = None) -> Splats:
    """Returns the Gaussians of a static scene, exactly as it decodes, in the order of anchors and offsets.

    values: those of the scene, if known. Raises RenderModelError for another scene.
    """
    check_static(scene.render)
    numbers = gaussians(scene, values)
    outputs = numbers.shape[1] - HARMONICS.start
    coefficients = numbers[:, HARMONICS].reshape(len(numbers), outputs // 3, 3)
    parts = (
        *(numbers[:, MEAN], coefficients[:, 0], coefficients[:, 1:]),
        *(numbers[:, LOGIT], numbers[:, LENGTHS], numbers[:, QUATERNION]),
    )
    return Splats(*map(np.ascontiguousarray, parts))


def opacities(splats: Splats) -> F64:
    """Returns the opacities, from 0 to 1, [n]."""
    # Beyond 700, the exponential overflows, and the opacity is 0 in float32.
    return 1 / (1 + np.exp(np.minimum(-splats.opacity.astype(np.float64), 700)))


def logits(opacity: F64) -> F64:
    """Returns the logits of opacities, all finite."""
    within = np.clip(opacity, OPACITY_LEAST, 1 - OPACITY_LEAST)
    return np.log(within / (1 - within))


def nearest_bytes(values: NDArray[Any]) -> NDArray[np.uint8]:
    """Returns the nearest integers from 0 to 255."""
    return np.clip(np.floor(values + 0.5), 0, 255).astype(np.uint8)


def smaller_components(unit: F64) -> tuple[NDArray[np.int64], F64]:
    """Returns the index of the largest component of unit quaternions, and the other three, [n, 3], in their order.

    The signs are those of the equal rotation whose largest component is positive.
    """
    largest = np.argmax(np.abs(unit), axis=1)
    turned = unit * np.where(np.take_along_axis(unit, largest[:, None], axis=1) < 0, -1, 1)
    return largest, turned[np.arange(4) != largest[:, None]].reshape(-1, 3)


def with_largest(largest: NDArray[np.int64], others: F64) -> F64:
    """Returns the unit quaternions, [n, 4], from the results of smaller_components."""
    out = np.empty((len(others), 4))
    out[np.arange(4) != largest[:, None]] = others.reshape(-1)
    out[np.arange(len(out)), largest] = np.sqrt(np.maximum(1 - (others**2).sum(axis=1), 0))
    return out


def draw(splats: Splats, camera: Camera, settings: Settings) -> Rendering:
    """Draws Gaussians as 3DGS programs do: colours are 0.5 plus the sum of the harmonics, and at least 0.

    It needs the extra `render`. Raises ValueError as rasterise.
    """
    from ..rendering.rasterise import rasterise  # noqa: PLC0415 (numba)

    values = np.einsum("nk,nkc->nc", harmonics(splats.mean, camera.centre, splats.degree), splats.coefficients)
    lengths = np.exp(splats.scale)
    colours = np.maximum(values + 0.5, 0)
    return rasterise(splats.mean, splats.quaternion, lengths, opacities(splats), colours, camera, settings)
