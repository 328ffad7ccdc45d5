"""Coordinates of a map: an offset is subtracted from them, and stated as `georeference` in the metadata (SPEC 6.14)."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]

KEY = "georeference"
# Places are far away at so many times the size that this share of them has.
FAR, SHARE = 1000, 0.99


def far_offset(places: F64, reach: F64 | float = 0.0) -> F64:
    """Returns what to subtract from places, float64 [3]: whole numbers near their middle, or zeros.

    They are zeros unless the places, float64 [n, 3], are so far from the world's origin that float32 would blur them.
    reach: the extent of each place, [n].
    """
    if not len(places):
        return np.zeros(3)
    middle = np.median(places, axis=0)
    size = np.quantile(np.abs(places - middle).max(axis=1) + reach, SHARE)
    return np.rint(middle) + 0.0 if np.abs(middle).max() > FAR * size else np.zeros(3)


def georeference(offset: F64) -> dict[str, str]:
    """Returns the entry of metadata for an offset that was subtracted, float64 [3]; none for zeros."""
    rows = np.column_stack([np.eye(4)[:, :3], [*offset, 1]])
    return {KEY: " ".join(f"{number:.17g}" for number in rows.ravel())} if offset.any() else {}


def stated_offset(entries: Mapping[str, str]) -> F64:
    """Returns the offset that entries of metadata state, float64 [3].

    It is zeros for none, for another matrix, and for a value that violates SPEC 6.14: that refuses no file.
    """
    try:
        numbers = np.array(entries.get(KEY, "").split(), np.float64)
    except ValueError:
        return np.zeros(3)
    if len(numbers) != 16 or not np.isfinite(numbers).all():
        return np.zeros(3)
    matrix = numbers.reshape(4, 4)
    return matrix[:3, 3] if np.array_equal(matrix[:, :3], np.eye(4)[:, :3]) else np.zeros(3)
