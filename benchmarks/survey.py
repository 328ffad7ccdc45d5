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

from refcodec.experiments.cells import read_result
from refcodec.files.stage import write_file
from refcodec.statuses import DONE, USAGE

HEAD = ("Method", "Submethod", "PSNR", "SSIM", "LPIPS", "Size [Bytes]", "#Gaussians", "Data Source", "Comment")
SOURCE = "refcodec experiment"

# Scene, method, rate and result of a cell.
Cell = tuple[str, str, float, dict[str, Any]]


def cells(folder: Path) -> list[Cell]:
    """Returns the complete cells of coded scenes in an output folder of `refcodec experiment`."""
    found = []
    for place in sorted(folder.glob("cells/*/*/rate-*/seed-*")):
        result = read_result(place)
        if result is not None and (rate := result["definition"]["settings"]["rate"]["weight"]):
            found.append((place.parents[2].name, place.parents[1].name, rate, result))
    return found


def rows(found: Iterable[Cell], scenes: Iterable[str]) -> list[tuple[str, ...]]:
    """Returns the survey's rows of a data set, by method, and by rate from the highest to the lowest."""
    wanted = set(scenes)
    groups: dict[tuple[str, float], dict[str, list[dict[str, Any]]]] = defaultdict(lambda: defaultdict(list))
    for scene, method, rate, result in found:
        if scene in wanted:
            groups[method, -rate][scene].append(result)
    made = []
    for (method, rate), by_scene in sorted(groups.items()):
        if set(by_scene) != wanted:
            continue
        values = [
            [result["mean"]["psnr_3dgs"], result["mean"]["ssim_3dgs"], result["bytes"], result["anchors"]]
            for results in by_scene.values()
            for result in [_mean(results)]
        ]
        psnr, ssim, size, anchors = map(statistics.fmean, zip(*values, strict=True))
        name = "c3gs" if method == "pro" else f"c3gs-{method}"
        seeds = min(map(len, by_scene.values()))
        figures = (f"{psnr:.2f}", f"{ssim:.3f}", "", f"{size:.0f}", f"{anchors:.1f}")
        made.append((name, f"-rate-{-rate:g}", *figures, SOURCE, f"{len(wanted)} scenes, {seeds} seeds or more"))
    return made


def _mean(results: list[dict[str, Any]]) -> dict[str, Any]:
    """Returns the figures of one scene, means over its seeds."""
    mean = {name: statistics.fmean(r["mean"][name] for r in results) for name in ("psnr_3dgs", "ssim_3dgs")}
    return {"mean": mean, **{name: statistics.fmean(r[name] for r in results) for name in ("bytes", "anchors")}}


def main(arguments: list[str]) -> int:
    """Runs the command; returns its exit status."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.survey", description="Rows for the survey.")
    parser.add_argument("folder", type=Path)
    parser.add_argument("data_sets", nargs="+", metavar="NAME=SCENE,...")
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="OUT")
    chosen = parser.parse_args(arguments)
    found = cells(chosen.folder)
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
