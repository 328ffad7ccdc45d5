"""The report of all runs in a folder: Markdown tables, and a plot of PSNR against bytes."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure as Drawing

from ..results import kb, table
from .figures import Point, Record, Scene, bd_rate, bytes_at

TABLE_FILE, PLOT_FILE = "peers.md", "peers.svg"


class TableError(Exception):
    """The runs lack a requested method or scene."""


def with_seeds(scenes: Sequence[Scene], least: int) -> list[Scene]:
    """Returns the points with at least a number of seeds, and their methods and scenes."""
    found = []
    for scene in scenes:
        curves = {label: [p for p in curve if p.seeds >= least] for label, curve in scene.curves.items()}
        found.append(Scene(scene.name, scene.size, {label: curve for label, curve in curves.items() if curve}))
    return [scene for scene in found if scene.curves]


def without(scenes: Sequence[Scene], kind: str) -> list[Scene]:
    """Returns the scenes without the methods that write a kind of file."""
    return [
        Scene(scene.name, scene.size, {k: curve for k, curve in scene.curves.items() if not k.startswith(f"{kind},")})
        for scene in scenes
    ]


def commands(records: Iterable[Record], least: int) -> list[str]:
    """Returns the commands of a folder's runs, for methods with at least a number of seeds.

    Scenes with the same runs have one command, in which | separates them.
    """
    groups: dict[Any, tuple[set[float], set[int]]] = {}
    for record in records:
        key = (record["scene"], record["method"], record["size"], record["steps"], tuple(record["changes"]))
        strengths, seeds = groups.setdefault(key, (set(), set()))
        strengths.add(record["strength"])
        seeds.add(record["seed"])
    found: dict[str, list[str]] = defaultdict(list)
    for (scene, method, size, steps, changes), (strengths, seeds) in sorted(groups.items()):
        words = ["FOLDER", "--method", method, "--strengths", *(f"{strength:g}" for strength in sorted(strengths))]
        words += ["--seeds", *map(str, sorted(seeds)), "--size", str(size), "--steps", str(steps)]
        if len(seeds) >= least:
            found[" ".join([*words, *(word for change in changes for word in ("--set", change))])].append(scene)
    return [f"python -m benchmarks.peers run {'|'.join(scenes)} {words}" for words, scenes in found.items()]


def tools(records: Iterable[Record]) -> list[str]:
    """Returns a line for each program that wrote the SPZ and SOG files of some runs, with the scenes."""
    found: dict[str, set[str]] = defaultdict(set)
    for record in records:
        if "tool" in record:
            found[record["tool"]].add(record["scene"])
    return [f"{tool} wrote SPZ and SOG of {', '.join(sorted(scenes))}." for tool, scenes in sorted(found.items())]


def report(scenes: Sequence[Scene], baseline: str) -> list[str]:
    """Returns the lines of the report. baseline: the method to compare with. Raises TableError without it."""
    known = sorted({label for scene in scenes for label in scene.curves})
    if baseline not in known:
        raise TableError(f"no run has the method {baseline!r}; there are: {', '.join(known) or 'none'}")
    return [line for scene in scenes for line in _scene(scene, baseline)]


def _scene(scene: Scene, baseline: str) -> Iterator[str]:
    yield f"### {scene.name}, {scene.size} pixels"
    yield ""
    head = ["method", "cap or lambda_r", "seeds", "bytes", "PSNR, dB", "SSIM", "processor, s"]
    yield from table(head, [_row(label, point) for label, curve in scene.curves.items() for point in curve])
    yield ""
    if baseline not in scene.curves:
        return
    against = scene.curves[baseline]
    # A single point has no curve to read from.
    others = {label: curve for label, curve in scene.curves.items() if label != baseline and len(curve) > 1}
    if not others:
        return
    rows = [_equal(point, list(others.values())) for point in against]
    if len(against) > 1:
        rows.append(["BD-rate", "", *(_signed(bd_rate(against, curve)) for curve in others.values())])
    yield f"KB of each method at the PSNR of {baseline}, and how many times as large {baseline} is:"
    yield ""
    yield from table(["PSNR, dB", baseline, *others], rows)
    yield ""


def _row(label: str, point: Point) -> list[str]:
    figures = [point.bytes.words(0), point.psnr.words(2), point.ssim.words(4), point.seconds.words(0)]
    return [label, f"{point.strength:g}", str(point.seeds), *figures]


def _signed(found: float | str) -> str:
    return found if isinstance(found, str) else f"{found:+.1f} %"


def _equal(point: Point, curves: Sequence[Sequence[Point]]) -> list[str]:
    cells = [f"{point.psnr.mean:.2f}", kb(point.bytes.mean)]
    for curve in curves:
        size = bytes_at(curve, point.psnr.mean)
        if size is None:
            cells.append(f"beyond its {_range(curve)}")
        else:
            cells.append(f"{kb(size)}, {point.bytes.mean / size:.2f}")
    return cells


def _range(curve: Sequence[Point]) -> str:
    """Returns the PSNR range of a method's points as text."""
    low, high = (end([point.psnr.mean for point in curve]) for end in (min, max))
    return f"{low:.2f} dB" if low == high else f"{low:.2f} to {high:.2f} dB"


def plot(scenes: Sequence[Scene], path: Path) -> None:
    """Plots PSNR against bytes on a logarithmic axis, with a panel for each scene and spreads as bars."""
    drawing = Drawing(figsize=(6.4 * len(scenes), 4.8), layout="constrained")
    panels = drawing.subplots(1, len(scenes), squeeze=False)[0]
    for axes, scene in zip(panels, scenes, strict=True):
        for label, curve in scene.curves.items():
            x, y = [p.bytes.mean for p in curve], [p.psnr.mean for p in curve]
            across, up = [p.bytes.spread or 0 for p in curve], [p.psnr.spread or 0 for p in curve]
            axes.errorbar(x, y, up, across, fmt="o-", capsize=2, label=label)
        axes.set(xscale="log", xlabel="bytes", ylabel="PSNR, dB")
        axes.set_title(f"{scene.name}, {scene.size} pixels")
        axes.grid(which="both", alpha=0.3)
        axes.legend()
    drawing.savefig(path)
