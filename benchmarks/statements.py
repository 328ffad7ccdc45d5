"""The paper's statements on hyperpriors, and entropy models of others, with the same seeds, as a section of RESULTS.md.

python -m benchmarks.peers run PHOTOGRAPHS FOLDER --method c3gs --strengths 0.002      # and each of OTHERS
python -m benchmarks.statements FOLDER RATES

RATES is what `refcodec experiment` made of departures-rates.toml: what bytes are worth.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from refcodec.files.documents import DocumentError
from refcodec.files.text import printable
from refcodec.statuses import DONE, USAGE

from .curves import Curve, at_bytes
from .departures import BASE as METHOD
from .departures import read as read_curves
from .departures import told, verdict
from .peers.runs import records
from .results import machine, table, write_section

# The methods of benchmarks.peers: what takes the place of what, and the paper's P and A in MB for both (Amsterdam).
BASE = "c3gs"
OTHERS = {
    "triplane": ("a triplane of 8 channels for the VM hyperprior", "0.5 + 18.8 for 0.3 + 18.8"),
    "plane": ("a plane without gamma for the VM hyperprior", "0.2 + 20.0 for 0.3 + 18.8"),
    "hac": ("HAC's tables of signs for the VM hyperprior", ""),
    "hac++": ("HAC++'s tables of signs and mixtures", ""),
    "contextgs": ("ContextGS's levels of anchors for the VM hyperprior", ""),
    "vm-mixture": ("mixtures of two distributions beside the VM hyperprior", ""),
}
NOTE = (
    "caliterra at 200 pixels, 2,000 steps, about 10,000 anchors. Each is compared with the format's model by the same",
    "seed: means of the differences, ± their sample standard deviation. A and P are code lengths. P is that of planes,",
    "or of tables of signs. Weights of networks are not counted. At equal bytes: less what as many bytes are worth",
    "to the trainer, between its own rates. A verdict needs three seeds, and a mean of twice its deviation and of",
    "0.05 dB.",
)


def read(folder: Path) -> dict[str, dict[int, dict[str, Any]]]:
    """The results of benchmarks.peers by method and seed. Raises OSError, DocumentError."""
    found: dict[str, dict[int, dict[str, Any]]] = {}
    for result in records(folder):
        found.setdefault(result["method"], {})[result["seed"]] = result
    return found


def lines(found: Mapping[str, Mapping[int, dict[str, Any]]], curves: Mapping[int, Curve]) -> list[str]:
    """A row for each model but the format's. curves: by seed the trainer's files at several rates."""

    def lengths(result: dict[str, Any]) -> tuple[float, float, float, float]:
        (file,) = [of for name, of in result["files"].items() if name.endswith("code lengths")]
        return result["lengths"]["attributes"], result["lengths"]["planes"], file["psnr"], file["bytes"]

    rows = []
    for method, (what, paper) in OTHERS.items():
        pairs = [(lengths(mine), lengths(found[BASE][seed]), curves[seed]) for seed, mine in found[method].items()]
        a, p, psnr, _ = np.array([np.subtract(mine, base) for mine, base, _ in pairs]).T
        sums = np.array([sum(mine[:2]) / sum(base[:2]) for mine, base, _ in pairs])
        # What a file has over the trainer's own curve at its size.
        over = np.array([[of[2] - at_bytes(curve, of[3]) for of in (mine, base)] for mine, base, curve in pairs])
        equal = over[:, 0] - over[:, 1]
        share = f"{told(100 * (sums - 1), '.1f')} %"
        rows.append([what, str(len(pairs)), told(p, ",.0f"), told(a, ",.0f"), share, told(psnr, ".2f")])
        rows[-1] += [told(equal, ".2f"), verdict(equal).replace("departure", "format"), paper]
    head = ["changed", "n", "P, bytes", "A, bytes", "P + A", "PSNR, dB", "at equal bytes, dB", "verdict"]
    return table([*head, "the paper: P + A, MB"], rows)


def main(words: list[str] | None = None) -> int:
    """Writes the section. Returns the exit status."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.statements", description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("rates", type=Path)
    arguments = parser.parse_args(words)
    try:
        body = lines(read(arguments.folder), read_curves(arguments.rates)[METHOD])
    except (OSError, DocumentError, KeyError, ValueError) as error:
        print(printable(f"{type(error).__name__}: {error}"), file=sys.stderr)
        return USAGE
    run = "python -m benchmarks.peers run examples/photographs/caliterra FOLDER --strengths 0.002 --size 200 --method"
    commands = [*(f"{run} {method}" for method in (BASE, *OTHERS)), "python -m benchmarks.statements FOLDER RATES"]
    write_section(
        "statements",
        "Entropy models of others, with seeds",
        ["```", *commands, "```", "", machine("torch"), *NOTE, "", *body],
    )
    return DONE


if __name__ == "__main__":
    sys.exit(main())
