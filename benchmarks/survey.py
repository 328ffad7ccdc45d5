"""Rows of an experiment for the survey of 3DGS compression (https://w-m.github.io/3dgs-compression-survey/).

python -m benchmarks.survey FOLDER MipNeRF360=bicycle,bonsai,... -o OUT

FOLDER is the output of `refcodec experiment`. Each data set gets OUT/NAME.csv with the columns of the survey's results:
a row for each method and rate that has all its scenes, with means over seeds, then over scenes. PSNR and SSIM are those
of 3DGS's code, of float images. LPIPS is empty: no weights of its network come with the project. The number of
Gaussians is that of anchors, as the survey has it for this family.
"""

from __future__ import annotations

import argparse
import csv
import io
import statistics
import sys
from collections import defaultdict
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from refcodec.files.stage import write_file
from refcodec.statuses import DONE, USAGE

from .peers.cells import USUAL, results

HEAD = ("Method", "Submethod", "PSNR", "SSIM", "LPIPS", "Size [Bytes]", "#Gaussians", "Data Source", "Comment")
SOURCE = "refcodec experiment"

# Scene, method and result of a cell.
Cell = tuple[str, str, dict[str, Any]]


def rows(found: Iterable[Cell], scenes: Iterable[str]) -> list[tuple[str, ...]]:
    """Returns the survey's rows of a data set, by method, and by rate from the highest to the lowest."""
    wanted = set(scenes)
    groups: dict[tuple[str, float], dict[str, list[tuple[float, ...]]]] = defaultdict(lambda: defaultdict(list))
    for scene, method, result in found:
        rate, mean = result["definition"]["settings"]["rate"]["lambda_r"], result["mean"]
        if scene in wanted and rate:
            values = mean["psnr_3dgs"], mean["ssim_3dgs"], result["bytes"], result["anchors"]
            groups[method, -rate][scene].append(values)
    made: list[tuple[str, ...]] = []
    for (method, rate), by_scene in sorted(groups.items()):
        if set(by_scene) != wanted:
            continue
        psnr, ssim, size, anchors = _means(map(_means, by_scene.values()))
        name = "c3gs" if method in USUAL else f"c3gs-{method}"
        seeds = min(map(len, by_scene.values()))
        figures = (f"{psnr:.2f}", f"{ssim:.3f}", "", f"{size:.0f}", f"{anchors:.1f}")
        made.append((name, f"-rate-{-rate:g}", *figures, SOURCE, f"{len(wanted)} scenes, {seeds} seeds or more"))
    return made


def _means(rows: Iterable[tuple[float, ...]]) -> tuple[float, ...]:
    return tuple(map(statistics.fmean, zip(*rows, strict=True)))


def main(arguments: list[str]) -> int:
    """Runs the command; returns its exit status."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.survey", description="Rows for the survey.")
    parser.add_argument("folder", type=Path)
    parser.add_argument("data_sets", nargs="+", metavar="NAME=SCENE,...")
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="OUT")
    chosen = parser.parse_args(arguments)
    found = list(results(chosen.folder))
    for text in chosen.data_sets:
        name, _, scenes = text.partition("=")
        made = rows(found, filter(None, scenes.split(",")))
        if not made:
            print(f"{name}: no method and rate has all of its scenes", file=sys.stderr)
            return USAGE
        out = io.StringIO()
        csv.writer(out, lineterminator="\n").writerows([HEAD, *made])
        chosen.output.mkdir(parents=True, exist_ok=True)
        write_file(chosen.output / f"{name}.csv", out.getvalue().encode())
        print(f"{chosen.output / f'{name}.csv'}: {len(made)} rows")
    return DONE


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
