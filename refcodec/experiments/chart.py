"""The chart of a demo's trainings: where its lines and words are, for the page's SVG."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from .result import Chart

WIDTH, HEIGHT = 600, 300
LEFT, RIGHT, TOP, BOTTOM = 52, 128, 12, 28
# Height of a line of words.
LINE = 18


@dataclass(frozen=True)
class Layout:
    """Places in the chart, in its units, y downwards.

    across: ticks of seconds, (x, number). up: ticks of PSNR, (y, number). lines: (name, points). names: (name, x, y).
    """

    across: list[tuple[float, float]]
    up: list[tuple[float, float]]
    lines: list[tuple[str, list[tuple[float, float]]]]
    names: list[tuple[str, float, float]]


def ticks(low: float, high: float, count: int) -> list[float]:
    """Round numbers from low to high, about `count` of them."""
    rough = max(high - low, 1e-9) / count
    power = 10.0 ** math.floor(math.log10(rough))
    step = next(power * factor for factor in (1, 2, 5, 10) if power * factor >= rough)
    return [i * step for i in range(math.ceil(low / step), math.floor(high / step + 1e-9) + 1)]


def layout(charts: Sequence[Chart]) -> Layout | None:
    """PSNR over seconds, a line for each training, whose name is at its end; None if there are no points."""
    points = [point for chart in charts for point in chart.points if all(map(math.isfinite, point))]
    if not points:
        return None
    end = max(seconds for seconds, _ in points) or 1.0
    low, high = min(psnr for _, psnr in points), max(psnr for _, psnr in points)
    high = max(high, low + 1)

    def x(seconds: float) -> float:
        return LEFT + (WIDTH - LEFT - RIGHT) * seconds / end

    def y(psnr: float) -> float:
        return TOP + (HEIGHT - TOP - BOTTOM) * (high - psnr) / (high - low)

    lines = []
    for chart in charts:
        kept = [(x(seconds), y(psnr)) for seconds, psnr in chart.points if math.isfinite(psnr)]
        if kept:
            lines.append((chart.name, kept))
    # Names keep a line's height between them.
    names, below = [], -math.inf
    for place, across, name in sorted((kept[-1][1], kept[-1][0], name) for name, kept in lines):
        below = max(place, below + LINE)
        names.append((name, across, below))
    return Layout([(x(t), t) for t in ticks(0, end, 6)], [(y(t), t) for t in ticks(low, high, 8)], lines, names)
