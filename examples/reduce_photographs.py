"""Reduces a COLMAP folder to a small one, such as those in examples/photographs.

python examples/reduce_photographs.py SOURCE TARGET --size 400x300 [--quality 90] [--points 25000]

Images are undistorted, averaged down and written as JPEG without metadata. Cameras are PINHOLE. The given number of
points is kept at random (seed 0), without tracks. The result is reproducible with the same versions of numpy, scipy and
Pillow.
"""

import argparse
import sys
from pathlib import Path

import numpy as np
from PIL import Image
from scipy.spatial.transform import Rotation
from tqdm import tqdm

from refcodec.photographs.photographs import Camera, PhotographError, PhotographSet, parse_size, read_photographs


def target_name(camera: Camera) -> str:
    return f"{camera.name.rpartition('.')[0] or camera.name}.jpg"


def write_model(photographs: PhotographSet, folder: Path, kept: int) -> None:
    """Writes the text files of COLMAP. Cameras that agree to 9 digits are merged."""
    folder.mkdir(parents=True, exist_ok=True)
    lenses: dict[str, int] = {}
    images = ["# IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME, then a line of 2D points: left out"]
    for number, photograph in enumerate(
        sorted((*photographs.train, *photographs.test), key=lambda p: p.camera.name), 1
    ):
        c = photograph.camera
        lens = f"PINHOLE {c.width} {c.height} " + " ".join(f"{v:.9g}" for v in (c.fx, c.fy, c.cx, c.cy))
        x, y, z, w = Rotation.from_matrix(c.rotation).as_quat(canonical=True)
        pose = " ".join(f"{v:.12g}" for v in (w, x, y, z, *c.translation))
        images += [f"{number} {pose} {lenses.setdefault(lens, len(lenses) + 1)} {target_name(c)}", ""]
    cameras = ["# CAMERA_ID MODEL WIDTH HEIGHT FX FY CX CY", *(f"{number} {lens}" for lens, number in lenses.items())]
    chosen = np.arange(len(photographs.points))
    if kept < len(chosen):
        chosen = np.sort(np.random.default_rng(0).choice(chosen, kept, replace=False))
    rows = zip(photographs.points[chosen].tolist(), photographs.colours[chosen].tolist(), strict=True)
    points = [
        "# POINT3D_ID X Y Z R G B ERROR: -1, not kept; tracks: left out",
        *(f"{i} {x:.6g} {y:.6g} {z:.6g} {r} {g} {b} -1" for i, ((x, y, z), (r, g, b)) in enumerate(rows, 1)),
    ]
    for name, lines in (("cameras", cameras), ("images", images), ("points3D", points)):
        (folder / f"{name}.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("source", type=Path)
    parser.add_argument("target", type=Path)
    parser.add_argument("--size", required=True, help="WIDTHxHEIGHT, or the longest side")
    parser.add_argument("--quality", type=int, default=90, help="quality of the JPEG files, 1 to 95")
    parser.add_argument("--points", type=int, default=25000, help="maximum number of points to keep")
    args = parser.parse_args()
    if args.target.exists():
        parser.error(f"{args.target} exists: choose another folder, or remove it")
    try:
        photographs = read_photographs(args.source, parse_size(args.size))
        for photograph in tqdm((*photographs.train, *photographs.test), unit="image"):
            file = args.target / "images" / target_name(photograph.camera)
            file.parent.mkdir(parents=True, exist_ok=True)
            Image.fromarray(photograph.load(photograph.background)).save(file, quality=args.quality, optimize=True)
    except PhotographError as error:
        print(error, file=sys.stderr)
        return 1
    write_model(photographs, args.target / "sparse" / "0", args.points)
    print(
        len(photographs.train), "for training,", len(photographs.test), "held out,", photographs.skipped, "without pose"
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
