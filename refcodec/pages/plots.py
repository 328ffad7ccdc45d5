"""Plots for SVG: the places of their bars, lines and labels."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]
Ticks = list[tuple[float, str]]


@dataclass(frozen=True)
class Plot:
    """A plot, in units of its own: x to the right, y downwards. A page scales it to its width.

    title: text that describes the plot. up: y and number of each tick of the vertical axis. across: x and number of
    each tick of the horizontal axis. bars: x, y, width, height and title of each. lines: class and SVG path of each.
    """

    WIDTH: ClassVar[int] = 640
    HEIGHT: ClassVar[int] = 240
    LEFT: ClassVar[int] = 62
    TOP: ClassVar[int] = 12
    across_units: ClassVar[int] = 570
    up_units: ClassVar[int] = 188

    title: str
    x_label: str
    y_label: str
    up: Ticks
    across: Ticks
    bars: Sequence[tuple[float, float, float, float, str]] = ()
    lines: Sequence[tuple[str, str]] = ()


def _x(unit: float) -> float:
    return round(Plot.LEFT + unit * Plot.across_units, 2)


def _y(unit: float) -> float:
    return round(Plot.TOP + (1 - unit) * Plot.up_units, 2)


def _path(points: Sequence[tuple[float, float]]) -> str:
    """Returns the path of a line. points: x and y from 0 to 1."""
    return "M" + "L".join(f"{_x(x):g} {_y(y):g}" for x, y in points)


def _bar(left: float, width: float, height: float, title: str) -> tuple[float, float, float, float, str]:
    """Returns a bar. left, width, height: from 0 to 1."""
    units = round(height * Plot.up_units, 2)
    return _x(left), round(_y(0) - units, 2), round(width * Plot.across_units, 2), units, title


def _step(span: float, most: int) -> float:
    """Returns the tick step for a span: 1, 2 or 5 times a power of ten. most: the largest number of ticks."""
    rough = max(span, 1e-9) / most
    power = 10.0 ** math.floor(math.log10(rough))
    return next(m * power for m in (1, 2, 5, 10) if m * power >= rough * (1 - 1e-9))


def _ticks(low: float, high: float, most: int) -> list[tuple[float, str]]:
    """Returns round numbers from low to high, each with its text."""
    step = _step(high - low, most)
    digits = max(0, -math.floor(math.log10(step)))
    numbers = [i * step for i in range(math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9) + 1)]
    return [(number, f"{number:,.{digits}f}") for number in numbers]


def bars(title: str, values: Sequence[float], labels: Sequence[str], x_label: str, y_label: str) -> Plot:
    """Returns a plot of bars from 0 up. labels: those below the bars; some are left out where there are many."""
    most = max([*values, 1e-9])
    step = _step(most, 5)
    top = step * math.ceil(most / step - 1e-9)
    each = 1 / max(1, len(values))
    room = 7.5 * (1 + max([len(label) for label in labels], default=0))
    every = max(1, math.ceil(room * len(labels) / Plot.across_units))
    return Plot(
        title,
        x_label,
        y_label,
        [(_y(number / top), text) for number, text in _ticks(0, top, 5)],
        [(_x((i + 0.5) * each), label) for i, label in enumerate(labels) if i % every == 0],
        [
            _bar((i + 0.1) * each, 0.8 * each, value / top, f"{label}: {value:,.4g}")
            for i, (value, label) in enumerate(zip(values, labels, strict=True))
        ],
    )


def lines(title: str, series: Mapping[str, Sequence[tuple[float, float]]], x_label: str, y_label: str) -> Plot | None:
    """Returns a plot of lines, or None without a finite point.

    series: the points of each line, by its class. Points that are not finite are left out.
    """
    kept = {name: [point for point in points if all(map(math.isfinite, point))] for name, points in series.items()}
    every = [point for points in kept.values() for point in points]
    if not every:
        return None
    end = max(x for x, _ in every) or 1.0
    low, high = min(y for _, y in every), max(y for _, y in every)
    span = max(high - low, 1.0)
    return Plot(
        title,
        x_label,
        y_label,
        [(_y((number - low) / span), text) for number, text in _ticks(low, low + span, 8)],
        [(_x(number / end), text) for number, text in _ticks(0, end, 6)],
        lines=[
            (name, _path([(x / end, (y - low) / span) for x, y in points])) for name, points in kept.items() if points
        ],
    )
