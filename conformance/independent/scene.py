"""The scene: what a file says, as integers in lists."""

from dataclasses import dataclass

from .frame import Frame
from .header import Header
from .planes import Plane
from .weights import Weights


@dataclass(frozen=True)
class Chunk:
    """The decoded anchors of a chunk. Each list has an item for each anchor.

    positions: P of each axis. masks: K bits. symbols: D symbols. steps: three step indices.
    """

    positions: list[tuple[int, int, int]]
    masks: list[list[int]]
    symbols: list[list[int]]
    steps: list[list[int]]


@dataclass(frozen=True)
class Scene:
    """All that the canonical reconstruction needs, and the frame.

    frame: None if F_h has no inputs. planes: the five sub-planes, or none.
    """

    header: Header
    frame: Frame | None
    weights: Weights
    planes: list[Plane]
    chunks: list[Chunk]
