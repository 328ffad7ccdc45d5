"""What a file says."""

from dataclasses import dataclass

from .frame import Frame
from .header import Header
from .planes import Plane
from .weights import Weights


@dataclass(frozen=True)
class Chunk:
    """The decoded anchors of a chunk; an item for each anchor in each list."""

    positions: list[tuple[int, int, int]]
    masks: list[list[int]]
    symbols: list[list[int]]
    steps: list[list[int]]


@dataclass(frozen=True)
class Scene:
    """What a file says."""

    header: Header
    frame: Frame
    weights: Weights
    planes: list[Plane]
    mask_model: list[int]
    chunks: list[Chunk]
