"""When a kernel of this package replaces the definition in torch: for float32 tensors on CPUs, if numba is installed.

GPUs run the definition. A fit needs only torch, and then runs the definition too.
"""

from __future__ import annotations

from functools import cache
from importlib.util import find_spec

from torch import Tensor


@cache
def _has_numba() -> bool:
    return find_spec("numba") is not None


def has_kernel(tensor: Tensor) -> bool:
    """Whether operations on this tensor run in a kernel. Float64 tensors never do, which lets tests compare both."""
    return tensor.device.type == "cpu" and tensor.element_size() == 4 and _has_numba()
