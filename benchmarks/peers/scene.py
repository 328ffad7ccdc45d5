"""Photographs in NeRF's format, without points, of a splat: drawn from cameras of their own.

python -m benchmarks.peers.scene SPLAT.ply -o FOLDER

The cameras look at the splat's middle from a sphere around it, as those of NeRF's synthetic scenes do. Those to learn
from are spread evenly over it; those for tests go around it in a spiral. The images are what refcodec's renderer draws,
so a splat is the truth of its scene. They are transparent where it is, as those of the synthetic scenes are. The images
have the splat's licence.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from refcodec.files.text import printable
from refcodec.render.camera import Camera
from refcodec.render.rasterise import Settings
from refcodec.render.view import eight_bits, looking
from refcodec.statuses import DONE, USAGE

from .splats import Splats, drawn, read_ply

F64 = NDArray[np.float64]

# As the cameras of NeRF's synthetic scenes.
ANGLE = 0.6911
# The sines of the lowest and the highest elevation.
LOWEST, HIGHEST = -0.3, 0.95
# The turns of the spiral of test cameras.
TURNS = 3
# The share of the Gaussians within the splat's radius, and how much more than that the cameras see.
SHARE, MARGIN = 0.99, 1.1
AXES = {f"{sign}{axis}": (1 if sign == "+" else -1) * np.eye(3)[i] for sign in "+-" for i, axis in enumerate("xyz")}


def middle_and_radius(splats: Splats) -> tuple[F64, float]:
    """The median of the means, float64 [3], and the distance from there that SHARE of them do not exceed."""
    mean = splats["mean"].double().numpy()
    middle = np.median(mean, axis=0)
    return middle, float(np.quantile(np.linalg.norm(mean - middle, axis=1), SHARE))


def train_directions(count: int) -> F64:
    """Unit vectors [count, 3] spread evenly over the part of the sphere between the elevations; z is up.

    They follow the spiral of the golden angle.
    """
    number = np.arange(count, dtype=np.float64)
    return _directions(LOWEST + (HIGHEST - LOWEST) * (number + 0.5) / count, number * math.pi * (3 - math.sqrt(5)))


def test_directions(count: int) -> F64:
    """Unit vectors [count, 3] on a spiral from the lowest to the highest elevation; z is up."""
    share = (np.arange(count, dtype=np.float64) + 0.5) / count
    return _directions(LOWEST + (HIGHEST - LOWEST) * share, 2 * math.pi * TURNS * share)


def _directions(height: F64, turn: F64) -> F64:
    flat = np.sqrt(1 - height**2)
    return np.stack([flat * np.cos(turn), flat * np.sin(turn), height], axis=1)


def cameras(splats: Splats, directions: F64, up: F64, size: int, name: str) -> list[Camera]:
    """Cameras that look at the splat's middle from these directions. up: the world's axis that is up, float64 [3]."""
    middle, radius = middle_and_radius(splats)
    side = np.roll(up, 1)
    base = np.stack([side, np.cross(up, side), up])
    focal = size / 2 / math.tan(ANGLE / 2)
    found = []
    for number, direction in enumerate(directions @ base):
        rotation = looking(-direction, up)
        place = middle + direction * MARGIN * radius / math.sin(ANGLE / 2)
        found.append(
            Camera(f"{name}/r_{number}", size, size, focal, focal, size / 2, size / 2, rotation, -rotation @ place)
        )
    return found


def transforms(views: list[Camera]) -> dict[str, object]:
    """NeRF's document for cameras: y and z of a camera are those of Blender."""
    frames = []
    for camera in views:
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = camera.rotation.T * (1, -1, -1), camera.centre
        frames.append({"file_path": camera.name, "transform_matrix": matrix.tolist()})
    return {"camera_angle_x": ANGLE, "frames": frames}


def transparent(splats: Splats, camera: Camera, settings: Settings) -> Image.Image:
    """What a camera sees, without a background: RGBA, whose colours are not multiplied by alpha."""
    image, transmittance, _ = drawn(splats, camera, settings)
    alpha = np.rint((1 - transmittance.numpy()[:, :, None]) * 255)
    # Where the splat hides less than half a grade of eight bits, the pixel is empty.
    colour = np.where(alpha > 0, image.numpy() * 255 / np.maximum(alpha, 1), 0)
    return Image.fromarray(np.concatenate([eight_bits(colour), alpha.astype(np.uint8)], axis=2), "RGBA")


def write_scene(splats: Splats, folder: Path, up: F64, views: int, tests: int, size: int) -> None:
    """Writes images and the two files of cameras. Raises OSError."""
    _, radius = middle_and_radius(splats)
    settings = Settings(near_plane=0.01 * radius, background=(0.0, 0.0, 0.0))
    for name, directions in (("train", train_directions(views)), ("test", test_directions(tests))):
        (folder / name).mkdir(parents=True, exist_ok=True)
        found = cameras(splats, directions, up, size, name)
        for camera in found:
            transparent(splats, camera, settings).save(folder / f"{camera.name}.png")
        document = json.dumps(transforms(found), indent=1) + "\n"
        (folder / f"transforms_{name}.json").write_text(document, encoding="utf-8")


def main(words: list[str] | None = None) -> int:
    """Writes a scene. Returns the exit status."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.peers.scene",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("splat", type=Path, help="a PLY file as 3DGS writes it")
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--views", type=int, default=100, help="images to learn from (100)")
    parser.add_argument("--tests", type=int, default=25, help="images for tests (25)")
    parser.add_argument("--size", type=int, default=400, help="sides in pixels (400)")
    parser.add_argument("--up", choices=AXES, default="+z", help="axis that is up (+z); write --up=-y")
    arguments = parser.parse_args(words)
    try:
        if min(arguments.views, arguments.tests, arguments.size) < 1:
            raise ValueError("views, tests and size are 1 or more")
        write_scene(
            read_ply(arguments.splat),
            arguments.output,
            AXES[arguments.up],
            arguments.views,
            arguments.tests,
            arguments.size,
        )
    except (ValueError, OSError) as error:
        print(printable(str(error)), file=sys.stderr)
        return USAGE
    print(f"{arguments.output}: {arguments.views} images to learn from, {arguments.tests} for tests, no points")
    return DONE


if __name__ == "__main__":
    sys.exit(main())
