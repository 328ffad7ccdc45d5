"""Static scenes beside view-dependent ones and SPZ, as a section of RESULTS.md.

python -m benchmarks.static FOLDER... [--write]

FOLDER is the output of `refcodec experiment` for benchmarks/experiments/static.toml or static-larger.toml. The other
methods are those of the sections "Peers in one harness", whose tables are read.
"""

from __future__ import annotations

import argparse
import math
import re
from collections.abc import Iterable, Sequence
from itertools import pairwise
from pathlib import Path

from .peers.cells import CODED, experiment_records
from .peers.figures import Figure, Point, Scene, bytes_at, scenes
from .results import RESULTS, machine, table, write_section

HEAD = [
    "scene",
    "pixels",
    "lambda_r",
    "seeds",
    "bytes",
    "PSNR, dB",
    "to view-dependent, dB",
    "SPZ",
    "times",
    "processor, s",
]
NOTE = (
    "One thread. A spread is the standard deviation of the seeds.",
    "",
    "- to view-dependent: the PSNR minus that of view-dependent scenes of as many bytes, in the sections of the peers.",
    "- SPZ: the bytes of 3DGS as SPZ at the same PSNR, in these sections; none outside the PSNR of the SPZ files.",
    "  Both decode to ordinary Gaussians.",
    "",
)


def shown(text: str) -> dict[tuple[str, int, str], list[Point]]:
    """Returns the points of the peers' sections of RESULTS.md, by scene, size and kind of file, by rising bytes."""
    sections = re.findall(r"<!-- peers-\d+: begin -->(.*?)<!-- peers-\d+: end -->", text, re.DOTALL)
    found: dict[tuple[str, int, str], list[Point]] = {}
    heads = r"^### (\w+), (\d+) pixels\n(.*?)(?=^### |\Z)"
    for name, size, body in re.findall(heads, "\n".join(sections), re.MULTILINE | re.DOTALL):
        for line in body.splitlines():
            cells = [cell.strip() for cell in line.strip("|").split("|")]
            # A row of a method, without settings of its own.
            kind, _, steps = cells[0].rpartition(", ")
            if len(cells) == 7 and re.fullmatch(r"\d+ steps", steps):
                figures = [_figure(cell) for cell in cells[3:]]
                found.setdefault((name, int(size), kind), []).append(Point(float(cells[1]), int(cells[2]), *figures))
    return {key: sorted(curve, key=lambda point: point.bytes.mean) for key, curve in found.items()}


def _figure(cell: str) -> Figure:
    mean, _, spread = cell.replace(",", "").partition(" ± ")
    return Figure(float(mean), float(spread) if spread else None)


def psnr_at(curve: Sequence[Point], size: float) -> float | None:
    """Returns the PSNR of a method at a size in bytes, by linear interpolation over their logarithm, or None."""
    for one, two in pairwise(curve):
        low, high = one.bytes.mean, two.bytes.mean
        if low <= size <= high:
            share = math.log(size / low) / math.log(high / low)
            return (1 - share) * one.psnr.mean + share * two.psnr.mean
    return None


def rows(static: Iterable[Scene], peers: dict[tuple[str, int, str], list[Point]]) -> list[list[str]]:
    """Returns the rows of the table. peers: the result of `shown`."""
    found = []
    for scene in static:
        for curve in scene.curves.values():
            for point in curve:
                other = psnr_at(peers.get((scene.name, scene.size, CODED), []), point.bytes.mean)
                spz = bytes_at(peers.get((scene.name, scene.size, "3DGS, SPZ"), []), point.psnr.mean)
                found.append(
                    [
                        *(scene.name, str(scene.size), f"{point.strength:g}", str(point.seeds)),
                        *(point.bytes.words(0), point.psnr.words(2)),
                        "" if other is None else f"{point.psnr.mean - other:+.2f}",
                        *(["", ""] if spz is None else [f"{spz:,.0f}", f"{spz / point.bytes.mean:.1f}"]),
                        point.seconds.words(0),
                    ]
                )
    return found


def main(words: list[str] | None = None) -> None:
    """Runs the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", nargs="+", type=Path)
    parser.add_argument("--write", action="store_true", help="write the section of benchmarks/RESULTS.md")
    options = parser.parse_args(words)
    records = [record for folder in options.folder for record in experiment_records(folder)]
    lines = table(HEAD, rows(scenes(records), shown(RESULTS.read_text())))
    print("\n".join(lines))
    if options.write:
        plans = {"static.toml": "FOLDER", "static-larger.toml": "LARGER"}
        trained = [f"refcodec experiment benchmarks/experiments/{plan} -o {folder}" for plan, folder in plans.items()]
        head = ["```", *trained, "python -m benchmarks.static FOLDER LARGER --write", "```", "", machine("torch")]
        write_section("static", "Static scenes", [*head, *NOTE, *lines])


if __name__ == "__main__":
    main()
