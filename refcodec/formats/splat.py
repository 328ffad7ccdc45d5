"""Files .splat of antimatter15's viewer: a row of 32 bytes for each Gaussian, with one colour for all directions."""

import numpy as np

from . import packing
from .common import ContentError, Data, check_count
from .harmonics import ZERO
from .splats import Splats, narrowed

# Positions and lengths in world units, the bytes of red, green, blue and opacity, and w, x, y and z as 128 (1 + w).
_ROW = np.dtype([("mean", "<f4", 3), ("length", "<f4", 3), ("colour", "u1", 4), ("quaternion", "u1", 4)])


def read(data: Data) -> Splats:
    """Returns the Gaussians of a file. Raises ContentError."""
    count, more = divmod(len(data), _ROW.itemsize)
    if more:
        raise ContentError(f"it has {len(data)} bytes, but a .splat file has {_ROW.itemsize} for each Gaussian")
    check_count(count, len(data))
    rows = np.frombuffer(data, _ROW)
    with np.errstate(all="ignore"):
        return narrowed(
            mean=rows["mean"],
            base=(rows["colour"][:, :3] / 255 - 0.5) / ZERO,
            rest=np.zeros((count, 0, 3)),
            opacity=packing.logits(rows["colour"][:, 3] / 255, packing.BYTE_OPACITY_LEAST),
            scale=np.log(rows["length"].astype(np.float64)),
            quaternion=rows["quaternion"] / 128 - 1,
        )
