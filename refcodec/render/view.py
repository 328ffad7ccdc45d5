"""Looking at a scene: cameras around it, images of it as files (SPEC.md chapter 14)."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from ..bitstream.dimensions import RENDERING
from ..bitstream.header import RenderInfo
from ..bitstream.reconstruction import reconstruct
from ..bitstream.scene import Scene
from ..folder.uncompressed import Uncompressed
from .camera import Camera, default_camera
from .gaussians import gaussians
from .rasterise import image

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
U8 = NDArray[np.uint8]

# Pixels along a side of an image from a file's own camera, which may say 65535: an image of that size would not fit in memory.
SIDE_MAX = 4096
# The circle's height above the scene, in degrees, and its radius, in radii of the scene.
ELEVATION = 25.0
DISTANCE = 2.2
# An orbit's pictures a second, in its animation.
FRAME_RATE = 15


class View:
    """A scene that cameras look at."""

    def __init__(self, scene: Scene | Uncompressed) -> None:
        self.info, self.masks = scene.render, scene.masks
        self.values = reconstruct(scene) if isinstance(scene, Scene) else scene.values
        self.networks = {name: scene.networks[name] for name in RENDERING}

    def draw(self, camera: Camera) -> F32:
        """What a camera sees: float32 [height, width, 3], 1 for white."""
        return image(
            gaussians(self.values, self.masks, self.networks, camera, self.info.distance_unit), camera, self.info
        )

    def orbit(self, frames: int) -> list[Camera]:
        """Cameras on a circle around the scene that look at its middle, with the size and focal lengths of the file's own camera."""
        positions = self.values.positions.astype(np.float64)
        if not len(positions):
            positions = np.zeros((1, 3))
        middle = np.median(positions, axis=0)
        # Few anchors are far out in the background; they set neither the middle nor the distance.
        radius = max(float(np.quantile(np.linalg.norm(positions - middle, axis=1), 0.9)), 1e-6)
        up = np.zeros(3)
        up[self.info.up_axis // 2] = -1.0 if self.info.up_axis % 2 else 1.0
        side = np.roll(up, 1)
        front = np.cross(up, side)
        default = own_camera(self.info)
        cameras = []
        for number in range(frames):
            turn, height = 2 * np.pi * number / frames, np.radians(ELEVATION)
            away = np.cos(height) * (np.cos(turn) * side + np.sin(turn) * front) + np.sin(height) * up
            rotation = looking(-away, up)
            place = middle + DISTANCE * radius * away
            name = f"orbit-{number:04d}"
            cameras.append(
                Camera(
                    name,
                    default.width,
                    default.height,
                    default.fx,
                    default.fy,
                    default.cx,
                    default.cy,
                    rotation,
                    -rotation @ place,
                )
            )
        return cameras


def own_camera(info: RenderInfo) -> Camera:
    """The camera that a file states, with fewer pixels if one of its sides is longer than SIDE_MAX."""
    camera = default_camera(info)
    longer = max(camera.width, camera.height)
    if longer <= SIDE_MAX:
        return camera
    return camera.resized(max(camera.width * SIDE_MAX // longer, 1), max(camera.height * SIDE_MAX // longer, 1))


def looking(direction: F64, up: F64) -> F64:
    """The rotation [3, 3] of a camera that looks along a direction with `up` upwards in its image; the two are not parallel."""
    z = direction / np.linalg.norm(direction)
    x = np.cross(z, up)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z])


def eight_bits(made: F32) -> U8:
    """SPEC 14.5: uint8 of an image."""
    return np.floor(np.clip(made, 0, 1) * 255 + 0.5).astype(np.uint8)


def write_png(path: Path, made: F32) -> None:
    """An image as a PNG file."""
    Image.fromarray(eight_bits(made)).save(path)


def write_gif(path: Path, frames: Iterable[U8]) -> None:
    """Images as an endless animation."""
    first, *rest = (Image.fromarray(frame).quantize(dither=Image.Dither.NONE) for frame in frames)
    first.save(path, save_all=True, append_images=rest, duration=1000 // FRAME_RATE, loop=0)
