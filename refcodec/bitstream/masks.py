"""Clauses 5.11, 6.12 and 7.6: the masks.

The context of a mask bit is the index of its offset and the number of the anchor's kept offsets before it.
"""

import numpy as np
from numpy.typing import NDArray

from .conventions import Int64
from .dimensions import mask_contexts
from .entropy import Coder
from .source import Piece
from .tables import TOTAL, ModelSet, build_models


def parse_mask_model(section: Piece, offset_count: int) -> NDArray[np.uint16]:
    """SPEC 5.11 and [R6.10-1]: returns the mask model at the start of the index, uint16 [K (K + 1) / 2].

    Raises BitstreamError index.mask_model.
    """
    model = np.frombuffer(section.data, "<u2", mask_contexts(offset_count)).astype(np.uint16)
    bad = np.flatnonzero((model < 1) | (model >= TOTAL))
    if bad.size:
        first = int(bad[0])
        path = f"index.mask_model.frequency[{first}]"
        raise section.error("index.mask_model", 2 * first, path, model[first], f"1 to {TOTAL - 1}")
    return model


def mask_models(frequencies: NDArray[np.uint16]) -> ModelSet:
    """SPEC 7.6: returns a binary model for each context. frequencies: those of a kept offset, 1 to 2^14 - 1."""
    return build_models("mask", [np.array([TOTAL - int(f), int(f)]) for f in frequencies], [0] * len(frequencies))


def contexts(offset: int, kept: Int64) -> Int64:
    """SPEC 7.6: returns the contexts of the mask bits of one offset, int64 [n].

    offset: its index. kept: int64 [n], the number of kept offsets before it.
    """
    return offset * (offset + 1) // 2 + kept


def code_masks(
    coder: Coder, models: ModelSet, offset_count: int, chunks: list[range], given: NDArray[np.bool_] | None = None
) -> NDArray[np.bool_]:
    """SPEC 7.6: codes the masks of some chunks, in either direction, and returns them, bool [anchors, K].

    chunks: the anchors of each chunk, which has one substream. given: the masks, for encoding.
    """
    counts = [len(c) for c in chunks]
    masks = np.zeros((sum(counts), offset_count), dtype=bool)
    kept = np.zeros(len(masks), dtype=np.int64)
    for k in range(offset_count):
        known = None if given is None else given[:, k].astype(np.int64)

        def name(stream: int, index: int, k: int = k) -> str:
            return f"masks[{chunks[stream][index]},{k}]"

        bit = coder.plain(models, contexts(k, kept), counts, name, known)
        masks[:, k] = bit
        kept += bit
    return masks
