"""Clauses 5.12, 6.12 and 7.6: the masks."""

import struct

from .chunks import Part
from .conventions import PRECISION
from .entropy import Substream
from .errors import require
from .header import Header
from .tables import make_model
from .trace import Trace


# SPEC 5.10, [R6.10-1]
def read_mask_model(data: bytes, header: Header, table: int) -> list[int]:
    """Return the frequencies of the mask model. table: where the chunk table starts."""
    count = header["offset_count"] * (header["offset_count"] + 1) // 2
    mask_model = list(struct.unpack_from(f"<{count}H", data, table))
    for n, frequency in enumerate(mask_model):
        require(1 <= frequency < 1 << PRECISION, "chunks.mask_model", table + 2 * n)
    return mask_model


# SPEC 7.6, 10.1 step 8
def read_masks(
    data: bytes, header: Header, chunk: int, part: Part, mask_model: list[int], trace: Trace | None
) -> list[list[int]]:
    """Return the K bits of each anchor of a chunk. mask_model: the frequencies of a kept offset."""
    part.check(data)
    models = [make_model([(1 << PRECISION) - kept, kept], 0) for kept in mask_model]
    stream = Substream(data, part.offset, part.length, header["mask_lanes_log2"])
    masks: list[list[int]] = [[] for _ in range(header.chunk_anchors(chunk))]
    kept_before = [0] * len(masks)
    for k in range(header["offset_count"]):
        first = k * (k + 1) // 2
        bits = stream.plain([models[first + kept] for kept in kept_before])
        if trace:
            trace.masks(chunk * header["chunk_size"], k, bits)
        for n, bit in enumerate(bits):
            masks[n].append(bit)
            kept_before[n] += bit
    stream.finish()
    return masks
