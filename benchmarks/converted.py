"""Splats coded by convert --fast, compared with SPZ and SOG at equal quality.

python -m benchmarks converted FOLDER SPLATS ... --up=-y [--fast 36 40 43 46 50 55] [--write]

`refcodec convert --fast` codes each file of SPLATS at several qualities. refcodec, Niantic's library (by gaussforge of
PyPI, if it is installed) and splat-transform (if it is) write SPZ and SOG. Cameras at random places around the splats,
near their surfaces and inside, which no encoder has seen, compare renderings of all files with those of SPLATS. FOLDER
keeps the files: finished commands are not repeated.
"""

import importlib
import json
import math
import sys
from argparse import Namespace
from collections.abc import Sequence
from functools import cached_property
from pathlib import Path
from statistics import fmean

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from refcodec.bitstream.codec import parse
from refcodec.convert.views import ANGLE, AXES, middle_and_radius, near_plane
from refcodec.formats.common import Options
from refcodec.formats.splats import Splats
from refcodec.formats.table import read_splats, write_splats
from refcodec.rendering.camera import Camera, axis_direction, looking
from refcodec.rendering.gaussians import static_splats
from refcodec.rendering.rasterise import Settings, draw
from refcodec.statuses import DONE, UsageError

from .peers.convert import VERSION, as_read, convert, tool
from .resident import usage
from .results import Arguments, bytes_at, machine, mib, table

OPTIONS: Arguments = {
    "folder": {"type": Path},
    "splats": {"type": Path, "nargs": "+"},
    "--up": {"choices": AXES, "default": "-y", "help": "axis that is up (-y); write --up=-y"},
    "--each": {"type": int, "default": 8, "help": "cameras of each kind that judge (8)"},
    "--fast": {"type": float, "nargs": "+", "default": [36, 40, 43, 46, 50, 55], "metavar": "DB", "help": "qualities"},
}
KINDS = ("around", "near", "inside")
HEAD = ["of", "by", "bytes", *KINDS, "PSNR, dB", "the worst", "--fast, bytes", "times", "processor, s", "MiB"]
NOTE = (
    "PSNR: the means of eight-bit renderings, each compared with that of the splat file: from random places around,",
    "near surfaces and inside, half of them 400 and half 900 pixels wide, which no encoder has measured. --fast,",
    "bytes: those of --fast at equal PSNR, interpolated; times: the bytes of the file relative to these. One thread",
    "each.",
)
# The least share of a picture that Gaussians cover, and how far from solid ones a camera stands, in radii.
COVERED, CLEAR = 0.3, 0.02
# The largest PSNR of a picture that counts: of equal pictures it is infinite.
MOST = 60.0


def looks(splats: Splats, up: NDArray[np.float64], each: int, settings: Settings) -> dict[str, list[Camera]]:
    """Returns cameras at random places, by KINDS. each: how many of each kind. up: float64 [3]."""
    random, (middle, radius) = np.random.default_rng(20), middle_and_radius(splats)
    mean = splats.mean.astype(np.float64)
    core = np.linalg.norm(mean - middle, axis=1) <= radius
    opacity, area = 1 / (1 + np.exp(-splats.opacity)), np.exp(splats.scale.astype(np.float64)).max(axis=1) ** 2
    share = core * opacity * np.minimum(area, (0.05 * radius) ** 2)
    solid = mean[core & (opacity >= min(0.3, opacity[core].max()))]
    tree, (low, high) = KDTree(solid), np.quantile(solid, (0.1, 0.9), axis=0)
    made: dict[str, list[Camera]] = {kind: [] for kind in KINDS}
    for kind, number in ((kind, number) for kind in KINDS for number in range(each)):
        for _ in range(200):
            direction = random.normal(size=3)
            direction -= (0.5 if kind == "inside" else 0.2) * (direction @ up) * up
            direction /= np.linalg.norm(direction)
            place = middle - direction * radius * random.uniform(1, 2) / math.sin(ANGLE / 2)
            if kind == "near":
                target = mean[random.choice(len(mean), p=share / share.sum())]
                place = target - direction * radius * math.exp(random.uniform(math.log(0.1), math.log(0.8)))
            if kind == "inside":
                place = random.uniform(low, high)
            side = 400 if number % 2 else 900
            small, camera = (
                Camera(f"{kind}_{number}", w, w, f, f, w / 2, w / 2, turned, -turned @ place)
                for w, turned in ((64, looking(direction, up)), (side, looking(direction, up)))
                for f in [w / 2 / math.tan(ANGLE / 2)]
            )
            covered = 1 - draw(splats, small, settings).transmittance.mean()
            if tree.query(place)[0] >= CLEAR * radius and covered >= (COVERED if kind != "around" else 0.01):
                break
        made[kind].append(camera)
    return made


class Source:
    """A splat file, the cameras that judge its codings, and its pictures."""

    def __init__(self, file: Path, up: str, each: int) -> None:
        """up: its upward axis, of AXES. each: cameras of a kind. Raises ValueError and OSError."""
        self.file, self.up, self.splats = file, up, read_splats(file)
        self.name = file.name.removesuffix(file.suffix).removesuffix(".compressed")
        self.settings = Settings(near_plane=near_plane(self.splats))
        self.cameras = looks(self.splats, AXES[up], each, self.settings)

    def pictures(self, splats: Splats, kind: str) -> list[NDArray[np.float32]]:
        """Returns the pictures of Gaussians from the cameras of a kind, as eight bits show them."""
        images = (draw(splats, camera, self.settings).image for camera in self.cameras[kind])
        return [(np.rint(image.clip(0, 1) * 255) / 255).astype(np.float32) for image in images]

    @cached_property
    def truth(self) -> dict[str, list[NDArray[np.float32]]]:
        """The pictures of the file itself, by kind."""
        return {kind: self.pictures(self.splats, kind) for kind in KINDS}

    def measured(self, splats: Splats) -> dict[str, list[float]]:
        """Returns the PSNR of each picture of coded Gaussians, in dB, by kind."""
        pairs = {kind: zip(self.pictures(splats, kind), self.truth[kind], strict=True) for kind in KINDS}
        least = 10 ** (-MOST / 10)
        return {
            kind: [float(-10 * np.log10(max(np.square(a - b).mean(), least))) for a, b in own]
            for kind, own in pairs.items()
        }

    def row(self, by: str, size: int, splats: Splats) -> tuple[float, list[str]]:
        """Returns the PSNR of coded Gaussians, and the first cells of their row."""
        each = self.measured(splats)
        kinds, worst = [fmean(values) for values in each.values()], min(min(values) for values in each.values())
        figures = (f"{value:.2f}" for value in (*kinds, fmean(kinds), worst))
        return fmean(kinds), [self.name, by, f"{size:,}", *figures]


def made(command: Sequence[str], output: Path) -> dict[str, float]:
    """Runs refcodec, if it has not made the output before. Returns what it took. Raises UsageError."""
    note = output.with_suffix(".json")
    if not (note.exists() and output.exists()):
        spent = usage(
            [sys.executable, "-m", "refcodec", *command], dict.fromkeys(("OMP_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")
        )
        if spent.status != DONE:
            raise UsageError(f"refcodec {' '.join(command)}: exit status {spent.status}")
        note.write_text(json.dumps({"processor": spent.processor, "peak": spent.peak}))
    took: dict[str, float] = json.loads(note.read_text())
    return took


def others(source: Source, folder: Path) -> dict[str, tuple[int, Splats]]:
    """Returns the bytes and the Gaussians of the files of other formats, by their writers. Raises ToolError."""
    found, stem = dict[str, tuple[int, Splats]](), folder / source.name
    plain = Path(f"{stem}-plain.ply")
    plain.write_bytes(write_splats(source.splats, ".ply", Options(axis_direction(0))))
    own = Path(f"{stem}-own.spz")
    own.write_bytes(write_splats(source.splats, ".spz", Options(axis_direction(0))))
    found["refcodec, SPZ"] = own.stat().st_size, read_splats(own)
    try:
        forge = importlib.import_module("gaussforge").GaussForge()
    except ImportError:
        print("gaussforge is missing: no row of Niantic's SPZ 4", file=sys.stderr)
    else:
        # It keeps the axes of PLY files, as splat-transform does.
        coded = Path(f"{stem}-niantic.spz")
        coded.write_bytes(forge.convert(plain.read_bytes(), "ply", "spz", spz_version=4)["data"])
        found["Niantic's library, SPZ 4"] = coded.stat().st_size, as_read(read_splats(coded), ".spz")
    if tool() is None:
        print("splat-transform is missing: no row of its SOG", file=sys.stderr)
    else:
        sog, again = Path(f"{stem}-tool.sog"), Path(f"{stem}-tool.sog.ply")
        if not again.exists():
            convert(plain, sog)
            convert(sog, again)
        found[f"splat-transform {VERSION}, SOG"] = sog.stat().st_size, read_splats(again)
    return found


def section(options: Namespace) -> list[str]:
    """Returns the lines of the section. Raises ToolError, UsageError, ValueError and OSError."""
    folder, sources = options.folder, [Source(file, options.up, options.each) for file in options.splats]
    folder.mkdir(parents=True, exist_ok=True)
    rows = list[list[str]]()
    for source in sources:
        curve = list[tuple[float, float]]()
        rows.append([source.name, f"{len(source.splats.mean):,} Gaussians", f"{source.file.stat().st_size:,}"])
        rows[-1] += [""] * (len(HEAD) - 3)
        for wanted in options.fast:
            output = (folder / f"{source.name}-fast-{wanted:g}.c3gs").absolute()
            words = ["convert", str(source.file.absolute()), "-o", str(output), "--fast", f"--up={source.up}"]
            took = made([*words, "--psnr", f"{wanted:g}"], output)
            size, splats = output.stat().st_size, static_splats(parse(output.read_bytes()).scene)
            reached, figures = source.row(f"--fast --psnr {wanted:g}", size, splats)
            curve.append((size, reached))
            rows.append([*figures, "", "", f"{took['processor']:.0f}", mib(took["peak"])])
        for by, (size, splats) in others(source, folder.absolute()).items():
            reached, figures = source.row(by, size, splats)
            own = bytes_at(sorted(curve), reached)
            rows.append([*figures, *([f"{own:,.0f}", f"{size / own:.2f}"] if own else ["", ""]), "", ""])
    files = " ".join(source.file.name for source in sources)
    command = f"`python -m benchmarks converted FOLDER {files} --up={options.up}`"
    return [command, "", machine("torch"), *NOTE, "", *table(HEAD, rows)]
