"""The planes of the hyperprior as pictures, channel by channel."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...bitstream.planes import PLANES, assemble_planes
from .markup import count, image, tag, text
from .measures import Measures
from .pictures import colour_bar, png

# The most pixels along a side of a picture. A larger plane is drawn with the means of its points.
_SIDE = 192
# The share of symbols that the scale of greys holds.
_HELD = 0.995


def section(measures: Measures) -> str:
    """Returns the section of the page."""
    assert measures.scene is not None
    scene, heading = measures.scene, tag("h2", "Planes")
    d = scene.dimensions
    if not d.plane_channels:
        return tag("section", heading, tag("p", "The file has no planes."), id="planes")
    bits = measures.tallies["planes"].channel_bits.reshape(PLANES, d.plane_channels)
    parts = []
    for r, plane in enumerate(assemble_planes(scene.planes), 1):
        taken = bits[0] if r == 1 else bits[1:].sum(axis=0)
        parts.append(_plane(r, plane, taken))
    return tag(
        "section",
        heading,
        tag(
            "p",
            "What the entropy model knows of places (SPEC 7.3): two planes along the first two principal axes, in "
            f"{d.plane_channels} channels each. Columns count along the first axis, rows along the second. The plane "
            "of r = 2 is coded as four quadrants, which are joined here. A context is sampled from both (SPEC 7.5.4).",
        ),
        *parts,
        id="planes",
    )


def _plane(r: int, plane: NDArray[np.int16], bits: NDArray[np.float64]) -> str:
    """One plane: int16 [ch, s, s]. bits: float64 [ch], what the symbols of each channel take."""
    magnitude = np.sort(np.abs(plane), axis=None)
    most = max(1, int(magnitude[int(_HELD * (len(magnitude) - 1))]))
    side = plane.shape[1]
    join = -(-side // _SIDE)
    figures = []
    for channel, symbols in enumerate(plane):
        grey = np.clip(_means(symbols, join) / most, -1, 1)
        shown = f"plane of r = {r}, channel {channel}"
        zero = float((symbols == 0).mean())
        caption = (
            f"channel {channel}: {symbols.min()} to {symbols.max()}, {zero:.0%} zeros, {count(bits[channel] / 8)} bytes"
        )
        picture = image(png(np.floor(127.5 + 127.5 * grey).astype(np.uint8)), shown, class_="sharp")
        figures.append(tag("figure", picture, tag("figcaption", text(caption))))
    words = "symbol, in plane steps. Middle grey is 0. Larger ones have the grey of the end."
    if join > 1:
        words += f" A pixel is the mean of {join} x {join} points."
    return (
        tag("h3", f"r = {r}: {side} x {side} points, {count(float(bits.sum()) / 8)} bytes of symbols")
        + tag("div", *figures, class_="planes")
        + colour_bar(
            f"-{most}",
            f"+{most}",
            words,
        )
    )


def _means(symbols: NDArray[np.int16], join: int) -> NDArray[np.float64]:
    """Returns the means of blocks of join x join points. Those at the ends may be smaller."""
    edges = np.arange(0, len(symbols), join)
    total = np.add.reduceat(np.add.reduceat(symbols.astype(np.float64), edges, axis=0), edges, axis=1)
    size = np.minimum(len(symbols) - edges, join)
    return np.asarray(total / (size[:, None] * size[None]))
