"""Cold starts of commands: processor time, wall time and memory of inspect, validate and decode.

python -m benchmarks.commands [--anchors 421600] [--rounds 9]

It writes a section of RESULTS.md. The anchors of the large scene are drawn at random from a trained scene.
"""

from __future__ import annotations

import argparse
import os
import resource
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from statistics import median

import numpy as np

from refcodec.bitstream.codec import emit, parse
from refcodec.bitstream.scene import take_anchors

from .resident import measured
from .results import machine, table, write_section

ROOT = Path(__file__).resolve().parent.parent
TINY, TRAINED = ROOT / "vectors" / "tiny-example.c3gs", ROOT / "vectors" / "valid" / "trained-snowmiku.c3gs"
COMMANDS = {"inspect": [], "validate": [], "decode": ["-o", "OUT"], "decode --chunks 5:6": ["-o", "OUT"]}
# The first run writes the bytecode, which an installed program has already.
ENVIRONMENT = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}


def large(path: Path, anchors: int) -> int:
    """Writes a file with a number of anchors of a trained scene. Returns its length in bytes."""
    scene = parse(TRAINED.read_bytes()).scene
    rows = np.random.default_rng(1).integers(0, scene.anchor_count, anchors)
    path.write_bytes(emit(replace(take_anchors(scene, rows), position_model=None)))
    return path.stat().st_size


def words(command: str, file: Path, folder: Path) -> list[str]:
    """Returns the arguments of a command."""
    name, *options = command.split()
    options += [str(folder / "out") if word == "OUT" else word for word in COMMANDS[command]]
    return [name, str(file), *options]


def cost(arguments: list[str]) -> tuple[float, float]:
    """Returns the processor seconds and wall seconds of a process."""
    before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    command = [sys.executable, "-m", "refcodec", *arguments]
    subprocess.run(command, cwd=ROOT, env=ENVIRONMENT, stdout=subprocess.DEVNULL, check=True)
    wall, after = time.perf_counter() - start, resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, wall


def memory(arguments: list[str]) -> int:
    """Returns the peak resident memory of a process, in bytes. Raises ValueError if the command fails."""
    status, most = measured(arguments, ENVIRONMENT)
    if status:
        raise ValueError(f"{' '.join(arguments)} ends with {status}")
    return most


def section(anchors: int, rounds: int) -> list[str]:
    """Returns the lines of the section."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        length = large(folder / "large.c3gs", anchors)
        files = {"Tiny": (TINY, rounds), f"{anchors:,} anchors": (folder / "large.c3gs", max(1, rounds // 3))}
        runs = [(c, f) for f in files for c in COMMANDS if f != "Tiny" or "--chunks" not in c]
        found: dict[tuple[str, str], list[tuple[float, float]]] = {run: [] for run in runs}
        for command, file in runs:
            cost(words(command, files[file][0], folder))
        # The runs are interleaved, so that the machine's load affects all alike.
        for turn in range(rounds):
            for command, file in runs:
                if turn < files[file][1]:
                    found[command, file].append(cost(words(command, files[file][0], folder)))
        rows = []
        for (command, file), times in found.items():
            most = memory(words(command, files[file][0], folder)) / (1 << 20)
            processor, wall = (median(values) for values in zip(*times, strict=True))
            rows.append([f"`{command}`", file, f"{processor:.2f}", f"{wall:.2f}", f"{most:.0f}"])
    head = ["command", "file", "processor s", "wall s", "resident MiB"]
    return [
        f"`python -m benchmarks.commands --anchors {anchors} --rounds {rounds}`",
        "",
        machine(),
        f"Medians of {rounds} processes, or of {max(1, rounds // 3)} with the large file, which has {length:,} bytes.",
        "",
        *table(head, rows),
    ]


def main() -> None:
    """Runs the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--anchors", type=int, default=421_600)
    parser.add_argument("--rounds", type=int, default=9)
    options = parser.parse_args()
    write_section("commands", "Cold starts of commands", section(options.anchors, options.rounds))


if __name__ == "__main__":
    main()
