"""What each anchor costs: its bits drawn over the scene, and by its distance from the middle."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...bitstream.cameras import NamedCamera
from .markup import NUMBER, TEXT, count, image, share, size, table, tag, text
from .measures import BITS_MAX, Measures
from .pictures import colour_bar, palette, png
from .plots import bars
from .views import OUTSIDE, View, camera_view, drawn, side_views

F64 = NDArray[np.float64]

# Bars of the plots, and the share of anchors that the scale of colours leaves out at either end.
_BARS = 48
_BEYOND = 0.02
_RINGS = 10


def _quantile(counts: NDArray[np.int64], part: float) -> int:
    """The number of bits that a share of the anchors is below. counts: Measures.anchor_bits."""
    return int(np.searchsorted(np.cumsum(counts), part * counts.sum()))


def section(measures: Measures, facts: Mapping[str, Any], cameras: list[NamedCamera]) -> str:
    """Returns the section of the page. facts: those of summary.document. cameras: of the file."""
    heading = tag("h2", "Bits per anchor")
    if not facts["header"]["anchor_count"]:
        return tag("section", heading, tag("p", "The file has no anchors."), id="anchors")
    positions, bits, _ = measures.sample.joined()
    counts = measures.anchor_bits
    low, high = (_quantile(counts, part) for part in (_BEYOND, 1 - _BEYOND))
    high = max(high, low + 1)
    assert measures.scene is not None
    views = side_views(positions, measures.scene.frame)
    if cameras:
        seen = camera_view(positions, cameras[0], measures.scene.render.near_plane)
        views += [seen] if seen.seen.any() else []
    step = measures.sample.step
    sampled = f"Every {step}th anchor is drawn, {len(bits):,} of them. " if step > 1 else ""
    pictures = tag("div", *(_picture(view, bits, low, high) for view in views), class_="pictures")
    beyond = f"{100 * _BEYOND:.0f} % of the anchors are below, {100 * _BEYOND:.0f} % above"
    scale = colour_bar(f"{low:,} bits", f"{high:,} bits and more", beyond, palette())
    return tag(
        "section",
        heading,
        tag(
            "p",
            "What the attributes of each anchor take (features, scalings and kept offsets), by the frequencies that "
            "they are decoded with (SPEC 8.4). The paper's figure 3 shows the same of its scene. "
            f"{sampled}A pixel has the mean of the anchors on it. The views along axes are in one scale. "
            f"{100 * OUTSIDE} % of the anchors at either end of an axis may lie outside.",
        ),
        pictures,
        scale,
        tag("div", _spread(counts), _rings(positions, bits), class_="plots"),
        _accounts(measures, facts),
        id="anchors",
    )


def _picture(view: View, bits: F64, low: float, high: float) -> str:
    words = f"anchors {view.name}, coloured by their bits"
    outside = len(bits) - int(view.seen.sum())
    more = f"; {outside:,} of {len(bits):,} are outside" if outside else ""
    return tag(
        "figure", image(png(drawn(view, bits, low, high), palette()), words), tag("figcaption", text(view.name + more))
    )


def _spread(counts: NDArray[np.int64]) -> str:
    """How many anchors take so many bits."""
    first, last = (_quantile(counts, part) for part in (0.001, 0.999))
    wide = -(-(last + 1 - first) // _BARS)
    ends = first // wide * wide + wide * np.arange((last - first) // wide + 3)
    values = np.diff(np.concatenate([[0], np.cumsum(counts)])[np.minimum(ends, BITS_MAX + 1)])
    left = int(counts.sum() - values.sum())
    more = f"; {left:,} anchors are outside" if left else ""
    labels = [f"{first:,}" for first in ends[:-1].tolist()]
    plot = bars(
        "how many anchors take how many bits",
        values.tolist(),
        labels,
        f"bits of an anchor's attributes, from; a bar is {wide} wide{more}",
        "anchors",
    )
    return tag("figure", plot, tag("figcaption", "How many anchors take how many bits"))


def _rings(positions: F64, bits: F64) -> str:
    """The mean bits of anchors by their distance from the middle of the scene."""
    away = np.linalg.norm(positions - np.median(positions, axis=0), axis=1)
    order = np.argsort(away, kind="stable")
    groups = [each for each in np.array_split(order, min(_RINGS, len(order))) if len(each)]
    values = [float(bits[each].mean()) for each in groups]
    labels = [f"{float(away[each].max()):.3g}" for each in groups]
    plot = bars(
        "mean bits by distance",
        values,
        labels,
        "distance from the median anchor, up to, in world units; each bar has as many anchors",
        "bits per anchor",
    )
    return tag(
        "figure",
        plot,
        tag(
            "figcaption",
            "Bits from the middle outwards. By the paper, a training that counts the rate of all anchors alike (USRO) "
            "gives those in the middle more bits than those outside, and one that counts visible anchors (ViSRO) not.",
        ),
    )


def _accounts(measures: Measures, facts: Mapping[str, Any]) -> str:
    """The bits of the symbols beside the bytes of the parts that hold them."""
    rows = []
    parts = {**facts["parts"]}
    parts["positions"] = parts.get("positions", 0) - measures.raw_positions
    planes = facts.get("planes")
    parts["planes"] = sum(planes.values()) if planes else 0
    for name in ("planes", "positions", "masks", "attributes"):
        if not parts.get(name) or name not in measures.bits:
            continue
        coded, held = measures.bits[name] / 8, parts[name]
        rows.append(
            (
                tag("b", text(name)),
                f'<data value="{coded:.3f}">{count(coded, 1)}</data>',
                f'<data value="{held}">{held:,}</data>',
                count(held - coded, 1),
                share(held - coded, held),
            )
        )
    columns = [
        ("substreams of", TEXT),
        ("bytes by the models", NUMBER),
        ("bytes in the file", NUMBER),
        ("more, in bytes", NUMBER),
        ("share", NUMBER),
    ]
    raw = f" Raw positions take {size(measures.raw_positions)}." if measures.raw_positions else ""
    return (
        tag("h3", "From bits to bytes")
        + tag(
            "p",
            "Each substream takes more than its symbols: a head of 8 bytes, the states of its lanes of 4 bytes each "
            f"(of which the symbols use about half), and roundings.{raw}",
        )
        + table(columns, rows, id="accounts")
    )
