"""Coding and decoding of splats of many Gaussians, beside SPZ: a section of RESULTS.md.

python -m benchmarks.millions FOLDER SPLAT --up=-y [--copies 1 4 32 160] [--write]

The Gaussians of SPLAT are repeated in their places, each number disturbed by a thousandth of its deviation, in random
order. `refcodec convert --fast` codes them, and Niantic's library (gaussforge of PyPI, if it is installed) writes SPZ.
FOLDER keeps the files: finished commands are not repeated.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from statistics import median

import numpy as np

from refcodec.convert.views import AXES
from refcodec.files.text import printable
from refcodec.formats.common import Options
from refcodec.formats.splats import Splats
from refcodec.formats.table import read_splats, write_splats
from refcodec.rendering.camera import axis_direction
from refcodec.statuses import USAGE, UsageError

from .__main__ import decoding, in_turn
from .converted import made
from .resident import usage
from .results import machine, mib, publish, table

HEAD = ["Gaussians", "file", "bytes", "coding, s", "times SPZ", "MiB", "bytes a Gaussian", "decoding, s", "times SPZ"]
NOTE = (
    "Processor seconds, one thread each. Decoding ends with float32 arrays; medians of three rounds. MiB: the largest",
    "resident memory of coding; bytes a Gaussian: what it is above that of the smallest file. Copies lie over each",
    "other: the more there are, the finer their positions are for equal pictures, and the more bytes each has. SPZ has",
    "one precision. Coding, decoding and memory grow in proportion: 10^8 Gaussians would take 100 minutes and 93 GiB,",
    "and are several files, as tiles, because a file has at most 67,108,864 anchors.",
)
DISTURBED = 0.001
# Prints the processor seconds of SPZ coding, or of decoding, without the start of the process.
SPZ = """
import sys, time, pathlib, gaussforge
forge, data = gaussforge.GaussForge(), pathlib.Path(sys.argv[2]).read_bytes()
start = time.process_time()
if sys.argv[1] == "read":
    forge.read(data, "spz")
else:
    made = forge.convert(data, "ply", "spz", spz_version=4)["data"]
    pathlib.Path(sys.argv[3]).write_bytes(made)
print("seconds", time.process_time() - start)
"""


def many(splats: Splats, copies: int) -> Splats:
    """Returns a number of disturbed copies of some Gaussians, in random order."""
    random = np.random.default_rng(0)
    order, out = random.permutation(copies * len(splats.mean)), {}
    for name, values in vars(splats).items():
        spread = (DISTURBED * values.std(axis=0)).astype(np.float32)
        more = np.tile(values, (copies, *[1] * (values.ndim - 1)))
        out[name] = (more + spread * random.standard_normal(more.shape, np.float32))[order]
    return Splats(**out)


def spz(way: str, *paths: Path) -> float | None:
    """Returns the processor seconds of Niantic's library, None without it."""
    spent = usage([sys.executable, "-c", SPZ, way, *map(str, paths)])
    own = [line.split()[1] for line in spent.printed.splitlines() if line.startswith("seconds ")]
    return float(own[0]) if own else None


def section(splats: Splats, name: str, up: str, copies: list[int], folder: Path) -> list[str]:
    """Returns the lines of the table. Raises UsageError and OSError."""
    folder.mkdir(parents=True, exist_ok=True)
    rows, least = list[list[str]](), (0, 0.0)
    for number in copies:
        count, plain = number * len(splats.mean), (folder / f"{name}-{number}.ply").absolute()
        if not plain.exists():
            plain.write_bytes(write_splats(many(splats, number), ".ply", Options(axis_direction(0))))
        own, other = plain.with_suffix(".c3gs"), plain.with_suffix(".spz")
        took = made(["convert", str(plain), "-o", str(own), "--fast", f"--up={up}"], own)
        runs = in_turn({"own": decoding("whole", own)}, 3)["own"]
        spent = took["processor"], median(run["processor"] for _, run in runs)
        theirs = spz("write", plain, other), spz("read", other)
        least = least if rows else (count, took["peak"])
        more = f"{(took['peak'] - least[1]) / (count - least[0]):,.0f}" if rows else ""
        times = [f"{a / b:.1f}" if b else "" for a, b in zip(spent, theirs, strict=True)]
        cells = [f"{spent[0]:.1f}", times[0], mib(took["peak"]), more, f"{spent[1]:.2f}", times[1]]
        rows.append([f"{count:,}", "--fast", f"{own.stat().st_size:,}", *cells])
        if theirs[0] and theirs[1]:
            cells = [f"{theirs[0]:.1f}", "1.0", "", "", f"{theirs[1]:.2f}", "1.0"]
            rows.append([f"{count:,}", "SPZ 4", f"{other.stat().st_size:,}", *cells])
    return table(HEAD, rows)


def main(words: list[str] | None = None) -> int:
    """Runs the command line. Returns the exit status."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.millions", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("splat", type=Path)
    parser.add_argument("--up", choices=AXES, default="-y", help="axis that is up (-y); write --up=-y")
    parser.add_argument("--copies", type=int, nargs="+", default=[1, 4, 32, 160])
    parser.add_argument("--write", action="store_true", help="write the section of benchmarks/RESULTS.md")
    options = parser.parse_args(words)
    try:
        name = options.splat.name.partition(".")[0]
        lines = section(read_splats(options.splat), name, options.up, options.copies, options.folder)
    except (UsageError, ValueError, OSError) as error:
        print(printable(str(error), lines=True), file=sys.stderr)
        return USAGE
    command = f"`python -m benchmarks.millions FOLDER {options.splat.name} --up={options.up}`"
    head = [command, "", machine("torch"), *NOTE, "", *lines]
    return publish("millions", "Splats of many Gaussians", head, options.write)


if __name__ == "__main__":
    sys.exit(main())
