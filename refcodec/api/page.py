"""What a notebook shows of a file or a scene: a table in HTML, and a picture within it."""

from __future__ import annotations

import base64
import html
from collections.abc import Iterable, Mapping

import numpy as np
from numpy.typing import NDArray

from ..files.text import printable

# The longest side of a picture in pixels, and the most points of one.
SIDE = 320
POINTS = 1000
# How much of the points is in the picture, along each axis. The few that are far out would make the others small.
_MIDDLE = 0.02, 0.98
_CELL = "text-align:left;padding:1px 12px 1px 0"


def table(title: str, facts: Iterable[tuple[str, str]], sizes: Mapping[str, int] | None, picture: str = "") -> str:
    """Returns HTML.

    Args:
        title: what it is.
        facts: names and values. Values are text of files, so they are cut and escaped.
        sizes: bytes of each part, or None if they are not known.
        picture: HTML of a picture, or nothing.
    """
    rows = "".join(_row(name, printable(value, 200)) for name, value in facts)
    parts = ""
    if sizes is not None:
        total = sum(sizes.values())
        shown = [_row(name, f"{size:,} bytes", f"{size / total:.1%}") for name, size in sizes.items() if size]
        parts = "".join([*shown, _row("file", f"{total:,} bytes", "")])
    tables = "".join(f"<table>{rows}</table>" for rows in (rows, parts) if rows)
    return (
        '<div style="display:flex;gap:24px;align-items:flex-start">'
        f"<div><b>{html.escape(title)}</b>{tables}</div>{picture}</div>"
    )


def _row(name: str, *values: str) -> str:
    cells = "".join(f'<td style="{_CELL}">{html.escape(value)}</td>' for value in values)
    return f'<tr><th style="{_CELL};font-weight:normal">{html.escape(printable(name, 40))}</th>{cells}</tr>'


def image(png: bytes) -> str:
    """Returns a picture of a PNG file."""
    return f'<img alt="the scene" src="data:image/png;base64,{base64.b64encode(png).decode()}">'


def points(mean: NDArray, colour: NDArray, up_axis: int) -> str:
    """Returns a picture of points from above, as SVG, or nothing if there are none.

    mean: [n, 3]. colour: [n, 3], 0 to 1. up_axis: as SPEC 6.5 has it.
    """
    finite = np.isfinite(mean).all(axis=1) & np.isfinite(colour).all(axis=1)
    mean, colour = mean[finite].astype(np.float64), np.clip(colour[finite], 0, 1)
    if not len(mean):
        return ""
    plane = np.delete(mean, up_axis // 2, axis=1)
    low, high = np.quantile(plane, _MIDDLE, axis=0)
    place = (plane - low) / max(float((high - low).max()), np.finfo(np.float64).tiny) * SIDE
    inside = ((place >= 0) & (place <= SIDE)).all(axis=1)
    place, levels = place[inside], np.floor(colour[inside] * 255 + 0.5).astype(int)
    width, height = np.ceil(np.maximum(place.max(axis=0, initial=1), 1)).astype(int)
    drawn = "".join(
        f'<circle cx="{x:.0f}" cy="{y:.0f}" r="2" fill="#{red:02x}{green:02x}{blue:02x}"/>'
        for (x, y), (red, green, blue) in zip(place.tolist(), levels.tolist(), strict=True)
    )
    return f'<svg role="img" aria-label="the scene from above" width="{width}" height="{height}">{drawn}</svg>'
