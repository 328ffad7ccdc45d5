"""A scene before quantisation, in floating point."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..bitstream.conventions import F32


@dataclass(frozen=True, eq=False)
class AnchorCloud:
    """A scene before quantisation. Float32: positions [N, 3] in world units; features [N, F]; scalings [N, 6], natural
    logarithms; offsets [N, K, 3], in units of exp(scalings[:3]); masks: bool [N, K], True where an offset is kept."""

    positions: F32
    features: F32
    scalings: F32
    offsets: F32
    masks: NDArray[np.bool_]
