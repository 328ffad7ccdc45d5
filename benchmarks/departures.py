"""What each departure from the paper's training is worth, seed by seed, as a section of RESULTS.md.

python -m benchmarks.departures FOLDER RATES

FOLDER is what `refcodec experiment` made of departures.toml, RATES what it made of departures-rates.toml.
"""

from __future__ import annotations

import argparse
import csv
import sys
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from refcodec.files.text import printable
from refcodec.statuses import DONE, USAGE

from .curves import Curve, at_bytes
from .results import SEEDS, machine, table, write_section

F64 = NDArray[np.float64]
# The method that the others are compared with.
BASE = "pro"
NOTE = (
    "Each departure is undone alone, and compared with the method as it is by the same seed: means of the differences,",
    "± their sample standard deviation. At equal bytes: against the method's own PSNR at that size, which a line",
    "through its rates tells, PSNR by the logarithm of bytes; beyond them its last piece goes on.",
    "A verdict needs three seeds, and a mean of twice its deviation and of 0.05 dB.",
)


def read(folder: Path) -> Mapping[str, Mapping[int, Curve]]:
    """For each method and seed: bytes and PSNR of each rate, the smallest file first."""
    found: dict[str, dict[int, list[tuple[float, float]]]] = {}
    with (folder / "results.csv").open(encoding="utf-8", newline="") as file:
        for row in csv.DictReader(file):
            cell = float(row["bytes"]), float(row["psnr"])
            found.setdefault(row["method"], {}).setdefault(int(row["seed"]), []).append(cell)
    return {method: {seed: sorted(cells) for seed, cells in seeds.items()} for method, seeds in found.items()}


def verdict(differences: F64) -> str:
    """What undoing a departure does, by the differences at equal bytes."""
    if len(differences) < SEEDS:
        return "cannot be told"
    mean, spread = differences.mean(), differences.std(ddof=1)
    if abs(mean) < max(2 * spread, 0.05):
        return "cannot be told"
    return "the departure is better" if mean < 0 else "the departure is worse"


def told(values: F64, form: str) -> str:
    """The mean of differences, ± their sample standard deviation. One alone has none."""
    spread = f" ± {values.std(ddof=1):{form}}" if len(values) > 1 else ""
    return f"{values.mean():+{form}}{spread}"


def lines(found: Mapping[str, Mapping[int, Curve]], curves: Mapping[int, Curve]) -> list[str]:
    """A row for each method. found: those of departures.toml. curves: by seed the method as it is, at several rates."""
    rows = []
    for method, seeds in found.items():
        if method == BASE:
            continue
        pairs = [(cells[0], found[BASE][seed][0], curves[seed]) for seed, cells in seeds.items()]
        size = np.array([100 * (mine[0] / base[0] - 1) for mine, base, _ in pairs])
        psnr = np.array([mine[1] - base[1] for mine, base, _ in pairs])
        equal = np.array([mine[1] - at_bytes(curve, mine[0]) for mine, _, curve in pairs])
        share = f"{told(size, '.1f')} %"
        rows.append([method, str(len(pairs)), told(psnr, ".2f"), share, told(equal, ".2f"), verdict(equal)])
    head = ["undone", "n", "PSNR, dB", "bytes", "PSNR at equal bytes, dB", "verdict"]
    return table(head, rows)


def main(words: list[str] | None = None) -> int:
    """Writes the section. Returns the exit status."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.departures", description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("rates", type=Path)
    arguments = parser.parse_args(words)
    try:
        body = lines(read(arguments.folder), read(arguments.rates)[BASE])
    except (OSError, KeyError, ValueError) as error:
        print(printable(f"{type(error).__name__}: {error}"), file=sys.stderr)
        return USAGE
    commands = [
        "refcodec experiment benchmarks/experiments/departures.toml -o FOLDER",
        "refcodec experiment benchmarks/experiments/departures-rates.toml -o RATES",
        "python -m benchmarks.departures FOLDER RATES",
    ]
    write_section(
        "departures", "What departures are worth", ["```", *commands, "```", "", machine("torch"), *NOTE, "", *body]
    )
    return DONE


if __name__ == "__main__":
    sys.exit(main())
