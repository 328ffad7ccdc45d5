"""A scene in floating point, before quantisation."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..bitstream.conventions import F32


@dataclass(frozen=True, eq=False)
class AnchorCloud:
    """The anchors of a scene before quantisation.

    positions: float32 [N, 3], world units.
    features: float32 [N, F].
    scalings: float32 [N, 6], natural logarithms of world units.
    offsets: float32 [N, K, 3], in units of exp(scalings[:, :3]).
    masks: bool [N, K], True where an offset is kept.
    """

    positions: F32
    features: F32
    scalings: F32
    offsets: F32
    masks: NDArray[np.bool_]
