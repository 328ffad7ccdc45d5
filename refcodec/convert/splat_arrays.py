"""Common parts of files of plain 3D Gaussians: their arrays, and packed numbers."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..folder.layout import SceneFolderError

# float32 arrays of N Gaussians by name, as splats.Splats has them.
Arrays = dict[str, NDArray[np.float32]]

ADVICE = "export the splats again"
# Maximum per file. A 3DGS scene has a few million.
GAUSSIANS_MAX = 1 << 24
# A file of more Gaussians must have at least a byte for each. For trained scenes, all formats have ten and more. An
# image in one colour takes a few bytes, whatever its size.
DENSE_MAX = 1 << 20


def check_count(file: Path, count: int, size: int) -> None:
    """Raises SceneFolderError for no Gaussians, and for more than a file of `size` bytes may have."""
    if not count:
        raise SceneFolderError(file, "it has no Gaussians", ADVICE)
    if count > GAUSSIANS_MAX:
        raise SceneFolderError(file, f"it has {count} Gaussians, but at most {GAUSSIANS_MAX} are allowed", ADVICE)
    if count > max(size, DENSE_MAX):
        raise SceneFolderError(file, f"it states {count} Gaussians, but has only {size} bytes", ADVICE)


def logits(share: NDArray[np.float64]) -> NDArray[np.float32]:
    """Returns the logits of 8-bit opacities, 0 to 1. Those of 0 and 1 are half a step from the next."""
    inner = share.clip(0.25 / 255, 1 - 0.25 / 255)
    return np.log(inner / (1 - inner)).astype(np.float32)
