"""What a demo has found: what its page shows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

U8 = NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class View:
    """A photograph and its two images, uint8 [h, w, 3] each. before, after: their figures (quality.measures)."""

    name: str
    photograph: U8
    uncompressed: U8
    decoded: U8
    before: dict[str, float]
    after: dict[str, float]


@dataclass(frozen=True)
class Part:
    """A part of a scene. name: also its colour's. text: what it is. before, after: bytes, uncompressed and coded."""

    name: str
    text: str
    before: int
    after: int


@dataclass(frozen=True)
class Step:
    """A command, as it is typed, and the seconds that it took."""

    name: str
    command: str
    seconds: float


@dataclass(frozen=True)
class File:
    """A file or folder. path: from the page's folder."""

    path: str
    text: str
    size: int


@dataclass(frozen=True, eq=False)
class Result:
    """What the page shows.

    photographs: how many there are. held_out: whether those of the views were kept from the training. anchors, trained:
    anchors and steps of both trainings, the uncompressed one first. steps_wanted: of each. digest: SHA-256 of the scene
    on both sides.
    """

    title: str
    photographs: int
    held_out: bool
    views: tuple[View, ...]
    mean_before: dict[str, float]
    mean_after: dict[str, float]
    parts: tuple[Part, ...]
    anchors: tuple[int, int]
    trained: tuple[int, int]
    steps_wanted: int
    rate: float
    digest: str
    steps: tuple[Step, ...]
    charts: dict[str, tuple[tuple[float, float], ...]]
    files: tuple[File, ...]
    credits: str
