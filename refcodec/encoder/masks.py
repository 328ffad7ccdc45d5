"""SPEC.md B.6: the mask model."""

import numpy as np
from numpy.typing import NDArray

from ..bitstream.dimensions import mask_contexts
from ..bitstream.masks import contexts
from ..bitstream.tables import TOTAL


def mask_model(masks: NDArray[np.bool_]) -> NDArray[np.uint16]:
    """SPEC B.6: returns the frequency of a kept offset in each context, uint16 [K (K + 1) / 2]. masks: bool [N, K]."""
    count = mask_contexts(masks.shape[1])
    seen, kept = np.zeros(count), np.zeros(count)
    before = np.cumsum(masks, axis=1, dtype=np.int64) - masks
    for k in range(masks.shape[1]):
        context = contexts(k, before[:, k])
        seen += np.bincount(context, minlength=count)
        kept += np.bincount(context, masks[:, k], minlength=count)
    frequency = np.where(seen > 0, np.rint(kept / np.maximum(seen, 1) * TOTAL), TOTAL // 2)
    return np.clip(frequency, 1, TOTAL - 1).astype(np.uint16)
