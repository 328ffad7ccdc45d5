"""Figures of runs: means and spreads over seeds, bytes at equal PSNR, BD-rates."""

from __future__ import annotations

import math
import statistics
import warnings
from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

# bjontegaard imports pyplot, which needs no screen until it draws.
import bjontegaard

Record = dict[str, Any]


@dataclass(frozen=True)
class Figure:
    """A mean over seeds. spread: the sample's standard deviation; None if there is one seed."""

    mean: float
    spread: float | None

    def words(self, digits: int) -> str:
        """Returns the cell of a table."""
        own = f"{self.mean:,.{digits}f}"
        return own if self.spread is None else f"{own} ± {self.spread:,.{digits}f}"


def figure(values: Sequence[float]) -> Figure:
    """Returns the figure of the values of several seeds."""
    return Figure(statistics.fmean(values), statistics.stdev(values) if len(values) > 1 else None)


@dataclass(frozen=True)
class Point:
    """The figures of a method with one setting. strength: the limit of Gaussians, or lambda_r. seeds: their number."""

    strength: float
    seeds: int
    bytes: Figure
    psnr: Figure
    ssim: Figure
    seconds: Figure


@dataclass(frozen=True)
class Scene:
    """Figures of one scene at one size. curves: the points of each method by rising bytes."""

    name: str
    size: int
    curves: dict[str, list[Point]]


def scenes(records: Iterable[Record]) -> list[Scene]:
    """Returns all runs by scene and method. A run has a row for each kind of file.

    A method's name includes its steps and changed settings, so that only seeds are averaged.
    """
    rows: dict[Any, dict[str, dict[float, list[Any]]]] = defaultdict(lambda: defaultdict(lambda: defaultdict(list)))
    for record in records:
        place = rows[record["scene"], record["size"]]
        for kind, shown in record["files"].items():
            label = ", ".join([kind, f"{record['steps']} steps", *record["changes"]])
            place[label][record["strength"]].append((shown, record["seconds"]))
    found = []
    for (name, size), methods in sorted(rows.items()):
        curves = {}
        for label, strengths in sorted(methods.items()):
            points = [_point(strength, shown) for strength, shown in strengths.items()]
            curves[label] = sorted(points, key=lambda point: point.bytes.mean)
        found.append(Scene(name, size, curves))
    return found


def _point(strength: float, shown: list[Any]) -> Point:
    columns = {kind: figure([file[kind] for file, _ in shown]) for kind in ("bytes", "psnr", "ssim")}
    return Point(strength, len(shown), **columns, seconds=figure([seconds for _, seconds in shown]))


def bytes_at(curve: Sequence[Point], psnr: float) -> float | None:
    """Returns the bytes of a method at a PSNR in dB, by linear interpolation of their logarithm.

    Returns None outside of the method's points, and the smallest size if the curve meets the PSNR more than once.
    """
    for one, two in pairwise(curve):
        low, high = one.psnr.mean, two.psnr.mean
        if min(low, high) <= psnr <= max(low, high):
            if low == high:
                return one.bytes.mean
            share = (psnr - low) / (high - low)
            return math.exp((1 - share) * math.log(one.bytes.mean) + share * math.log(two.bytes.mean))
    return next((point.bytes.mean for point in curve if point.psnr.mean == psnr), None)


def bd_rate(baseline: Sequence[Point], test: Sequence[Point]) -> float | str:
    """Returns the Bjontegaard delta of the test's bytes from the baseline's, in %, or the reason why there is none.

    The interpolation is that of Akima. Points that are larger but no better than another of their method are omitted,
    because a curve must rise.
    """
    curves = [_rising(curve) for curve in (baseline, test)]
    if any(len(curve) < 2 for curve in curves):
        return "fewer than two points"
    (_, low), (_, high) = curves[0][0], curves[0][-1]
    if curves[1][-1][1] <= low or curves[1][0][1] >= high:
        return "no PSNR in common"
    columns = [[point[i] for point in curve] for curve in curves for i in (0, 1)]
    with warnings.catch_warnings():
        # It warns of curves with less than three quarters of their range in common; the table has the ranges.
        warnings.simplefilter("ignore")
        found = float(bjontegaard.bd_rate(*columns, method="akima", require_matching_points=False, min_overlap=0))
    return found if math.isfinite(found) else "no answer"


def _rising(curve: Sequence[Point]) -> list[tuple[float, float]]:
    kept: list[tuple[float, float]] = []
    for point in curve:
        if not kept or point.psnr.mean > kept[-1][1]:
            kept.append((point.bytes.mean, point.psnr.mean))
    return kept
