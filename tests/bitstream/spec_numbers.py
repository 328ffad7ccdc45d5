"""Numbers as SPEC.md's python blocks take them."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike


def f32_bits(values: ArrayLike) -> Any:
    """Float32 values as the integers of their bits, in lists of the same shape."""
    return np.asarray(values, np.float32).view(np.uint32).tolist()
