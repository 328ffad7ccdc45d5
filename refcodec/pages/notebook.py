"""The HTML by which a notebook shows a file or a scene: a table, and a picture beside it."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .environment import render

# The longest side of a picture in pixels, and the most points of one.
SIDE = 320
POINTS = 1000
# The quantiles of the points at the ends of each axis of a picture. Without them, a few distant points would make the
# others small.
_MIDDLE = 0.02, 0.98


@dataclass(frozen=True)
class Points:
    """A picture of points. width, height: in pixels. circles: x, y and colour of each, the last one as in CSS."""

    width: int
    height: int
    circles: list[tuple[int, int, str]]


def table(
    title: str, facts: Iterable[tuple[str, str]], sizes: Mapping[str, int] | None, picture: bytes | Points | None = None
) -> str:
    """Returns HTML.

    Args:
        title: the heading.
        facts: names and values. Values are cut and escaped, because they are texts from files.
        sizes: the bytes of each part, or None if they are not known.
        picture: a PNG file, points, or None.
    """
    template = Path(__file__).with_name("notebook.html")
    return render(template, title=title, facts=facts, sizes=sizes, picture=picture)


def points(mean: NDArray[Any], colour: NDArray[Any], up_axis: int) -> Points | None:
    """Returns a picture of points from above, or None without finite points.

    mean: [n, 3]. colour: [n, 3], 0 to 1. up_axis: as in SPEC 6.5.
    """
    finite = np.isfinite(mean).all(axis=1) & np.isfinite(colour).all(axis=1)
    mean, colour = mean[finite].astype(np.float64), np.clip(colour[finite], 0, 1)
    if not len(mean):
        return None
    plane = np.delete(mean, up_axis // 2, axis=1)
    low, high = np.quantile(plane, _MIDDLE, axis=0)
    place = (plane - low) / max(float((high - low).max()), np.finfo(np.float64).tiny) * SIDE
    inside = ((place >= 0) & (place <= SIDE)).all(axis=1)
    place, levels = place[inside], np.floor(colour[inside] * 255 + 0.5).astype(int)
    width, height = np.ceil(np.maximum(place.max(axis=0, initial=1), 1)).astype(int).tolist()
    circles = [
        (round(x), round(y), f"#{red:02x}{green:02x}{blue:02x}")
        for (x, y), (red, green, blue) in zip(place.tolist(), levels.tolist(), strict=True)
    ]
    return Points(width, height, circles)
