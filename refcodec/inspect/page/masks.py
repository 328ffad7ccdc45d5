"""Which offsets are kept: by their place, by anchor, and by how many cameras see the anchor."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...bitstream.cameras import NamedCamera
from ...bitstream.scene import Scene
from ...bitstream.tables import TOTAL
from .markup import image, share, tag, text
from .measures import Measures
from .pictures import colour_bar, palette, png
from .plots import bars
from .views import drawn, projected, side_views

F64 = NDArray[np.float64]

# The most cameras that anchors are counted with, and the most bars of a plot.
CAMERAS_MAX = 256
_BARS = 12


def section(measures: Measures, cameras: list[NamedCamera]) -> str:
    """Returns the section of the page. cameras: of the file."""
    assert measures.scene is not None
    heading = tag("h2", "Masks")
    total = int(measures.mask_counts.sum())
    if not total:
        return tag("section", heading, tag("p", "The file has no anchors."), id="masks")
    kept = int(measures.mask_counts[1].sum())
    none = int(measures.kept[0])
    return tag(
        "section",
        heading,
        tag(
            "p",
            f"{kept:,} of {total:,} offsets are kept ({share(kept, total)}). {none:,} of "
            f"{int(measures.kept.sum()):,} anchors keep none, and give no Gaussians. The mask bits take "
            f"{measures.bits['masks'] / total:.3f} bits each.",
        ),
        tag("div", _by_place(measures), _by_anchor(measures), _bits(measures), _picture(measures), class_="plots"),
        tag("h3", "By view frequency"),
        tag(
            "p",
            "A training that masks by view frequency, as the paper's does, counts how often each anchor is drawn. A "
            "file does not hold these counts. What it has of them are the masks (SPEC 6.12).",
        ),
        _by_cameras(measures, cameras),
        id="masks",
    )


def _by_place(measures: Measures) -> str:
    """The share of anchors that keep offset k, and that which the model expected in the contexts that it met."""
    assert measures.scene is not None
    offsets = measures.scene.dimensions.offset_count
    model = measures.scene.mask_model.astype(np.float64) / TOTAL
    met = measures.mask_counts.sum(axis=0)
    first = np.arange(offsets) * np.arange(1, offsets + 1) // 2
    anchors = np.add.reduceat(met, first)
    values = 100 * np.add.reduceat(measures.mask_counts[1], first) / anchors
    expected = 100 * np.add.reduceat(met * model, first) / anchors
    plot = bars(
        "share of anchors that keep each offset",
        values.tolist(),
        [str(k) for k in range(offsets)],
        "offset k",
        "anchors that keep it, in %",
        expected.tolist(),
    )
    words = "The share of anchors that keep offset k. The line is what the mask model expected (SPEC 7.6)."
    return tag("figure", plot, tag("figcaption", words))


def kept_by_model(scene: Scene) -> F64:
    """SPEC 7.6: returns the probability that an anchor keeps 0 to K offsets by the mask model, float64 [K + 1]."""
    found = np.ones(1)
    for k in range(scene.dimensions.offset_count):
        keep = scene.mask_model[k * (k + 1) // 2 :][: k + 1].astype(np.float64) / TOTAL
        found = np.append(found * (1 - keep), 0.0) + np.append(0.0, found * keep)
    return found


def _by_anchor(measures: Measures) -> str:
    """How many anchors keep so many offsets."""
    assert measures.scene is not None
    anchors = int(measures.kept.sum())
    plot = bars(
        "share of anchors by kept offsets",
        (100 * measures.kept / anchors).tolist(),
        [str(k) for k in range(len(measures.kept))],
        "kept offsets of an anchor",
        "anchors, in %",
        (100 * kept_by_model(measures.scene)).tolist(),
    )
    words = "The share of anchors that keep so many offsets. The line is what the mask model alone would draw."
    return tag("figure", plot, tag("figcaption", words))


def _bits(measures: Measures) -> str:
    """The mean bits of anchors that keep so many offsets."""
    values = measures.kept_bits / np.maximum(measures.kept, 1)
    labels = [str(k) for k in range(len(values))]
    words = "What the attributes of an anchor take, by its kept offsets, in the mean"
    return tag(
        "figure",
        bars(words, values.tolist(), labels, "kept offsets of an anchor", "bits per anchor"),
        tag("figcaption", words + "."),
    )


def _picture(measures: Measures) -> str:
    """How many offsets the anchors keep, over the scene."""
    assert measures.scene is not None
    scene = measures.scene
    positions, _, kept = measures.sample.joined()
    most = max(1, int(np.flatnonzero(measures.kept).max()))
    view = side_views(positions, scene.frame)[0]
    words = f"Kept offsets of the anchors {view.name}, as in the pictures above."
    return tag(
        "figure",
        image(png(drawn(view, kept.astype(np.float64), 0, most), palette()), words, class_="scene"),
        colour_bar("0", f"{most} kept offsets", "", palette()),
        tag("figcaption", words),
    )


def _by_cameras(measures: Measures, cameras: list[NamedCamera]) -> str:
    """The share of kept offsets and the bits of anchors, by how many cameras of the file see the anchor."""
    assert measures.scene is not None
    if len(cameras) < 2:
        has = "one camera" if cameras else "no camera"
        return tag(
            "p",
            f"The file has {has} (SPEC 6.15). So it cannot be counted how many cameras see an anchor.",
            class_="soft",
        )
    every = -(-len(cameras) // CAMERAS_MAX)
    chosen = cameras[::every]
    positions, bits, kept = measures.sample.joined()
    seen = np.zeros(len(positions), dtype=np.int64)
    for camera in chosen:
        seen += projected(positions, camera, measures.scene.render.near_plane)[1]
    most = int(seen.max())
    wide = -(-(most + 1) // _BARS)
    group = seen // wide
    groups = most // wide + 1
    anchors = np.bincount(group, minlength=groups)
    labels = [
        str(first) if wide == 1 or first == most else f"{first}-{min(first + wide - 1, most)}"
        for first in range(0, groups * wide, wide)
    ]
    offsets = measures.scene.dimensions.offset_count
    among = np.maximum(anchors, 1)
    words = f"cameras that have the anchor in their picture, of {len(chosen):,}"
    plots = [
        (100 * np.bincount(group, kept, groups) / among / offsets, "offsets kept, in %", "Offsets that are kept"),
        (np.bincount(group, bits, groups) / among, "bits per anchor", "Bits of the attributes of an anchor"),
        (anchors.astype(np.float64), "anchors", "Anchors"),
    ]
    figures = [
        tag("figure", bars(title, values.tolist(), labels, words, unit), tag("figcaption", text(title)))
        for values, unit, title in plots
    ]
    some = f"Every {every}th of its {len(cameras):,} cameras is counted. " if every > 1 else ""
    step = measures.sample.step
    sampled = f"Every {step}th anchor is counted. " if step > 1 else ""
    return tag(
        "p",
        "By the file's cameras instead (SPEC 6.15): how many of them have the anchor in their picture. Whether another "
        f"one hides it is not looked at. {some}{sampled}",
    ) + tag("div", *figures, class_="plots")
