"""The numbers of one anchor, from its position to its symbols (SPEC.md D.4)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from ..bitstream.codec import Coding
from ..bitstream.context import contract, frame_coordinates, positional_encoding, query, rescale
from ..bitstream.planes import assemble_planes
from ..bitstream.positions import position_integers
from ..bitstream.scene import Scene


def anchor_rows(scene: Scene, number: int) -> Iterator[tuple[str, str, str]]:
    """Yields the quantities that clauses 7.4 to 7.10 compute for an anchor, as in Annex D.4.

    They lead from the position to the distributions and the symbols. Each is (what it is, clause, numbers). Raises
    IndexError for an anchor that the scene does not have.
    """
    if not 0 <= number < scene.anchor_count:
        raise IndexError(number)

    def row(what: str, clause: str, values: Iterable[object]) -> tuple[str, str, str]:
        return what, clause, ", ".join(str(value) for value in values)

    d, at = scene.dimensions, slice(number, number + 1)
    p = position_integers(scene.positions[at])
    yield row("P of x, y, z", "7.4", p[0])
    if scene.frame is not None:
        v = frame_coordinates(scene.frame, p)
        w = contract(v)
        u = rescale(scene.frame, w)
        for what, clause, values in (("v", "7.5.1", v), ("w", "7.5.2", w), ("u", "7.5.3", u)):
            yield row(what, clause, values[0])
        for r, plane in enumerate(assemble_planes(scene.planes) if d.plane_channels else (), 1):
            yield row(f"samples of the plane of r = {r}", "7.5.4", query(plane, u[:, :2], scene.plane_shift)[0])
        yield row("positional encoding", "7.5.5", positional_encoding(u[:, 2], d.frequency_count)[0])
    coding, width = Coding(scene), d.attribute_width
    hyper = coding.model.hyper(coding.contexts(at)).astype(np.int64)[0]
    mean, scale = hyper[:width], hyper[width : 2 * width]
    yield row("means that F_h gives", "7.7", mean)
    yield row("scale indices that F_h gives", "7.7", scale)
    yield row("outputs for the step indices", "7.8", hyper[2 * width :])
    yield row("scalings: symbols", "7.10", scene.attributes.scalings[number])
    kept = zip(scene.masks[number], scene.attributes.offsets[number].tolist(), strict=True)
    yield row("offsets: symbols", "7.10", (tuple(offset) if mask else "masked" for mask, offset in kept))
    features, done = scene.attributes.features[at].astype(np.int64), 0
    for i, columns in enumerate(d.slices):
        part = slice(done, done + columns)
        change = np.zeros(2 * columns, np.int64)
        if i:
            change = coding.model.change(i, features[:, :done])[0]
        pairs = zip((mean[part] + change[:columns]).tolist(), (scale[part] + change[columns:]).tolist(), strict=True)
        yield row(f"slice {i}: mean and scale index of each channel", "7.9", pairs)
        yield row(f"slice {i}: symbols", "7.10", features[0, part])
        done += columns
    yield row("step indices of features, scalings, offsets", "7.8", scene.attributes.steps[number])
