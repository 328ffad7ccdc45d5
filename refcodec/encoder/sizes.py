"""SPEC.md B.3: lanes, chunk size, plane size and widths."""

import math
from itertools import accumulate

from ..bitstream.header import Lanes
from ..bitstream.planes import PLANES

# SPEC B.3: the chunk size with the best measured result, and the base-2 logarithm of the most lanes.
CHUNK_SIZE = 4096
LANES_LOG2_MOST = 6
# SPEC B.3: the slices of the features, in order, as in the code of CAT-3DGS.
SLICES = (5, 10, 15, 20)


def choose_slices(features: int, shares: tuple[int, ...] = SLICES) -> tuple[int, ...]:
    """SPEC B.3: returns the slices of some features, in the proportions of `shares`, none of them empty.

    Few features have fewer slices than shares. features: F, from 1 to 128. With more than 64, a slice may be too wide
    for Main.
    """
    total, done, slices = sum(shares), 0, []
    for end in accumulate(shares):
        columns = round(features * end / total) - done
        if columns > 0:
            slices.append(columns)
            done += columns
    return tuple(slices)


def choose_plane_size(anchors: int) -> int:
    """SPEC B.3: returns B = sqrt(N) / 5, rounded, from 8 to 128.

    For the 421,600 anchors of the paper's scene Amsterdam it is 128, as in the paper. Between the bounds, the planes
    have a fifth as many points as the scene has anchors.
    """
    return int(min(max(round(math.sqrt(anchors) / 5), 8), 128))


def choose_width(anchors: int) -> int:
    """SPEC B.3: returns the number of hidden units of F_h and of CARM. It is N / 800, rounded down, from 16 to 100.

    Small scenes get narrow networks, because the size of the weights is independent of the number of anchors.
    """
    return min(max(anchors // 800, 16), 100)


def choose_lanes(anchors: int, attribute_bits: float) -> Lanes:
    """SPEC B.3: returns the largest numbers of lanes with a small cost, at 4 bytes each.

    The cost is at most this share of the attributes' bytes:

    - 0.2 % for the attributes, with 64 lanes at most,
    - 0.01 % for the planes, with 64 lanes at most (about 0.5 % of the planes' own bytes),
    - 0.1 % for the masks, with 8 lanes at most.

    attribute_bits: the expected bits of an anchor's attributes.
    """
    total = anchors * attribute_bits / 8
    chunks = max(-(-anchors // CHUNK_SIZE), 1)

    def lanes(share: float, substreams: int) -> int:
        return min(int(math.log2(max(total * share / (4 * substreams), 1))), LANES_LOG2_MOST)

    return Lanes(plane=lanes(0.0001, PLANES), mask=min(lanes(0.001, chunks), 3), attribute=lanes(0.002, chunks))
