"""SPZ and SOG of a PLY file and back, by PlayCanvas's splat-transform, a program for Node.js (MIT licence).

Both formats are more than a page: SPZ packs with zstd, and SOG clusters the harmonics and packs images with WebP. So
the program that people use writes them. INSTALL installs it. Nothing here downloads.
"""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent.parent
# Below a folder that git ignores. The version is fixed, because files differ in their bytes from one to the next.
FOLDER, VERSION = "build/splat-transform", "2.7.1"
# Without scripts, which would install a driver for GPUs that is not used.
INSTALL = f"npm install --ignore-scripts --no-audit --prefix {FOLDER} @playcanvas/splat-transform@{VERSION}"
FORMATS = ("spz", "sog")


class ToolError(Exception):
    """splat-transform is missing or failed. The text says what to do, or what it said."""


def tool() -> Path | None:
    """Where splat-transform is: below FOLDER, or else on the PATH; None if it is nowhere."""
    own = ROOT / FOLDER / "node_modules" / ".bin" / "splat-transform"
    if own.exists():
        return own
    found = shutil.which("splat-transform")
    return Path(found) if found else None


def convert(source: Path, target: Path) -> None:
    """Converts between PLY, SPZ and SOG by the files' suffixes, on the processor. Raises ToolError."""
    program = tool()
    if program is None:
        raise ToolError(f"splat-transform is missing: run `{INSTALL}` in the repository's folder")
    command = [str(program), "-q", "-w", "-g", "cpu", "--max-workers", "0", str(source), str(target)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode or not target.is_file():
        raise ToolError(f"{' '.join(command)} failed: {(done.stderr or done.stdout).strip()[-500:]}")


def there_and_back(ply: Path, suffix: str) -> tuple[Path, Path]:
    """Writes a PLY file in another format, and that as PLY again. Returns both new files. Raises ToolError."""
    coded = ply.with_suffix(f".{suffix}")
    again = ply.with_name(f"{ply.stem}.{suffix}.ply")
    convert(ply, coded)
    convert(coded, again)
    return coded, again
