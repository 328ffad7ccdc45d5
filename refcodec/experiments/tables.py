"""Tables and curves of an experiment's results: a row for each cell, means and spreads over seeds, comparisons."""

import csv
import io
import math
import statistics
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import bjontegaard
import matplotlib as mpl
from matplotlib.figure import Figure

from ..files.stage import write_file
from .cells import Result
from .jobs import RunError

CSV, MARKDOWN, CURVES = "results.csv", "tables.md", "curves"
PARTS = ("positions", "attributes", "masks", "planes", "weights")
FIGURES = ("psnr", "ssim", "psnr_3dgs", "ssim_3dgs")
SIZES = ("bytes", *PARTS, "headers")
COLUMNS = (
    *("scene", "method", "lambda_r", "seed", *SIZES, "bits_per_anchor", "anchors", *FIGURES, "steps", "seconds"),
    *("processor_seconds", "sha256"),
)
# The names of the figures in tables.md, and their digits.
_SHOWN = {"psnr": ("PSNR, dB", 2), "ssim": ("SSIM", 4)}
_SHOWN |= {name: (name, 0) for name in (*SIZES, "anchors")} | {"processor_seconds": ("processor s", 0)}
# Bjontegaard's method fits cubics.
BD_POINTS = 4

# bjontegaard imports pyplot, which must not look for a screen.
mpl.use("Agg")

# The COLUMNS of a cell.
Row = dict[str, Any]


def spread(values: Sequence[float]) -> tuple[float, float]:
    """The mean and the sample standard deviation of one value or more; NaN for the deviation of one."""
    return statistics.fmean(values), statistics.stdev(values) if len(values) > 1 else math.nan


def spread_text(values: Sequence[float], digits: int) -> str:
    """The spread of values as tables have it."""
    mean, deviation = (f"{value:,.{digits}f}" for value in spread(values))
    return mean if len(values) == 1 else f"{mean} ± {deviation}"


def row(scene: str, method: str, lambda_r: float, seed: int, result: Result) -> Row:
    """The row of a result. `seconds` and `processor_seconds` are those of its training run.

    headers: bytes of everything outside the PARTS.
    """
    return {
        **{"scene": scene, "method": method, "lambda_r": lambda_r, "seed": seed, "bytes": result.bytes},
        **{part: result.parts.get(part, 0) for part in PARTS},
        "headers": sum(value for part, value in result.parts.items() if part not in PARTS),
        "bits_per_anchor": 8 * result.bytes / result.anchors if result.anchors else math.nan,
        "anchors": result.anchors,
        **{figure: getattr(result.mean, figure) for figure in FIGURES},
        "steps": result.definition["settings"]["steps"],
        "seconds": result.seconds.get("train", math.nan),
        "processor_seconds": result.processor_seconds.get("train", math.nan),
        "sha256": result.sha256 or "",
    }


def as_csv(rows: Sequence[Row]) -> str:
    """Rows with their COLUMNS."""
    text = io.StringIO()
    writer = csv.DictWriter(text, COLUMNS, lineterminator="\n")
    writer.writeheader()
    writer.writerows(
        {name: f"{value:.6g}" if isinstance(value, float) else value for name, value in one.items()} for one in rows
    )
    return text.getvalue()


def grouped(rows: Sequence[Row], *keys: str) -> dict[tuple[Any, ...], list[Row]]:
    """Rows with the same values of some columns, in the order of the rows."""
    groups: dict[tuple[Any, ...], list[Row]] = {}
    for one in rows:
        groups.setdefault(tuple(one[key] for key in keys), []).append(one)
    return groups


def read_curve(path: Path) -> list[Row]:
    """The points of a table with the columns bytes and psnr. Raises RunError.

    Without the column lambda_r, the number of a point stands for it.
    """
    try:
        with path.open(newline="", encoding="utf-8") as file:
            lines = [{"lambda_r": number, **line} for number, line in enumerate(csv.DictReader(file), 1)]
        rows: list[Row] = [
            {**line, **{key: float(line[key]) for key in ("bytes", "psnr", "lambda_r")}} for line in lines
        ]
    except OSError as error:
        raise RunError(f"{path}: {error.strerror}") from None
    except (KeyError, TypeError, ValueError, csv.Error):
        raise RunError(f"{path} is not a table with numbers in the columns bytes and psnr") from None
    if not all(row["bytes"] > 0 and math.isfinite(row["bytes"]) and math.isfinite(row["psnr"]) for row in rows):
        raise RunError(f"{path} has sizes or PSNRs that no file has")
    return rows


# --- comparisons ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Difference:
    """The difference of a curve from another.

    rate: BD-rate in percent, negative where it saves. psnr: BD-PSNR in dB. warning: a text if the curves have little
    range in common.
    """

    rate: float
    psnr: float
    warning: str


def compare(anchor: Sequence[Row], test: Sequence[Row]) -> Difference:
    """The Bjontegaard deltas of the test curve from the anchor, by piecewise cubic interpolation, as JCTVC-L1100 does.

    Uncompressed points are left out. Raises RunError if the deltas cannot be computed.
    """
    curves = [
        sorted((point["bytes"], point["psnr"]) for point in curve if point.get("lambda_r", 1) > 0)
        for curve in (anchor, test)
    ]
    if (least := min(map(len, curves))) < BD_POINTS:
        raise RunError(f"not enough points: {least}, but {BD_POINTS} are needed")
    for curve in curves:
        if any(a[0] >= b[0] or a[1] >= b[1] for a, b in pairwise(curve)):
            raise RunError(
                "BD-rate needs curves on which PSNR rises with the size: "
                + ", ".join(f"{b:.0f} B {p:.2f} dB" for b, p in curve)
            )
    columns = [[point[i] for point in curve] for curve in curves for i in (0, 1)]
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        rate, psnr = (
            float(measure(*columns, method="pchip", require_matching_points=False))
            for measure in (bjontegaard.bd_rate, bjontegaard.bd_psnr)
        )
    if not (math.isfinite(rate) and math.isfinite(psnr)):
        raise RunError("BD-rate needs curves that have sizes and PSNRs in common")
    return Difference(rate, psnr, "the curves have less than three quarters of their range in common" if caught else "")


def _bd(rows: Sequence[Row], baseline: str) -> Iterator[str]:
    """BD-rates of all other methods. Curves of the same scene and seed are compared."""
    curves = grouped([one for one in rows if one["lambda_r"] > 0], "scene", "method", "seed")
    body, means = [], dict[str, list[float]]()
    for scene, method in dict.fromkeys((scene, method) for scene, method, _ in curves if method != baseline):
        deltas, notes = dict[int, Difference](), dict[int, str]()
        for seed in [seed for *where, seed in curves if where == [scene, method]]:
            try:
                deltas[seed] = compare(curves.get((scene, baseline, seed), []), curves[scene, method, seed])
                notes |= {seed: deltas[seed].warning} if deltas[seed].warning else {}
            except RunError as error:
                notes[seed] = str(error)
        rates = [delta.rate for delta in deltas.values()]
        cells = [spread_text(rates, 2), spread_text([d.psnr for d in deltas.values()], 3)] if deltas else ["-", "-"]
        seeds = ", ".join(f"{seed}: {delta.rate:+.2f}" for seed, delta in deltas.items())
        words = dict.fromkeys(notes.values() if not deltas else (f"seed {seed}: {why}" for seed, why in notes.items()))
        body.append([scene, method, str(len(deltas)), *cells, seeds, "; ".join(words)])
        if rates:
            means.setdefault(method, []).append(statistics.fmean(rates))
    if not body:
        yield "No other method has results."
        return
    yield from table(["scene", "method", "n", "BD-rate, %", "BD-PSNR, dB", "BD-rate of each seed", "notes"], body)
    yield from ["", "Piecewise cubic interpolation (JCTVC-L1100) of the curve of each seed. Negative rates save bytes."]
    several = [[method, str(len(v)), f"{statistics.fmean(v):+.2f}"] for method, v in means.items() if len(v) > 1]
    if several:
        yield from ["", *table(["method", "scenes", "mean BD-rate, %"], several)]


# --- Markdown ---------------------------------------------------------------------------------------------------------


def table(head: Sequence[str], body: Sequence[Sequence[str]]) -> list[str]:
    """The lines of a table in Markdown."""
    return [f"| {' | '.join(cells)} |" for cells in (head, ["---"] * len(head), *body)]


def _figures(rows: Sequence[Row]) -> Iterator[str]:
    head = ["method", "lambda_r", "n", *(words for words, _ in _SHOWN.values())]
    for (scene,), of_scene in grouped(rows, "scene").items():
        yield from ["", f"## {scene}", ""]
        body = []
        for (method, lambda_r), several in grouped(of_scene, "method", "lambda_r").items():
            figures = [spread_text([one[name] for one in several], digits) for name, (_, digits) in _SHOWN.items()]
            body.append([method, f"{lambda_r:g}" if lambda_r else "uncompressed", str(len(several)), *figures])
        yield from table(head, body)


def as_markdown(title: str, rows: Sequence[Row], missing: str, baseline: str | None) -> str:
    """All tables. missing: text that names the missing cells, or empty."""
    lines = [f"# {title}", "", *([missing, ""] if missing else [])]
    lines += [
        "Means over n seeds, ± the sample standard deviation. Figures are means over the held-out photographs.",
        "bytes: of the file, and of its parts; of float32 values where a scene is uncompressed. processor s: of the",
        "training, in all processors.",
        *_figures(rows),
    ]
    if baseline:
        lines += ["", f"## BD-rates against {baseline}", "", *_bd(rows, baseline)]
    return "\n".join(lines) + "\n"


# --- curves -----------------------------------------------------------------------------------------------------------


def write_curves(folder: Path, rows: Sequence[Row], suffixes: Sequence[str] = ("png", "svg")) -> None:
    """Writes SCENE.SUFFIX for each scene and suffix. Points are means over seeds, bars sample deviations."""
    # The same rows give the same SVG.
    with mpl.rc_context({"svg.hashsalt": "C3GS"}):
        for (scene,), of_scene in grouped(rows, "scene").items():
            figure = draw(scene, of_scene)
            for suffix in suffixes:
                data = io.BytesIO()
                figure.savefig(data, dpi=150, format=suffix, metadata={"Date": None} if suffix == "svg" else {})
                write_file(folder / f"{scene}.{suffix}", data.getvalue())


def draw(scene: str, rows: Sequence[Row]) -> Figure:
    """The chart of one scene: bytes against PSNR. An uncompressed method is a ring. A NaN deviation has no bar."""
    figure = Figure(figsize=(6.4, 4.4), layout="constrained")
    axes = figure.subplots()
    for (method,), of_method in grouped(rows, "method").items():
        same = grouped(of_method, "lambda_r").values()
        points = [[*spread([one["bytes"] for one in s]), *spread([one["psnr"] for one in s])] for s in same]
        x, x_error, y, y_error = zip(*sorted(points), strict=True)
        rated = any(one["lambda_r"] for one in of_method)
        style: dict[str, Any] = {"fmt": "o-"} if rated else {"fmt": "o", "markerfacecolor": "none"}
        axes.errorbar(x, y, xerr=x_error, yerr=y_error, label=method, capsize=2, **style)
    axes.set(xscale="log", xlabel="bytes", ylabel="PSNR, dB", title=scene)
    axes.grid(which="both", alpha=0.3)
    axes.legend()
    return figure
