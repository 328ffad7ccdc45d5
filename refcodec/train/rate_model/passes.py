"""Where passes of our own take the place of torch's many small operations: on CPUs, where numba is installed.

A fit needs torch alone, and a GPU has torch's operations. The formulas in torch are always there.
"""

from __future__ import annotations

from functools import cache
from importlib.util import find_spec

from torch import Tensor


@cache
def _has_numba() -> bool:
    return find_spec("numba") is not None


def is_compiled(tensor: Tensor) -> bool:
    """Whether what is computed of a tensor has a pass of our own. Float64 never has, so that tests can compare."""
    return tensor.device.type == "cpu" and tensor.element_size() == 4 and _has_numba()
