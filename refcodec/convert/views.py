"""Pictures of splats, from given or generated cameras, as a NeRF folder of photographs.

Generated cameras look at the middle of the splats from a sphere around it, as in NeRF's synthetic scenes. Training
cameras are spread evenly over the sphere. Test cameras follow a spiral around it. The renderer of refcodec draws the
images, which are the ground truth of the scene.
"""

from __future__ import annotations

import io
import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image

from ..files.ply import ply_bytes
from ..files.stage import new_file
from ..formats.harmonics import ZERO
from ..formats.splats import Splats
from ..rendering.camera import Camera, looking
from ..rendering.rasterise import Settings
from ..rendering.view import eight_bits, spiral
from .drawing import Tensors, drawn, tensors

F64 = NDArray[np.float64]

TRAIN, TEST = "train", "test"
POINTS_FILE = "points3d.ply"
# As the cameras of NeRF's synthetic scenes.
ANGLE = 0.6911
# The default side of an image in pixels.
SIDE = 800
# The sines of the lowest and the highest elevation.
LOWEST, HIGHEST = -0.3, 0.95
# The turns of the spiral of test cameras.
TURNS = 3
# The share of the Gaussians within the radius of the splats, and the margin that the cameras see.
SHARE, MARGIN = 0.99, 1.1
# The near plane in radii, at most that of 3DGS in world units.
NEAR, NEAR_MAX = 0.01, 0.2
# Every N-th picture is for tests.
TEST_EVERY = 8
# The number of initial points of a training run, drawn from Gaussians that are not nearly transparent.
POINTS, OPAQUE = 200_000, 0.1
AXES = {f"{sign}{axis}": (1 if sign == "+" else -1) * np.eye(3)[i] for sign in "+-" for i, axis in enumerate("xyz")}

# Cameras by their purpose, TRAIN or TEST.
ByPurpose = Mapping[str, Sequence[Camera]]


def middle_and_radius(splats: Splats) -> tuple[F64, float]:
    """Returns the median of the means, float64 [3], and the distance from there within which SHARE of them are."""
    mean = splats.mean.astype(np.float64)
    middle = np.median(mean, axis=0)
    return middle, float(np.quantile(np.linalg.norm(mean - middle, axis=1), SHARE)) or 1.0


def near_plane(splats: Splats) -> float:
    """Returns the near plane of pictures of splats, in world units, a float32 value."""
    _, radius = middle_and_radius(splats)
    return float(np.float32(min(NEAR * radius, NEAR_MAX)))


def orbit(splats: Splats, up: F64, size: int, train: int, test: int) -> dict[str, list[Camera]]:
    """Returns cameras around the splats, by purpose.

    up: the up axis of the world, a unit vector, float64 [3]. size: sides of the images in pixels. train, test: numbers
    of cameras.
    """
    share = (np.arange(test, dtype=np.float64) + 0.5) / test
    heights_and_turns = {
        TRAIN: spiral(train, LOWEST, HIGHEST),
        TEST: (LOWEST + (HIGHEST - LOWEST) * share, 2 * math.pi * TURNS * share),
    }
    middle, radius = middle_and_radius(splats)
    # Not the axis that is nearest to up.
    nearest = int(np.abs(up).argmax())
    side = np.roll(np.sign(up[nearest]) * np.eye(3)[nearest], 1)
    side = side - (side @ up) * up
    side /= np.linalg.norm(side)
    base = np.stack([side, np.cross(up, side), up])
    focal = size / 2 / math.tan(ANGLE / 2)
    groups: dict[str, list[Camera]] = {}
    for purpose, (height, turn) in heights_and_turns.items():
        flat = np.sqrt(1 - height**2)
        groups[purpose] = []
        for number, away in enumerate(np.stack([flat * np.cos(turn), flat * np.sin(turn), height], axis=1) @ base):
            rotation, name = looking(-away, up), f"{purpose}/r_{number}"
            place = middle + away * MARGIN * radius / math.sin(ANGLE / 2)
            camera = Camera(name, size, size, focal, focal, size / 2, size / 2, rotation, -rotation @ place)
            groups[purpose].append(camera)
    return groups


def given(cameras: Sequence[Camera], most: int, size: int | None) -> dict[str, list[Camera]]:
    """Returns an even selection of given cameras, by purpose. Every TEST_EVERY-th is for tests.

    most: maximum number. size: the longest side of an image in pixels, None for the given sizes.
    """
    chosen = [cameras[i] for i in np.unique(np.linspace(0, len(cameras) - 1, most).round().astype(int))]
    groups: dict[str, list[Camera]] = {TRAIN: [], TEST: []}
    for number, camera in enumerate(chosen):
        share = min(1.0, (size or math.inf) / max(camera.width, camera.height))
        smaller = camera.resized(max(round(camera.width * share), 1), max(round(camera.height * share), 1))
        # The first camera is always for training.
        name = TEST if number % TEST_EVERY == TEST_EVERY - 1 else TRAIN
        groups[name].append(replace(smaller, name=f"{name}/r_{number}"))
    return groups


def transforms(cameras: Sequence[Camera]) -> dict[str, object]:
    """Returns the NeRF document of cameras, with y and z as in Blender."""
    frames = []
    for camera in cameras:
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = camera.rotation.T * (1, -1, -1), camera.centre
        lens = {"fl_x": camera.fx, "fl_y": camera.fy, "cx": camera.cx, "cy": camera.cy}
        size = {"w": camera.width, "h": camera.height}
        frames.append({"file_path": camera.name, "transform_matrix": matrix.tolist(), **lens, **size})
    return {"frames": frames}


def _picture(splats: Tensors, camera: Camera, settings: Settings, transparent: bool) -> Image.Image:
    """Returns the image of a camera: RGB, or without a background RGBA with straight alpha."""
    image, transmittance, _ = drawn(splats, camera, settings)
    if not transparent:
        return Image.fromarray(eight_bits(image.numpy()), "RGB")
    alpha = np.rint((1 - transmittance.numpy()[:, :, None]) * 255)
    # Pixels that the splat covers by less than half a step of eight bits are empty.
    colour = np.where(alpha > 0, image.numpy() * 255 / np.maximum(alpha, 1), 0)
    return Image.fromarray(np.concatenate([eight_bits(colour), alpha.astype(np.uint8)], axis=2), "RGBA")


def write_photographs(
    splats: Splats,
    views: ByPurpose,
    folder: Path,
    progress: Callable[[str, int, int], None],
    background: tuple[int, int, int] | None = None,
    points: bool = True,
) -> None:
    """Writes images, camera files and, if wanted, initial points. The folder may exist.

    background: 0 to 255 each; None for transparent images, which cannot show colours above 1 of half-transparent
    Gaussians. Raises OSError, also if a file exists.
    """
    red, green, blue = (value / 255 for value in background or (0, 0, 0))
    settings = Settings(near_plane=near_plane(splats), background=(red, green, blue))
    shown, done, total = tensors(splats), 0, sum(len(cameras) for cameras in views.values())
    for name, cameras in views.items():
        (folder / name).mkdir(parents=True, exist_ok=True)
        for camera in cameras:
            data = io.BytesIO()
            _picture(shown, camera, settings, background is None).save(data, "PNG")
            _put(folder / f"{camera.name}.png", data.getvalue())
            done += 1
            progress("draw", done, total)
        _put(folder / f"transforms_{name}.json", (json.dumps(transforms(cameras), indent=1) + "\n").encode())
    if points:
        _write_points(shown, folder / POINTS_FILE)


def _put(path: Path, content: bytes) -> None:
    with new_file(path) as file:
        file.write(content)


def _write_points(splats: Tensors, path: Path) -> None:
    """Writes the means of the visible Gaussians, with their mean colours, as a PLY file of points."""
    seen = torch.nonzero(torch.sigmoid(splats["opacity"]) >= OPAQUE)[:, 0]
    rows = seen if len(seen) else torch.arange(len(splats["mean"]))
    if len(rows) > POINTS:
        rows = rows[torch.randperm(len(rows), generator=torch.Generator().manual_seed(0))[:POINTS]]
    mean, colour = splats["mean"][rows].numpy(), eight_bits((ZERO * splats["base"][rows] + 0.5).numpy())
    table = np.empty(len(rows), [*((axis, "<f4") for axis in "xyz"), *((c, "u1") for c in ("red", "green", "blue"))])
    for values, names in ((mean, ("x", "y", "z")), (colour, ("red", "green", "blue"))):
        for column, name in enumerate(names):
            table[name] = values[:, column]
    _put(path, ply_bytes({"vertex": table}))
