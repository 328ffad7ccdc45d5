"""Converts PLY to SPZ and SOG and back with PlayCanvas's splat-transform, a program for Node.js (MIT licence).

Both formats are complex: SPZ compresses with zstd, and SOG clusters the harmonics and packs images with WebP. Therefore
a widely used program writes them. INSTALL installs it. Nothing here downloads.
"""

import shutil
import subprocess
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from refcodec.formats.splats import Splats
from refcodec.formats.spz import HARMONIC_SIGNS
from refcodec.statuses import UsageError

from ..results import ROOT

# In a folder that Git ignores. The version is fixed, because files differ between versions.
FOLDER, VERSION = "build/splat-transform", "3.7.0"
# The scripts of its packages would install a GPU driver, which is not used.
INSTALL = f"npm install --ignore-scripts --no-audit --prefix {FOLDER} @playcanvas/splat-transform@{VERSION}"
FORMATS = ("spz", "sog")


class ToolError(UsageError):
    """A program is missing or failed. The message has the remedy, or the output of the program."""


def ran(command: Sequence[str | Path], folder: Path | None = None, made: Path | None = None) -> str:
    """Returns the output of a program. made: a file that it must make. Raises ToolError."""
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    if done.returncode or (made and not made.is_file()):
        raise ToolError(f"{' '.join(map(str, command))} failed: {(done.stderr or done.stdout).strip()[-500:]}")
    return done.stdout


def tool() -> Path | None:
    """Returns the path of splat-transform, in FOLDER or on the PATH, or None."""
    own = ROOT / FOLDER / "node_modules" / ".bin" / "splat-transform"
    there = shutil.which("splat-transform")
    return own if own.exists() else Path(there) if there else None


def convert(source: Path, target: Path) -> None:
    """Converts between PLY, SPZ and SOG by the files' suffixes, without a GPU. Raises ToolError."""
    program = tool()
    if program is None:
        raise ToolError(f"splat-transform is missing: run `{INSTALL}` in the repository's folder")
    ran([program, "-q", "-w", "-g", "cpu", "--max-workers", "0", source, target], made=target)


def there_and_back(ply: Path, suffix: str) -> tuple[Path, Path]:
    """Converts a PLY file to another format, and back to PLY. Returns both new files. Raises ToolError."""
    coded, again = ply.with_suffix(f".{suffix}"), ply.with_name(f"{ply.stem}.{suffix}.ply")
    convert(ply, coded)
    convert(coded, again)
    return coded, again


def as_read(splats: Splats, suffix: str) -> Splats:
    """Returns the Gaussians that splat-transform reads from a file of Gaussians.

    SPZ files have axes that point right, up and back (Niantic's README). splat-transform 3 takes them for those of PLY
    files, which point right, down and forward. Thus its y and z have the other signs.
    """
    if suffix != ".spz":
        return splats
    signs = np.array([1, -1, -1], np.float32)
    rest = splats.rest * HARMONIC_SIGNS[: splats.rest.shape[1], None].astype(np.float32)
    return replace(splats, mean=splats.mean * signs, quaternion=splats.quaternion * np.append(1, signs), rest=rest)
