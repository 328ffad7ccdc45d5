"""Coding and decoding of splats of many Gaussians, beside SPZ.

python -m benchmarks millions FOLDER SPLAT --up=-y [--copies 1 4 32 160] [--write]

The Gaussians of SPLAT are repeated in their places, each number disturbed by a thousandth of its deviation, in random
order. `refcodec convert --fast` codes them, and Niantic's library (gaussforge of PyPI, if it is installed) writes SPZ.
FOLDER keeps the files: finished commands are not repeated.
"""

import sys
from argparse import Namespace
from pathlib import Path
from statistics import median

import numpy as np

from refcodec.formats.common import Options
from refcodec.formats.splats import Splats
from refcodec.formats.table import read_splats, write_splats
from refcodec.rendering.camera import axis_direction

from .converted import UP, made
from .decoders import decoding, in_turn
from .resident import usage
from .results import Arguments, machine, mib, table

OPTIONS: Arguments = {
    "folder": {"type": Path},
    "splat": {"type": Path},
    "--up": UP,
    "--copies": {"type": int, "nargs": "+", "default": [1, 4, 32, 160]},
}
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


def section(options: Namespace) -> list[str]:
    """Returns the lines of the section. Raises UsageError, ValueError and OSError."""
    splats, name, folder = read_splats(options.splat), options.splat.name.partition(".")[0], options.folder
    folder.mkdir(parents=True, exist_ok=True)
    rows, least = list[list[str]](), (0, 0.0)
    for number in options.copies:
        count, plain = number * len(splats.mean), (folder / f"{name}-{number}.ply").absolute()
        if not plain.exists():
            plain.write_bytes(write_splats(many(splats, number), ".ply", Options(axis_direction(0))))
        own, other = plain.with_suffix(".c3gs"), plain.with_suffix(".spz")
        took = made(["convert", str(plain), "-o", str(own), "--fast", f"--up={options.up}"], own)
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
    command = f"`python -m benchmarks millions FOLDER {options.splat.name} --up={options.up}`"
    return [command, "", machine("torch"), *NOTE, "", *table(HEAD, rows)]
