"""What all files of plain 3D Gaussians have in common: their arrays, and how numbers are packed in some of them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..folder.layout import SceneFolderError

# float32 arrays of N Gaussians by name, as splats.Splats has them.
Arrays = dict[str, NDArray[np.float32]]

ADVICE = "export the splats again"
# Of one file. A scene of 3DGS has some million.
GAUSSIANS_MAX = 1 << 24
# A file of more Gaussians than these has at least a byte for each. All formats have ten and more of a trained scene. A
# picture in one colour takes some bytes, whatever its size is.
DENSE_MAX = 1 << 20


def check_count(file: Path, count: int, size: int) -> None:
    """Raises SceneFolderError for no Gaussians, and for more than a file of `size` bytes may have."""
    if not count:
        raise SceneFolderError(file, "it has no Gaussians", ADVICE)
    if count > GAUSSIANS_MAX:
        raise SceneFolderError(file, f"it has {count} Gaussians, at most {GAUSSIANS_MAX} are allowed", ADVICE)
    if count > max(size, DENSE_MAX):
        raise SceneFolderError(file, f"it states {count} Gaussians and has {size} bytes", ADVICE)


def logits(share: NDArray[np.float64]) -> NDArray[np.float32]:
    """Returns the logits of opacities of eight bits, 0 to 1. Those of 0 and 1 are beyond the next by half a step."""
    inner = share.clip(0.25 / 255, 1 - 0.25 / 255)
    return np.log(inner / (1 - inner)).astype(np.float32)
