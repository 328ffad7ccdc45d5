"""Bits and masks of anchors: over the scene, by distance, and by the cameras that see them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...bitstream.cameras import NamedCamera
from ...bitstream.scene import Scene
from ...bitstream.tables import TOTAL
from ...pages.plots import F64, Plot, bars
from .measures import BITS_MAX, Measures
from .views import camera_view, drawn, projected, side_views

# The share of anchors beyond either end of the scale of colours.
BEYOND = 0.02
# The most cameras that are counted.
CAMERAS_MAX = 256
# Bars of the plots: bits, distances, cameras.
_BARS = 48
_RINGS = 10
_GROUPS = 12


def _quantile(counts: NDArray[np.int64], part: float) -> int:
    """Returns the number of bits below which a share of the anchors lies. counts: Measures.anchor_bits."""
    return int(np.searchsorted(np.cumsum(counts), part * counts.sum()))


def bits(measures: Measures, cameras: list[NamedCamera]) -> dict[str, Any]:
    """Returns the views, coloured by bits, and plots of the bits. It is empty without anchors.

    The views are (PNG, name, number of anchors outside) each.
    """
    counts, scene = measures.anchor_bits, measures.scene
    assert scene is not None
    if not counts.sum():
        return {}
    positions, each, _ = measures.sample.joined()
    low, high = (_quantile(counts, part) for part in (BEYOND, 1 - BEYOND))
    high = max(high, low + 1)
    views = side_views(positions, scene.frame)
    if cameras:
        seen = camera_view(positions, cameras[0], scene.render.near_plane)
        views += [seen] if seen.seen.any() else []
    pictures = [(drawn(view, each, low, high), view.name, len(each) - int(view.seen.sum())) for view in views]
    return {
        "beyond": BEYOND,
        "low": low,
        "high": high,
        "views": pictures,
        "sampled": len(each),
        "plots": (_spread(counts), _rings(positions, each)),
    }


def _spread(counts: NDArray[np.int64]) -> Plot:
    """Returns a plot of the number of anchors by bits."""
    first, last = (_quantile(counts, part) for part in (0.001, 0.999))
    wide = -(-(last + 1 - first) // _BARS)
    ends = first // wide * wide + wide * np.arange((last - first) // wide + 3)
    values = np.diff(np.concatenate([[0], np.cumsum(counts)])[np.minimum(ends, BITS_MAX + 1)])
    left = int(counts.sum() - values.sum())
    more = f"; {left:,} anchors are outside" if left else ""
    return bars(
        "Number of anchors by bits",
        values.tolist(),
        [f"{end:,}" for end in ends[:-1].tolist()],
        f"bits of the attributes of an anchor; each bar spans {wide}{more}",
        "anchors",
    )


def _rings(positions: F64, each: F64) -> Plot:
    """Returns a plot of the mean bits of anchors by their distance from the middle of the scene."""
    away = np.linalg.norm(positions - np.median(positions, axis=0), axis=1)
    order = np.argsort(away, kind="stable")
    groups = [group for group in np.array_split(order, min(_RINGS, len(order))) if len(group)]
    return bars(
        "Mean bits by distance",
        [float(each[group].mean()) for group in groups],
        [f"{float(away[group].max()):.3g}" for group in groups],
        "upper bound of the distance from the median anchor, world units; as many anchors in each bar",
        "bits per anchor",
    )


def masks(measures: Measures, cameras: list[NamedCamera]) -> dict[str, Any]:
    """Returns counts, plots and a picture of the masks. It is empty without anchors."""
    scene, total = measures.scene, int(measures.mask_counts.sum())
    assert scene is not None
    if not total:
        return {}
    k, anchors = scene.dimensions.offset_count, int(measures.kept.sum())
    # The contexts of each offset are in a row.
    met, first = measures.mask_counts.sum(axis=0), np.arange(k) * np.arange(1, k + 1) // 2
    kept, expected = (
        100 * np.add.reduceat(each, first) / np.add.reduceat(met, first)
        for each in (measures.mask_counts[1], met * scene.mask_model.astype(np.float64) / TOTAL)
    )
    counts = [str(number) for number in range(k + 1)]
    by_place = bars(
        "Share of anchors that keep offset k", kept.tolist(), counts[:-1], "offset k", "anchors, %", expected.tolist()
    )
    by_anchor = bars(
        "Share of anchors by kept offsets",
        (100 * measures.kept / anchors).tolist(),
        counts,
        "kept offsets",
        "anchors, %",
        (100 * kept_by_model(scene)).tolist(),
    )
    mean_bits = measures.kept_bits / np.maximum(measures.kept, 1)
    by_kept = bars(
        "Mean bits of the attributes of an anchor, by kept offsets",
        mean_bits.tolist(),
        counts,
        "kept offsets",
        "bits per anchor",
    )
    positions, each, held = measures.sample.joined()
    most = max(1, int(np.flatnonzero(measures.kept).max()))
    view = side_views(positions, scene.frame)[0]
    return {
        "total": total,
        "kept": int(measures.mask_counts[1].sum()),
        "plots": (by_place, by_anchor, by_kept),
        "picture": drawn(view, held.astype(np.float64), 0, most),
        "view": view.name,
        "most": most,
        "cameras": len(cameras),
        "every": -(-len(cameras) // CAMERAS_MAX),
        "by_cameras": _by_cameras(scene, positions, each, held, cameras) if len(cameras) > 1 else (),
    }


def kept_by_model(scene: Scene) -> F64:
    """SPEC 7.6: returns the probability that an anchor keeps 0 to K offsets by the mask model, float64 [K + 1]."""
    found = np.ones(1)
    for k in range(scene.dimensions.offset_count):
        keep = scene.mask_model[k * (k + 1) // 2 :][: k + 1].astype(np.float64) / TOTAL
        found = np.append(found * (1 - keep), 0.0) + np.append(0.0, found * keep)
    return found


def _by_cameras(
    scene: Scene, positions: F64, each: F64, held: NDArray[np.int64], cameras: list[NamedCamera]
) -> list[Plot]:
    """Returns plots of kept offsets, bits and anchors by the number of cameras that see an anchor.

    positions, each, held: of the sample of anchors, its bits and kept offsets.
    """
    chosen = cameras[:: -(-len(cameras) // CAMERAS_MAX)]
    seen = np.zeros(len(positions), dtype=np.int64)
    for camera in chosen:
        seen += projected(positions, camera, scene.render.near_plane)[1]
    most = int(seen.max())
    wide = -(-(most + 1) // _GROUPS)
    group, groups = seen // wide, most // wide + 1
    anchors = np.bincount(group, minlength=groups)
    among = np.maximum(anchors, 1)
    labels = [
        str(first) if wide == 1 or first == most else f"{first}-{min(first + wide - 1, most)}"
        for first in range(0, groups * wide, wide)
    ]
    share = 100 * np.bincount(group, held, groups) / among / scene.dimensions.offset_count
    plots = (
        ("Kept offsets", share, "offsets kept, %"),
        ("Bits of the attributes of an anchor", np.bincount(group, each, groups) / among, "bits per anchor"),
        ("Anchors", anchors, "anchors"),
    )
    across = f"cameras with the anchor in their image, of {len(chosen):,}"
    return [bars(title, values.tolist(), labels, across, unit) for title, values, unit in plots]
