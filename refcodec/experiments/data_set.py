"""The photographs that all training runs and evaluations of a folder of results use."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from ..photographs.photographs import TEST_EVERY, PhotographSet, parse_background, parse_size, read_photographs


@dataclass(frozen=True)
class DataSet:
    """A folder of posed photographs, and how it is read.

    size, background, holdout: as the settings of `train` have them. options: further arguments of `train`.
    """

    folder: Path
    size: str
    background: str
    holdout: int
    options: tuple[str, ...] = ()

    def read(self) -> PhotographSet:
        """The photographs. Raises PhotographError."""
        background = parse_background(self.background)
        return read_photographs(self.folder, parse_size(self.size), background, holdout=self.holdout)

    @property
    def evaluated(self) -> tuple[str, ...]:
        """The arguments of `eval`. A scene has its background. A file does not state the held-out photographs."""
        held_out = () if self.holdout == TEST_EVERY else ("--holdout", str(self.holdout))
        return "--size", self.size, *held_out
