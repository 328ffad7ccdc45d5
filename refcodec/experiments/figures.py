"""Figures of evaluations, and the difference between two rate-distortion curves."""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import bjontegaard
import matplotlib as mpl

from .runs import RunError

PARTS = ("positions", "attributes", "masks", "planes", "weights")
FIGURES = ("psnr", "ssim", "psnr_3dgs", "ssim_3dgs")
# Bjontegaard's method fits cubics.
BD_POINTS = 4

# bjontegaard imports pyplot, which must not look for a screen.
mpl.use("Agg")

Row = dict[str, float]


def figures_of(evaluation: Mapping[str, Any]) -> Row:
    """The figures of a document of `eval --json`: bytes, bytes by part, bits per anchor, anchors, means of FIGURES.

    headers: bytes of everything outside the PARTS.
    """
    sections, anchors = evaluation["parts"], evaluation["anchors"]
    return {
        "bytes": evaluation["bytes"],
        **{part: sections.get(part, 0) for part in PARTS},
        "headers": sum(value for part, value in sections.items() if part not in PARTS),
        "bits_per_anchor": 8 * evaluation["bytes"] / anchors if anchors else math.nan,
        "anchors": anchors,
        **{figure: evaluation["mean"][figure] for figure in FIGURES},
    }


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
        sorted((point["bytes"], point["psnr"]) for point in curve if point.get("rate", 1) > 0)
        for curve in (anchor, test)
    ]
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
