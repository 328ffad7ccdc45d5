"""Clauses 5.11, 6.12 and 7.6: the masks."""

import struct

from .conventions import PRECISION
from .entropy import Substream
from .errors import require
from .header import Header
from .tables import make_model
from .trace import Trace


# SPEC 5.11, [R6.10-1]
def read_mask_model(data: bytes, header: Header, at: int) -> list[int]:
    """Return the frequencies of the mask model, which starts at data[at]."""
    count = header["offset_count"] * (header["offset_count"] + 1) // 2
    mask_model = list(struct.unpack_from(f"<{count}H", data, at))
    for n, frequency in enumerate(mask_model):
        require(1 <= frequency < 1 << PRECISION, "index.mask_model", at + 2 * n)
    return mask_model


# SPEC 7.6
def read_masks(
    stream: Substream, mask_model: list[int], offset_count: int, anchors: range, trace: Trace | None
) -> list[list[int]]:
    """Return the K bits of each anchor of a chunk. mask_model: the frequencies of a kept offset."""
    models = [make_model([(1 << PRECISION) - kept, kept], 0) for kept in mask_model]
    masks: list[list[int]] = [[] for _ in anchors]
    kept_before = [0] * len(masks)
    for k in range(offset_count):
        first = k * (k + 1) // 2
        bits = stream.plain([models[first + kept] for kept in kept_before])
        if trace:
            trace.masks(anchors.start, k, bits)
        for n, bit in enumerate(bits):
            masks[n].append(bit)
            kept_before[n] += bit
    stream.finish()
    return masks
