"""Static scenes beside view-dependent ones and SPZ, as a section of RESULTS.md.

python -m benchmarks.static FOLDER [--write]

FOLDER is the output of `refcodec experiment benchmarks/experiments/static.toml`. The other methods are those of the
section "Peers in one harness, 200 pixels", whose tables are read.
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

HEAD = ["scene", "lambda_r", "seeds", "bytes", "PSNR, dB", "to view-dependent, dB", "SPZ", "times", "processor, s"]
NOTE = (
    "One thread, photographs of 200 pixels. A spread is the standard deviation of the seeds.",
    "",
    "- to view-dependent: the PSNR minus that of view-dependent scenes of as many bytes, in the section of the peers.",
    "- SPZ: the bytes of 3DGS as SPZ at the same PSNR, in that section; none if no SPZ file of the scene has it. Both",
    "  decode to ordinary Gaussians.",
    "",
)


def shown(text: str) -> dict[tuple[str, str], list[Point]]:
    """Returns the points of the peers' section of RESULTS.md, by scene and kind of file, by rising bytes."""
    section = re.search(r"<!-- peers-200: begin -->(.*?)<!-- peers-200: end -->", text, re.DOTALL)
    found: dict[tuple[str, str], list[Point]] = {}
    for name, body in re.findall(r"^### (\w+), .*?\n(.*?)(?=^### |\Z)", section[1] if section else "", re.M | re.S):
        for line in body.splitlines():
            cells = [cell.strip() for cell in line.strip("|").split("|")]
            # A row of a method, without settings of its own.
            kind, _, steps = cells[0].rpartition(", ")
            if len(cells) == 7 and re.fullmatch(r"\d+ steps", steps):
                figures = [_figure(cell) for cell in cells[3:]]
                found.setdefault((name, kind), []).append(Point(float(cells[1]), int(cells[2]), *figures))
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


def rows(static: Iterable[Scene], peers: dict[tuple[str, str], list[Point]]) -> list[list[str]]:
    """Returns the rows of the table. peers: the result of `shown`."""
    found = []
    for scene in static:
        for curve in scene.curves.values():
            for point in curve:
                other = psnr_at(peers.get((scene.name, CODED), []), point.bytes.mean)
                spz = bytes_at(peers.get((scene.name, "3DGS, SPZ"), []), point.psnr.mean)
                found.append(
                    [
                        *(scene.name, f"{point.strength:g}", str(point.seeds)),
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
    parser.add_argument("folder", type=Path)
    parser.add_argument("--write", action="store_true", help="write the section of benchmarks/RESULTS.md")
    options = parser.parse_args(words)
    lines = table(HEAD, rows(scenes(experiment_records(options.folder)), shown(RESULTS.read_text())))
    print("\n".join(lines))
    if options.write:
        trained = "refcodec experiment benchmarks/experiments/static.toml -o FOLDER"
        head = ["```", trained, "python -m benchmarks.static FOLDER --write", "```", "", machine("torch")]
        write_section("static", "Static scenes", [*head, *NOTE, *lines])


if __name__ == "__main__":
    main()
