"""Pictures of splats, from given or generated cameras, as a NeRF folder of photographs.

Generated cameras stand around the splats and among them. Those around look at the middle from a sphere, as in NeRF's
synthetic scenes: training cameras are spread evenly over it, and test cameras follow a spiral. Those among the splats
look at a surface from free space. The renderer of refcodec draws the images, which are the ground truth of the scene.
"""

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
from ..formats.packing import opacities
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
# Cameras among the splats: their distances from what they look at, in radii; the directions that are tried, and the
# sine of the steepest one; the first and the last point of a line of sight, in distances, and the number of points;
# the least opacity of a Gaussian that is in the way; how far it must be, in distances from the target; and the side of
# the largest area that counts, in radii.
DISTANCES, DIRECTIONS, STEEP, SIGHT, SOLID, CLEAR, AREA = (0.25, 0.5, 1.0), 64, 0.8, (0.15, 1.0, 12), 0.3, 0.5, 0.05
# Every N-th picture is for tests. So many judge a file without a training.
TEST_EVERY = JUDGES = 8
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
    groups: dict[str, list[Camera]] = {}
    for purpose, (height, turn) in heights_and_turns.items():
        flat = np.sqrt(1 - height**2)
        groups[purpose] = []
        for number, away in enumerate(np.stack([flat * np.cos(turn), flat * np.sin(turn), height], axis=1) @ base):
            place = middle + away * MARGIN * radius / math.sin(ANGLE / 2)
            groups[purpose].append(_camera(f"{purpose}/r_{number}", size, place, -away, up))
    return groups


def _camera(name: str, size: int, place: F64, direction: F64, up: F64) -> Camera:
    """Returns a camera at a place that looks along a direction."""
    rotation, focal = looking(direction, up), size / 2 / math.tan(ANGLE / 2)
    return Camera(name, size, size, focal, focal, size / 2, size / 2, rotation, -rotation @ place)


def among(splats: Splats, up: F64, size: int, train: int, test: int) -> dict[str, list[Camera]]:
    """Returns cameras in free space among the splats, by purpose. Arguments: as for orbit.

    Each looks at a Gaussian from DISTANCES radii. Gaussians are drawn by their area and opacity. Of DIRECTIONS, that is
    taken whose line of sight is the farthest from solid Gaussians, in relation to the distance from the target.
    """
    from scipy.spatial import KDTree  # noqa: PLC0415 (slow to load, and only here)

    mean, scale = splats.mean.astype(np.float64), -np.sort(-np.exp(splats.scale.astype(np.float64)), axis=1)
    opacity = opacities(splats)
    middle, radius = middle_and_radius(splats)
    # Neither the sky nor what floats far out is a target.
    core = np.linalg.norm(mean - middle, axis=1) <= radius
    solid = core & (opacity >= SOLID)
    tree = KDTree(mean[solid if solid.any() else core])
    area = np.minimum(scale[:, 0] * scale[:, 1], (AREA * radius) ** 2)
    share = np.where(core, opacity * area, 0)
    height, turn = spiral(DIRECTIONS, -STEEP, STEEP)
    side = looking(up, np.roll(up, 1) + np.array((0.1, 0.2, 0.3)))[:2]
    flat = np.sqrt(1 - height**2)
    away = np.stack([flat * np.cos(turn), flat * np.sin(turn), height], axis=1) @ np.stack([*side, up])
    along = np.linspace(*SIGHT)
    groups: dict[str, list[Camera]] = {TRAIN: [], TEST: []}
    targets = np.random.default_rng(0).choice(len(share), train + test, p=share / share.sum())
    for number, target in enumerate(targets):
        distance = radius * DISTANCES[number % len(DISTANCES)]
        sight = mean[target] + distance * along[None, :, None] * away[:, None, :]
        clear = (tree.query(sight.reshape(-1, 3))[0].reshape(sight.shape[:2]) / along).min(axis=1)
        # Every second one stands on the side of the middle if it can: a room is seen from inside, too.
        inside = (clear >= CLEAR * distance) & (away @ (middle - mean[target]) > 0)
        best = away[(clear * inside if number % 2 and inside.any() else clear).argmax()]
        purpose = TRAIN if number < train else TEST
        name = f"{purpose}/near_{number}"
        groups[purpose].append(_camera(name, size, mean[target] + distance * best, -best, up))
    return groups


def generated(splats: Splats, up: F64, size: int, train: int, test: int) -> dict[str, list[Camera]]:
    """Returns cameras around the splats, and as many among them, by purpose. Arguments: as for orbit."""
    half = [orbit(splats, up, size, (train + 1) // 2, (test + 1) // 2), among(splats, up, size, train // 2, test // 2)]
    return {purpose: [*half[0][purpose], *half[1][purpose]] for purpose in (TRAIN, TEST)}


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
