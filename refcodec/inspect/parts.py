"""The size of each part of a file in bytes."""

import numpy as np
from numpy.typing import NDArray

from ..bitstream.chunks import PARTS
from ..bitstream.directory import DATA, is_critical
from ..bitstream.header import PROLOGUE_BYTES
from ..bitstream.index import CHUNK_HEAD_BYTES
from .elements import Bytes, Outline, read_index

# Chunk heads per step, and the most bytes around them that are read at once.
_BLOCK = 4096
SPAN_BYTES = 1 << 24


def part_bytes(data: Bytes, outline: Outline, heads: bool = True) -> dict[str, int]:
    """Returns the bytes of each part of a file. Their sum is the length of the file, for any input.

    The parts are prologue, header, the critical sections but DATA by their names, the parts of all chunks (positions,
    masks and attributes), heads (of the chunks, with the padding of their parts), ancillary (all such sections), and
    rest (bytes after the last section). A section has its padding.

    heads: whether the heads of the chunks are read. Otherwise data stands for the parts of all chunks and the heads.
    """
    prologue = min(len(data), PROLOGUE_BYTES)
    sizes = {"prologue": prologue, "header": outline.header_end - prologue}
    ancillary = 0
    for place in outline.sections:
        size = place.stop - place.start
        if not is_critical(place.type):
            ancillary += size
        elif heads and place.type == DATA and "heads" not in sizes:
            parts = _chunk_bytes(data, outline, place.start, place.end)
            sizes |= {**parts, "heads": size - sum(parts.values())}
        else:
            sizes[place.name] = sizes.get(place.name, 0) + size
    end = outline.sections[-1].stop if outline.sections else outline.header_end
    return {**sizes, "ancillary": ancillary, "rest": len(data) - end}


def _chunk_bytes(data: Bytes, outline: Outline, start: int, end: int) -> dict[str, int]:
    """SPEC 5.14: returns the bytes of positions, masks and attributes of all chunks in data[start:end].

    They are those in the heads, limited by the file.
    """
    index, at = read_index(data, outline), start
    total = np.zeros(len(PARTS), np.int64)
    for first in range(0, len(index), _BLOCK):
        lengths = index["length"][first : first + _BLOCK].astype(np.int64)
        starts = at + np.cumsum(lengths) - lengths
        at += int(lengths.sum())
        stops = np.minimum(starts + lengths, end)
        whole = starts + CHUNK_HEAD_BYTES <= stops
        starts, stops = starts[whole], stops[whole]
        heads = _heads(data, starts)
        used = starts + CHUNK_HEAD_BYTES
        for i, length in enumerate(heads.T):
            size = np.minimum(length, stops - used)
            total[i] += size.sum()
            used = np.minimum(used + (length + 3 & -4), stops)
    return dict(zip(PARTS, total.tolist(), strict=True))


def _heads(data: Bytes, starts: NDArray[np.int64]) -> NDArray[np.int64]:
    """Returns the lengths that the heads of some chunks state, int64 [chunks, 3]. starts: of the chunks, rising."""
    size = 4 * len(PARTS)
    if len(starts) and starts[-1] + size - starts[0] <= SPAN_BYTES:
        span = np.frombuffer(data[int(starts[0]) : int(starts[-1]) + size], np.uint8)
        fields = span[(starts - starts[0])[:, None] + np.arange(size)].tobytes()
    else:
        fields = b"".join(data[start : start + size] for start in starts.tolist())
    return np.frombuffer(fields, "<u4").reshape(-1, len(PARTS)).astype(np.int64)
