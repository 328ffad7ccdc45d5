"""`python -m benchmarks scale`: time and memory of whole and streaming decoding, by the number of anchors."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from statistics import median
from typing import Any

from tqdm import tqdm

from .contenders import DisagreementError
from .large import KEPT, PAPER_ANCHORS, large
from .reading import ARRIVING, WHOLE, Reading, ReadingError, reading
from .results import RESULTS, facts, facts_line, mib, table

SIZES = (10_000, 40_000, 100_000, PAPER_ANCHORS, 1_000_000, 4_000_000)
WAYS = {WHOLE: "whole", ARRIVING: "streaming"}
PLOT = RESULTS.with_name("scale.png")


def scale(trained: Path, sizes: Sequence[int], rounds: int, kept: Path = KEPT) -> dict[str, Any]:
    """Returns the figures: medians over rounds for each size and way. The ways are interleaved.

    trained: the scene whose symbols are decoded. If a way fails at a size, its row has the error instead. Raises
    DisagreementError if the ways give different scenes.
    """
    machine = facts()
    files = {size: large(trained, size, kept).path for size in sizes}
    order: list[tuple[int, str]] = []
    found: dict[tuple[int, str], list[Reading]] = {(size, way): [] for size in sizes for way in WAYS}
    failed: dict[tuple[int, str], str] = {}
    for number in tqdm(range(rounds * len(found)), "reading", leave=False):
        size, way = list(found)[number % len(found)]
        if (size, way) in failed:
            continue
        order.append((size, WAYS[way]))
        try:
            found[size, way].append(reading(files[size], way))
        except ReadingError as error:
            failed[size, way] = str(error)
    rows = []
    for (size, way), runs in found.items():
        row: dict[str, Any] = {"anchors": size, "way": WAYS[way]}
        if (size, way) in failed:
            row["failed"] = failed[size, way]
        else:
            row["seconds"] = median(run.seconds for run in runs)
            row["processor"] = median(run.processor for run in runs)
            row["microseconds_of_an_anchor"] = 1e6 * row["processor"] / size
            row["peak"] = max(run.peak for run in runs)
            row["runs"] = [vars(run) for run in runs]
        rows.append(row)
    for size in sizes:
        if len({run.digest for way in WAYS for run in found[size, way]}) > 1:
            raise DisagreementError(f"the digests of {size} anchors differ between the ways of reading")
    return {
        "task": "scale",
        "machine": machine,
        "trained": trained.name,
        "rounds": rounds,
        "order": order,
        "bytes": {str(size): path.stat().st_size for size, path in files.items()},
        "rows": rows,
    }


def scale_lines(figures: dict[str, Any]) -> list[str]:
    """Returns the figures as the lines of a section."""
    rows = []
    for row in figures["rows"]:
        head = [f"{row['anchors']:,}", f"{figures['bytes'][str(row['anchors'])]:,}", row["way"]]
        if "failed" in row:
            rows.append([*head, f"failed: {row['failed']}", "", "", ""])
            continue
        times = [f"{row['seconds']:.2f}", f"{row['processor']:.2f}", f"{row['microseconds_of_an_anchor']:.2f}"]
        rows.append([*head, *times, mib(row["peak"])])
    head = ["anchors", "bytes", "decode", "seconds", "processor seconds", "of an anchor, µs", "resident MiB"]
    return [
        facts_line(figures["machine"]),
        "",
        *table(head, rows),
        "",
        f"![Seconds and memory by the number of anchors]({PLOT.name})",
        "",
        f"The symbols are those of `{figures['trained']}`, as in `decode`. Each run is a separate process.",
        f"Seconds, of decoding and of making float32 values, are medians of {figures['rounds']} interleaved rounds.",
        "Memory is the peak of the process. Whole decoding holds the scene. Streaming decoding reads the file in",
        "blocks, and releases each chunk. Their digests are equal.",
    ]


def write_plot(figures: dict[str, Any], path: Path = PLOT) -> None:
    """Plots seconds and MiB against anchors, all logarithmic, with a line for each way."""
    from matplotlib.figure import Figure  # noqa: PLC0415

    drawing = Figure(figsize=(9, 4), layout="constrained")
    left, right = drawing.subplots(1, 2)
    for way in WAYS.values():
        rows = [row for row in figures["rows"] if row["way"] == way and "failed" not in row]
        anchors = [row["anchors"] for row in rows]
        left.plot(anchors, [row["seconds"] for row in rows], "o-", label=way)
        right.plot(anchors, [row["peak"] / (1 << 20) for row in rows], "o-", label=way)
    for axes, name in ((left, "seconds"), (right, "resident MiB")):
        axes.set(xscale="log", yscale="log", xlabel="anchors", ylabel=name)
        axes.grid(which="both", alpha=0.3)
        axes.legend()
    drawing.savefig(path, dpi=150)
