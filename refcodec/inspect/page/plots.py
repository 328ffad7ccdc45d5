"""Plots as SVG. Their colours are those of the page, which inspect.css gives to the classes of their parts."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from .markup import tag, text

F64 = NDArray[np.float64]

# The size of a plot, and the room for what stands around it, in units of its own. A page scales it to its width.
WIDTH, HEIGHT = 640, 240
_LEFT, _RIGHT, _TOP, _BOTTOM = 62, 8, 12, 40
_ACROSS, _UP = WIDTH - _LEFT - _RIGHT, HEIGHT - _TOP - _BOTTOM
# The most bars of a histogram.
_BARS = 160


def _number(value: float) -> str:
    """A coordinate, or a number at an axis."""
    return f"{value:.2f}".rstrip("0").rstrip(".")


def _step(span: float, most: int) -> float:
    """The distance of at most so many round numbers that cover a span: 1, 2 or 5 times a power of ten."""
    rough = max(span, 1e-9) / most
    power = 10.0 ** math.floor(math.log10(rough))
    return next(m * power for m in (1, 2, 5, 10) if m * power >= rough * (1 - 1e-9))


def _x(unit: float) -> float:
    return _LEFT + unit * _ACROSS


def _y(unit: float) -> float:
    return _TOP + (1 - unit) * _UP


def _label(x: float, y: float, words: str, **attributes: object) -> str:
    return tag("text", text(words), x=_number(x), y=_number(y), **attributes)


def _plot(words: str, x_label: str, y_label: str, marks: Sequence[tuple[float, str]], *parts: str) -> str:
    """A plot.

    words: what it shows. marks: of the axis upwards, as (place from 0 to 1, number). parts: of the plot.
    """
    axis = [
        f'<path class="grid" d="M{_LEFT} {_number(_y(place))}h{_ACROSS}"/>'
        + _label(_LEFT - 6, _y(place) + 4, number, text_anchor="end")
        for place, number in marks
    ]
    axis.append(f'<path class="axis" d="M{_LEFT} {_TOP}v{_UP}h{_ACROSS}"/>')
    axis.append(_label(_x(0.5), HEIGHT - 5, x_label, text_anchor="middle"))
    middle = _TOP + _UP / 2
    axis.append(_label(13, middle, y_label, text_anchor="middle", transform=f"rotate(-90 13 {_number(middle)})"))
    return (
        f'<svg class="plot" viewBox="0 0 {WIDTH} {HEIGHT}" role="img" aria-label="{text(words)}">'
        + "".join((*axis, *parts))
        + "</svg>\n"
    )


def bars(
    words: str,
    values: Sequence[float],
    labels: Sequence[str],
    x_label: str,
    y_label: str,
    expected: Sequence[float] | None = None,
) -> str:
    """Returns a plot of bars from 0 up.

    words: what it shows. labels: below the bars. Where there are many, some are left out. expected: a value for each
    bar that is drawn as a line across it.
    """
    most = max([*values, *(expected or ()), 1e-9])
    step = _step(most, 5)
    top = step * math.ceil(most / step - 1e-9)
    digits = max(0, -math.floor(math.log10(step)))
    marks = [(i * step / top, f"{i * step:,.{digits}f}") for i in range(round(top / step) + 1)]
    each = 1 / max(1, len(values))
    room = 7.5 * (1 + max([len(label) for label in labels], default=0))
    every = max(1, math.ceil(room * len(labels) / _ACROSS))
    parts = []
    for i, (value, label) in enumerate(zip(values, labels, strict=True)):
        left, wide = _x((i + 0.1) * each), 0.8 * each * _ACROSS
        high = value / top * _UP
        parts.append(
            f'<rect class="bar" x="{_number(left)}" y="{_number(_y(0) - high)}" width="{_number(wide)}" '
            f'height="{_number(high)}"><title>{text(label)}: {value:,.4g}</title></rect>'
        )
        if expected is not None:
            y = _y(expected[i] / top)
            parts.append(f'<path class="curve" d="M{_number(left)} {_number(y)}h{_number(wide)}"/>')
        if i % every == 0:
            parts.append(_label(_x((i + 0.5) * each), _y(0) + 15, label, text_anchor="middle"))
    return _plot(words, x_label, y_label, marks, *parts)


def histogram(words: str, counts: NDArray[np.int64], curve: F64, x_label: str, y_label: str) -> str:
    """Returns a plot of how often values were met, as bars, and how often a model expected them, as a line.

    The axis upwards is logarithmic, from half a time on. Values are joined where there are too many for bars.

    words: what the plot shows. counts: int64 [2 n + 1], of the values -n to n. curve: float64 of the same shape.
    """
    limit = len(counts) // 2
    seen = np.flatnonzero((counts > 0) | (curve >= 0.5)) - limit
    # At least three values, so that a bar is no wall.
    first, last = int(min(seen.min(initial=limit), -1)), int(max(seen.max(initial=-limit), 1))
    join = -(-(last + 1 - first) // _BARS)
    edges = first + join * np.arange(-(-(last + 1 - first) // join) + 1)
    met, expected = (_joined(each, edges + limit) / join for each in (counts.astype(np.float64), curve))
    highest = max(float(met.max()), float(expected.max()), 10.0)
    decades = math.ceil(math.log10(highest) - 1e-9)
    low = math.log10(0.5)

    def up(value: float) -> float:
        return max(0.0, (math.log10(max(value, 0.5)) - low) / (decades - low))

    marks = [(up(10.0**d), f"{10**d:,}") for d in range(decades + 1)]
    wide = 1 / len(met)
    filled, line = [], []
    for i, (value, wanted) in enumerate(zip(met.tolist(), expected.tolist(), strict=True)):
        if value:
            high = max(up(value) * _UP, 1.0)
            filled.append(
                f"M{_number(_x(i * wide))} {_number(_y(0))}v{_number(-high)}h{_number(wide * _ACROSS)}v{_number(high)}z"
            )
        line.append(f"{_number(_x((i + 0.5) * wide))} {_number(_y(up(wanted)))}")
    parts = [f'<path class="bar" d="{"".join(filled)}"/>', f'<path class="curve" d="M{"L".join(line)}"/>']
    step = max(1, round(_step(last - first, 9)))
    for value in range(-(-first // step) * step, last + 1, step):
        at = (value - first + 0.5) / join * wide
        parts.append(_label(_x(at), _y(0) + 15, f"{value:,}", text_anchor="middle"))
    more = f"; a bar is the mean of {join}" if join > 1 else ""
    return _plot(words, x_label + more, y_label, marks, *parts)


def _joined(each: F64, edges: NDArray[np.int64]) -> F64:
    """Returns the sums between edges of what stands at 0, 1 and so on. Edges may lie outside."""
    total = np.concatenate([[0.0], np.cumsum(each)])
    return np.maximum(np.diff(total[np.clip(edges, 0, len(each))]), 0.0)
