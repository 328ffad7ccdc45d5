"""SPEC.md B.1: layers of anchors, so that the first chunks of a file show the whole scene coarsely."""

import numpy as np

from ..bitstream.chunks import chunk_ranges
from ..bitstream.conventions import Int64
from ..bitstream.dimensions import STATIC
from ..bitstream.reconstruction import gaussians, reconstruct
from ..bitstream.scene import Scene, take_anchors
from ..bitstream.splat import LENGTHS, LOGIT, derive_rendering
from .positions import morton_order

# A layer has three times the anchors of all layers before it, and the first one at least so many.
LEAST = 400
# Anchors around one along the curve, and the power of their mean area that its own is divided by (own measurement).
AROUND, LOCAL = 16, 0.75
# Anchors of a block.
BLOCK = 1 << 16


@np.errstate(over="ignore", invalid="ignore")
def coarse_layers(scene: Scene) -> Int64:
    """SPEC B.1: returns the layer of each anchor, int64 [N], 0 for the first one.

    The anchors whose Gaussians cover the largest area come first, in relation to the anchors around them: otherwise
    regions of small Gaussians would stay empty. The area of a Gaussian is the product of its two longest axes and, in a
    static scene, of its opacity. That of an anchor whose Gaussians depend on the view is by its scalings and the number
    of its kept offsets.
    """
    static, area = scene.render.render_model == STATIC, np.empty(scene.anchor_count)
    networks = derive_rendering(scene.networks) if static else None
    for block in chunk_ranges(scene.anchor_count, BLOCK):
        part = take_anchors(scene, slice(block.start, block.stop))
        if static:
            numbers = gaussians(part, networks).astype(np.float64)
            longest = np.sort(numbers[:, LENGTHS], axis=1)[:, 1:].sum(axis=1)
            each = np.exp(longest - np.logaddexp(0, -numbers[:, LOGIT].reshape(-1)))
            own = np.bincount(np.nonzero(part.masks)[0], each, len(part.masks))
        else:
            own = np.exp(np.sort(reconstruct(part).scalings[:, 3:].astype(np.float64), axis=1)[:, 1:].sum(axis=1))
            own *= part.masks.sum(axis=1)
        area[block.start : block.stop] = own
    order = morton_order(scene.positions)
    area = area[order]
    around = np.convolve(np.append(area, 0), np.full(AROUND, 1 / AROUND))[AROUND // 2 :][: len(area)]
    area /= np.maximum(around, 1e-300) ** LOCAL
    rank = np.empty(len(area), np.int64)
    rank[order[np.argsort(-area, kind="stable")]] = np.arange(len(area))
    ends = [len(area)]
    while ends[0] // 4 >= LEAST:
        quarter, whole = ends[0] // 4, scene.chunk_size
        ends.insert(0, quarter // whole * whole or quarter)
    layers: Int64 = np.searchsorted(ends, rank, side="right")
    return layers
