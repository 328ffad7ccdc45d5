"""Tables of an experiment's results: a row for each cell, means and spreads over seeds, and BD-rates."""

from __future__ import annotations

import csv
import io
import math
import statistics
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from .cells import Cell
from .figures import BD_POINTS, FIGURES, PARTS, compare, figures_of
from .runs import RunError

CSV, MARKDOWN = "results.csv", "tables.md"
SIZES = ("bytes", *PARTS, "headers")
COLUMNS = (
    *("scene", "method", "rate", "seed", *SIZES, "bits_per_anchor", "anchors", *FIGURES, "steps", "seconds"),
    *("processor_seconds", "sha256"),
)
# The names of the figures in tables.md, and their digits.
_SHOWN = {"psnr": ("PSNR, dB", 2), "ssim": ("SSIM", 4)}
_SHOWN |= {name: (name, 0) for name in (*SIZES, "anchors")} | {"processor_seconds": ("processor s", 0)}

Row = dict[str, Any]


@dataclass(frozen=True)
class Spread:
    """The mean, the sample standard deviation (NaN for one value) and the number of some values."""

    mean: float
    deviation: float
    count: int

    def text(self, digits: int) -> str:
        """The text in tables: mean and deviation, and the number of values where it is not stated elsewhere."""
        mean = f"{self.mean:,.{digits}f}"
        return mean if math.isnan(self.deviation) else f"{mean} ± {self.deviation:,.{digits}f}"


def spread(values: Sequence[float]) -> Spread:
    """The spread of one value or more."""
    deviation = statistics.stdev(values) if len(values) > 1 else math.nan
    return Spread(statistics.fmean(values), deviation, len(values))


def row(cell: Cell, result: Mapping[str, Any]) -> Row:
    """The COLUMNS of a cell. `seconds` and `processor_seconds` are those of its training run."""
    return {
        "scene": cell.scene.name,
        "method": cell.method.name,
        "rate": cell.rate,
        "seed": cell.seed,
        **figures_of(result),
        "steps": cell.settings.steps,
        "seconds": result["seconds"]["train"],
        "processor_seconds": result["processor_seconds"]["train"],
        "sha256": result["sha256"] or "",
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
    found: dict[tuple[Any, ...], list[Row]] = {}
    for one in rows:
        found.setdefault(tuple(one[key] for key in keys), []).append(one)
    return found


# --- BD-rates ---------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Delta:
    """A method's Bjontegaard deltas from the baseline on one scene, by seed.

    rates: percent. psnrs: dB. reasons: why a seed has no deltas.
    """

    scene: str
    method: str
    rates: Mapping[int, float]
    psnrs: Mapping[int, float]
    reasons: Mapping[int, str]


def deltas(rows: Sequence[Row], baseline: str) -> Iterator[Delta]:
    """The deltas of every other method with rates, by scene of the baseline. Curves of the same seed are compared."""
    curves = grouped([one for one in rows if one["rate"] > 0], "scene", "method", "seed")
    for scene, method in dict.fromkeys((scene, method) for scene, method, _ in curves if method != baseline):
        rates, psnrs, reasons = {}, {}, {}
        for seed in [seed for *where, seed in curves if where == [scene, method]]:
            anchor, test = curves.get((scene, baseline, seed), []), curves[scene, method, seed]
            least = min(len(anchor), len(test))
            try:
                if least < BD_POINTS:
                    raise RunError(f"not enough points: {least}, but {BD_POINTS} are needed")
                found = compare(anchor, test)
            except RunError as error:
                reasons[seed] = str(error)
                continue
            rates[seed], psnrs[seed] = found.rate, found.psnr
            if found.warning:
                reasons[seed] = found.warning
        yield Delta(scene, method, rates, psnrs, reasons)


# --- Markdown ---------------------------------------------------------------------------------------------------------


def _table(head: Sequence[str], body: Sequence[Sequence[str]]) -> list[str]:
    return [f"| {' | '.join(cells)} |" for cells in (head, ["---"] * len(head), *body)]


def _figures(rows: Sequence[Row]) -> Iterator[str]:
    head = ["method", "lambda_r", "n", *(words for words, _ in _SHOWN.values())]
    for (scene,), of_scene in grouped(rows, "scene").items():
        yield from ["", f"## {scene}", ""]
        body = []
        for (method, rate), several in grouped(of_scene, "method", "rate").items():
            figures = [spread([one[name] for one in several]).text(digits) for name, (_, digits) in _SHOWN.items()]
            body.append([method, f"{rate:g}" if rate else "uncompressed", str(len(several)), *figures])
        yield from _table(head, body)


def _bd(rows: Sequence[Row], baseline: str, groups: Mapping[str, str]) -> Iterator[str]:
    found = list(deltas(rows, baseline))
    yield from ["", f"## BD-rates against {baseline}", ""]
    if not found:
        yield "No other method has results."
        return
    body = []
    for one in found:
        figures = [spread([*values.values()]) if values else None for values in (one.rates, one.psnrs)]
        seeds = [f"{seed}: {value:+.2f}" for seed, value in one.rates.items()]
        notes = dict.fromkeys(f"seed {seed}: {reason}" for seed, reason in one.reasons.items())
        if len(set(one.reasons.values())) == 1 and not one.rates:
            notes = dict.fromkeys(one.reasons.values())
        cells = [figure.text(digits) if figure else "-" for figure, digits in zip(figures, (2, 3), strict=True)]
        body.append([one.scene, one.method, str(len(one.rates)), *cells, ", ".join(seeds), "; ".join(notes)])
    yield from _table(["scene", "method", "n", "BD-rate, %", "BD-PSNR, dB", "BD-rate of each seed", "notes"], body)
    yield from ["", "Piecewise cubic interpolation (JCTVC-L1100) of the curve of each seed. Negative rates save bytes."]
    # Only data sets of several scenes have a mean.
    means: dict[tuple[str, str], list[float]] = {}
    for one in found:
        if one.rates:
            means.setdefault((groups[one.scene], one.method), []).append(statistics.fmean(one.rates.values()))
    several = [
        [group, method, str(len(values)), f"{statistics.fmean(values):+.2f}"]
        for (group, method), values in means.items()
        if sum(name == group for name in groups.values()) > 1
    ]
    if several:
        yield from ["", *_table(["group", "method", "scenes", "mean BD-rate, %"], several)]


def as_markdown(title: str, rows: Sequence[Row], missing: str, baseline: str | None, groups: Mapping[str, str]) -> str:
    """All tables. missing: text that names the missing cells, or empty. groups: the groups of scenes."""
    lines = [f"# {title}", ""]
    lines += [missing, ""] if missing else []
    lines += [
        "Means over n seeds, ± the sample standard deviation. Figures are means over the held-out photographs.",
        "bytes: of the file, and of its parts; of float32 values where a scene is uncompressed. processor s: of the",
        "training, in all processors.",
        *_figures(rows),
    ]
    lines += _bd(rows, baseline, groups) if baseline else []
    return "\n".join(lines) + "\n"
