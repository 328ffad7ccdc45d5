"""Clauses 5.10, 6.9 and 7.3: the planes."""

import struct

from .conventions import PLANE_SYMBOL_MAX, activation, padded
from .directory import Section
from .entropy import Substream
from .errors import require
from .header import Header
from .networks import Network
from .syntax import check_padding
from .tables import Family
from .trace import Trace

PLANE_TABLE_LENGTH = 20
# plane[channel][i][j]
Plane = list[list[list[int]]]


# SPEC 7.3
def _decode_plane(
    stream: Substream, sarm: Network, laplace: Family, channels: int, size: int, number: int, trace: Trace | None
) -> Plane:
    """Decode one sub-plane. While it is decoded it has a border of zeros above, left and right."""
    padded = [[[0] * (size + 2) for _ in range(size + 1)] for _ in range(channels)]
    known: dict[tuple[int, ...], list[int]] = {}
    for t in range(3 * size - 2):
        first, last = max(0, (t - size + 2) // 2), min(size - 1, t // 2)
        points, parameters = [], []
        for grid in padded:
            for i in range(first, last + 1):
                j = t - 2 * i
                above = grid[i]
                near = (*above[j : j + 3], grid[i + 1][j])
                if near not in known:
                    if len(known) >= 1 << 16:
                        known.clear()
                    known[near] = sarm([activation(y) for y in near])
                points.append((grid[i + 1], j + 1))
                parameters.append(known[near])
        values = stream.values(laplace, parameters, PLANE_SYMBOL_MAX)
        if trace:
            trace.wavefront(
                number, ((k, i, t - 2 * i) for k in range(channels) for i in range(first, last + 1)), values
            )
        for (row, column), value in zip(points, values):
            row[column] = value
    return [[row[1:-1] for row in grid[1:]] for grid in padded]


# SPEC 6.9, 10.1
def read_planes(
    data: bytes, header: Header, section: Section, sarm: Network, laplace: Family, trace: Trace | None
) -> list[Plane]:
    """Return the five sub-planes."""
    require(section.length >= PLANE_TABLE_LENGTH, "planes.length", section.offset)
    lengths = struct.unpack_from("<5I", data, section.offset)
    total = PLANE_TABLE_LENGTH + sum(map(padded, lengths))
    require(total == section.length, "planes.length", section.offset)
    spans, at = [], section.offset + PLANE_TABLE_LENGTH
    for length in lengths:
        check_padding(data, at + length, "planes.padding")
        spans.append((at, length))
        at += padded(length)
    planes = []
    for n, span in enumerate(spans):
        stream = Substream(data, *span, header["plane_lanes_log2"])
        planes.append(_decode_plane(stream, sarm, laplace, header["plane_channels"], header["plane_size"], n, trace))
        stream.finish()
    return planes


# SPEC 7.3, 7.5.4
def join_quadrants(quadrants: list[Plane]) -> Plane:
    """Return the plane of r = 2. quadrants: top left, top right, bottom left, bottom right."""
    top_left, top_right, bottom_left, bottom_right = quadrants
    out = []
    for k in range(len(top_left)):
        top = [left + right for left, right in zip(top_left[k], top_right[k])]
        bottom = [left + right for left, right in zip(bottom_left[k], bottom_right[k])]
        out.append(top + bottom)
    return out
