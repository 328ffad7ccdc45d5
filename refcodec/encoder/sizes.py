"""SPEC.md B.3: lanes, chunks, plane size and widths."""

from __future__ import annotations

import math

from ..bitstream.header import Lanes
from ..bitstream.planes import PLANES

# SPEC B.3: chunk size that measured best, and most lanes worth having.
CHUNK_SIZE = 4096
LANES_LOG2_MOST = 6


def choose_plane_size(anchors: int) -> int:
    """SPEC B.3: B = sqrt(N) / 5, from 8 to 128: the paper's 128 at Amsterdam's 421,600 anchors, fewer points than anchors always."""
    return int(min(max(round(math.sqrt(anchors) / 5), 8), 128))


def choose_width(anchors: int) -> int:
    """SPEC B.3: hidden units of F_h and of CARM: N / 400, from 32 to 100: fp32 weights are a part of the file that does not shrink."""
    return min(max(anchors // 400, 32), 100)


def choose_lanes(anchors: int, attribute_bits: float) -> Lanes:
    """SPEC B.3: as many lanes as cost, at 4 bytes each, at most 0.2 % of the attributes' bytes in the attributes, 0.01 % of them
    in the planes (about 0.5 % of the planes) and 0.1 % in the masks; 64 at most.

    attribute_bits: expected bits of an anchor's attributes.
    """
    total = anchors * attribute_bits / 8
    chunks = max(-(-anchors // CHUNK_SIZE), 1)

    def lanes(share: float, substreams: int) -> int:
        return min(int(math.log2(max(total * share / (4 * substreams), 1))), LANES_LOG2_MOST)

    return Lanes(plane=lanes(0.0001, PLANES), mask=min(lanes(0.001, chunks), 3), attribute=lanes(0.002, chunks))
