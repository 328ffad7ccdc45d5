"""The viewer page in Chromium: times to the first picture and to the whole one, and processor time of a frame.

python -m benchmarks.viewer [--anchors 10000 100000] [--rounds 3] [--write]

Each round opens an exported page from the disk, waits until the whole scene is drawn, and then turns the camera around
the scene step by step. Each scene is view-dependent, and again static. A large scene repeats the anchors of a trained
one at their places. Thus each pixel has many times more Gaussians than in a real scene of that size: the worst case of
drawing.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path
from statistics import median
from typing import Any

from refcodec.statuses import DONE, USAGE
from refcodec.viewer.page import page

from .chromium import Chromium, find
from .large import TRAINED, large
from .results import facts, facts_line, kb, table, write_section

SIZES = (10_000, 100_000)
WIDTH, HEIGHT = 240, 180
# Views for the processor time, in a page so small that drawing takes little time, and drawn frames.
STEPS, FRAMES, SMALL = 5, 2, {"width": 64, "height": 48, "deviceScaleFactor": 1, "mobile": False}
# Seconds for a picture with software rendering.
PATIENCE = 600
KINDS = {False: "view-dependent", True: "static"}


def _round(program: str, file: Path) -> dict[str, Any]:
    """Returns the figures of one page, in seconds and frames."""
    with Chromium(program, WIDTH, HEIGHT, patience=PATIENCE) as browser:
        browser.open(file.as_uri())
        browser.run("c3gs.settle()")
        times = browser.run("c3gs.times")
        found: dict[str, Any] = {name: value / 1000 for name, value in times.items()}
        found["gaussians"] = browser.run("c3gs.drawing.count")
        found["device"] = browser.run("c3gs.device")
        found["frame"] = _processor(browser, "gpu-process", "c3gs.draw(1); c3gs.drawing.finish()", FRAMES)
        browser.ask("Emulation.setDeviceMetricsOverride", SMALL)
        browser.run("c3gs.step()")
        found["view"] = _processor(browser, "renderer", "c3gs.step()", STEPS)
    return found


def _processor(browser: Chromium, kind: str, script: str, times: int) -> float:
    """Returns the mean processor seconds of a kind of process for a script."""
    before = browser.processor()[kind]
    for _ in range(times):
        browser.run(script)
    return (browser.processor()[kind] - before) / times


def viewer(program: str, sizes: list[int], rounds: int) -> dict[str, Any]:
    """Returns the machine, and the figures of each scene: medians over rounds. The scenes are interleaved."""
    machine = facts()
    scenes = [(size, static) for size in sizes for static in KINDS]
    found: dict[tuple[int, bool], list[dict[str, Any]]] = {scene: [] for scene in scenes}
    lengths = {}
    with tempfile.TemporaryDirectory() as folder:
        for size, static in scenes:
            data = large(TRAINED, size, static=static).path.read_bytes()
            Path(folder, f"{size}-{static}.html").write_bytes(page(f"{size}.c3gs", data))
            lengths[size, static] = len(data)
        for _ in range(rounds):
            for size, static in scenes:
                found[size, static].append(_round(program, Path(folder, f"{size}-{static}.html")))
    rows = []
    for (size, static), runs in found.items():
        row: dict[str, Any] = {"anchors": size, "kind": KINDS[static], "file": lengths[size, static]}
        for name in ("first", "whole", "view", "frame"):
            row[name] = median(run[name] for run in runs)
        rows.append(row | {"gaussians": runs[0]["gaussians"]})
    return {"machine": machine, "device": next(iter(found.values()))[0]["device"], "rounds": rounds, "rows": rows}


def viewer_lines(figures: dict[str, Any]) -> list[str]:
    """Returns the lines of the section."""
    head = ["anchors", "scene", "Gaussians", "file kB", "first picture s", "whole s", "a view ms", "drawing s"]
    rows = [
        [
            f"{row['anchors']:,}",
            row["kind"],
            f"{row['gaussians']:,}",
            kb(row["file"]),
            *(f"{row[name]:.2f}" for name in ("first", "whole")),
            f"{1000 * row['view']:.0f}",
            f"{row['frame']:.2f}",
        ]
        for row in figures["rows"]
    ]
    return [
        facts_line(figures["machine"]),
        f"Drawn by {figures['device']}.",
        f"At {WIDTH} x {HEIGHT} pixels. Medians of {figures['rounds']} pages, opened from the disk.",
        "Times start with the page. The last two columns are processor time: of the page and its worker for a camera",
        "that moved, and of software rendering for a frame with all pixels.",
        "",
        *table(head, rows),
    ]


def main() -> int:
    """Runs the command line. Returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--anchors", type=int, nargs="+", default=list(SIZES))
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--write", action="store_true", help="write the section of benchmarks/RESULTS.md")
    options = parser.parse_args()
    program = find()
    if program is None:
        print("Chromium is not installed", file=sys.stderr)
        return USAGE
    lines = viewer_lines(viewer(program, options.anchors, options.rounds))
    print("\n".join(lines))
    if options.write:
        command = " ".join(["python -m benchmarks.viewer", *(word for word in sys.argv[1:] if word != "--write")])
        write_section("viewer", "The viewer in a browser", [f"`{command}`", "", *lines])
    return DONE


if __name__ == "__main__":
    sys.exit(main())
