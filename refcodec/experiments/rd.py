"""Rate and distortion: training runs at several rates, their figures as a table and a chart, and curve differences."""

from __future__ import annotations

import csv
import io
import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from matplotlib.figure import Figure

from ..files.lock import hold_folder
from ..files.outputs import check_apart
from ..files.stage import write_file
from ..folder.layout import REPORT_FILE
from .data_set import DataSet
from .figures import BD_POINTS, FIGURES, PARTS, Difference, Row, compare, figures_of
from .runs import Command, Notes, RunError, Runner, is_evaluation, read_result, shown

FORMAT, NOTES, TABLE, CHART = "C3GS rate and distortion", "rd.json", "rd.csv", "rd.png"
COLUMNS = ("rate", "bytes", *PARTS, "headers", "bits_per_anchor", "anchors", *FIGURES, "seconds")


@dataclass(frozen=True)
class Settings:
    """The settings of all training runs.

    folder: of the results. jobs: training runs at a time.
    """

    folder: Path
    photographs: DataSet
    jobs: int

    def chain(self, rate: float) -> list[Command]:
        """The commands of one rate, 0 for an uncompressed scene."""
        name = f"rate-{rate:g}"
        scene, file = self.folder / name, self.folder / f"{name}.c3gs"
        threads = max(1, (os.cpu_count() or 1) // self.jobs)
        source = str(self.photographs.folder)
        settings = ("--rate", f"{rate:g}", *self.photographs.trained, "--threads", str(threads), "--progress")
        train, encode = f"{name} train", f"{name} encode"
        state = self.folder / f"{name}.train-state"
        commands = [Command(name, ("train", source, "-o", str(scene), *settings), scene / REPORT_FILE, state=state)]
        if rate:
            commands.append(Command(name, ("encode", str(scene), "-o", str(file)), file, (train,)))
        what = ("eval", str(file if rate else scene), source, *self.photographs.evaluated, "--json")
        after = encode if rate else train
        return [*commands, Command(name, what, self.folder / f"{name}.json", (after,), printed=True)]


def run_rd(
    settings: Settings, rates: Sequence[float], against: Path | None = None
) -> tuple[list[Row], Difference | None]:
    """Trains, encodes and evaluates at each rate, and writes the table and the chart.

    Finished commands in this folder with the same settings are not repeated. Returns the table, and the difference
    of its curve from that of the table `against`. Raises RunError, also after Ctrl-C; PhotographError; UsageError if an
    output is an input, or another run writes to the folder.
    """
    other = read_curve(against) if against else None
    coded = sum(rate > 0 for rate in rates)
    if other is not None and min(coded, len(other)) < BD_POINTS:
        raise RunError(
            f"BD-rate needs {BD_POINTS} rates above 0 or more in both curves: {coded} here, {len(other)} in {against}"
        )
    found = settings.photographs.read()
    folder = settings.folder
    check_apart([folder / name for name in (NOTES, TABLE, CHART)], [against, *found.places()])
    with hold_folder(folder):
        return _run(settings, rates, against, other)


def _run(
    settings: Settings, rates: Sequence[float], against: Path | None, other: list[Row] | None
) -> tuple[list[Row], Difference | None]:
    notes = Notes.open(settings.folder, NOTES, FORMAT)
    chains = [settings.chain(rate) for rate in rates]
    with shown([chain[0].subject for chain in chains]) as show:
        whole = Runner(notes, show, settings.jobs).run(chains)
    rows = [_row(settings, rate, notes) for rate, chain in zip(rates, chains, strict=True) if notes.is_done(chain[-1])]
    if rows:
        write_table(settings.folder / TABLE, rows)
        write_chart(settings.folder / CHART, {settings.folder.name: rows} | ({str(against): other} if other else {}))
    if not whole:
        raise RunError(
            f"stopped with {len(rows)} of {len(rates)} rates done; run the same command again to continue", 130
        )
    return rows, compare(other, rows) if other else None


def _row(settings: Settings, rate: float, notes: Notes) -> Row:
    name = f"rate-{rate:g}"
    found = read_result(settings.folder / f"{name}.json", is_evaluation)
    return {
        "rate": rate,
        **figures_of(found),
        "seconds": notes.seconds(f"{name} train"),
    }


def write_table(path: Path, rows: Sequence[Row]) -> None:
    """Rows with COLUMNS as CSV.

    They are bytes of the file and its parts (float32 at rate 0), bits per anchor, means of the figures over the
    held-out images, and seconds of training.
    """
    text = io.StringIO(newline="")
    writer = csv.DictWriter(text, COLUMNS)
    writer.writeheader()
    writer.writerows(
        {name: f"{value:.6g}" if isinstance(value, float) else value for name, value in row.items()} for row in rows
    )
    write_file(path, text.getvalue().encode())


def read_curve(path: Path) -> list[Row]:
    """The points of a table with the columns bytes and psnr, without uncompressed ones. Raises RunError.

    Other columns are ignored.
    """
    try:
        with path.open(newline="", encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
        points = [
            {"bytes": float(row["bytes"]), "psnr": float(row["psnr"])}
            for row in rows
            if float(row.get("rate") or 1) > 0
        ]
    except OSError as error:
        raise RunError(f"{path}: {error.strerror}") from None
    except (KeyError, TypeError, ValueError, csv.Error):
        raise RunError(f"{path} is not a table with numbers in the columns bytes and psnr") from None
    if not all(
        point["bytes"] > 0 and math.isfinite(point["bytes"]) and math.isfinite(point["psnr"]) for point in points
    ):
        raise RunError(f"{path} has sizes or PSNRs that no file has")
    return points


def write_chart(path: Path, curves: Mapping[str, Sequence[Row]]) -> None:
    """PSNR against MB (10^6 bytes), with a line for each curve and its uncompressed point as a ring."""
    figure = Figure(figsize=(6.4, 4.4), layout="constrained")
    axes = figure.subplots()
    for name, rows in curves.items():
        coded = sorted((row["bytes"] / 1e6, row["psnr"]) for row in rows if row.get("rate", 1) > 0)
        (line,) = axes.plot([b for b, _ in coded], [p for _, p in coded], "o-", label=name)
        whole = [(row["bytes"] / 1e6, row["psnr"]) for row in rows if row.get("rate", 1) == 0]
        for size, psnr in whole:
            axes.plot(size, psnr, "o", mfc="none", color=line.get_color(), label=f"{name}, uncompressed")
    axes.set(xscale="log", xlabel="MB", ylabel="PSNR, dB")
    axes.xaxis.set_major_formatter("{x:.4g}")
    axes.xaxis.set_minor_formatter("{x:.4g}")
    axes.grid(which="both", alpha=0.3)
    axes.legend()
    data = io.BytesIO()
    figure.savefig(data, format="png", dpi=150)
    write_file(path, data.getvalue())
