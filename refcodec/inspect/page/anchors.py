"""Bits of anchors, over the scene and as a plot."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...bitstream.frame import Frame
from ...pages.plots import F64, Plot, bars
from .measures import BITS_MAX, SceneMeasures
from .pictures import SIDE, AnchorView, drawn

# The share of anchors beyond either end of the scale of colours.
BEYOND = 0.02
# The share of anchors that a view leaves out at either end of an axis, because a few distant ones would make the others
# small.
OUTSIDE = 0.005
# Bars of the plot of bits.
_BARS = 48


def _quantile(counts: NDArray[np.int64], part: float) -> int:
    """Returns the number of bits below which a share of the anchors lies. counts: SceneMeasures.anchor_bits."""
    return int(np.searchsorted(np.cumsum(counts), part * counts.sum()))


def _axes(frame: Frame | None) -> F64:
    """SPEC 7.5.1: returns the principal axes of the file, or those of the world without a frame, float64 [3, 3]."""
    if frame is None:
        return np.eye(3)
    # A row of zeros is allowed and remains.
    rows = frame.matrix.astype(np.float64)
    return np.asarray(rows / np.maximum(np.linalg.norm(rows, axis=1, keepdims=True), 1.0))


def _views(positions: F64, frame: Frame | None) -> list[AnchorView]:
    """Returns the anchors along each of the principal axes, all three in one scale.

    The first one lies as the planes do: columns along the first axis, rows along the second.

    positions: float64 [n, 3], world units, at least one. frame: that of the file.
    """
    place = positions @ _axes(frame).T
    low, high = np.quantile(place, [OUTSIDE, 1 - OUTSIDE], axis=0)
    middle, reach = (low + high) / 2, max(float((high - low).max()) * 0.52, 1e-9)
    unit = (place - middle) / (2 * reach)
    kind = "axis of the world" if frame is None else "principal axis"
    views = []
    for name, across, down in (("third", 0, 1), ("second", 0, 2), ("first", 1, 2)):
        points = np.stack([0.5 + unit[:, across], 0.5 + unit[:, down]], axis=1) * SIDE
        seen = np.asarray(((points >= 0) & (points < SIDE)).all(axis=1))
        views.append(AnchorView(f"along the {name} {kind}", points, seen))
    return views


def bits(measures: SceneMeasures) -> dict[str, Any]:
    """Returns the views, coloured by bits, and a plot of the bits. It is empty without anchors.

    The views are (PNG, name, number of anchors outside) each.
    """
    counts, scene = measures.anchor_bits, measures.scene
    assert scene is not None
    if not counts.sum():
        return {}
    positions, each = measures.sample.joined()
    low, high = (_quantile(counts, part) for part in (BEYOND, 1 - BEYOND))
    high = max(high, low + 1)
    views = [
        (drawn(view, each, low, high), view.name, len(each) - int(view.seen.sum()))
        for view in _views(positions, scene.frame)
    ]
    return {
        "beyond": BEYOND, "low": low, "high": high, "views": views, "sampled": len(each), "plot": _spread(counts),
    }  # fmt: skip


def _spread(counts: NDArray[np.int64]) -> Plot:
    """Returns a plot of the number of anchors by bits."""
    first, last = (_quantile(counts, part) for part in (0.001, 0.999))
    wide = -(-(last + 1 - first) // _BARS)
    ends = first // wide * wide + wide * np.arange((last - first) // wide + 3)
    values = np.diff(np.concatenate([[0], np.cumsum(counts)])[np.minimum(ends, BITS_MAX + 1)])
    left = int(counts.sum() - values.sum())
    more = f"; {left:,} anchors are outside" if left else ""
    marks = [f"{end:,}" for end in ends[:-1].tolist()]
    words = f"bits of the attributes of an anchor; each bar spans {wide}{more}"
    return bars("Number of anchors by bits", values.tolist(), marks, words, "anchors")
