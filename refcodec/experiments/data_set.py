"""The photographs that all training runs and evaluations of a folder of results use."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..photographs.photographs import TEST_EVERY, PhotographSet, parse_background, parse_size, read_photographs

# Words of `train` that state how photographs are read, and where a training begins, in the order of the arguments.
WORDS = ("static", "background", "holdout", "anchors", "voxel", "degree", "set", "up")


def options_of(words: Mapping[str, Any]) -> tuple[str, ...]:
    """Returns WORDS as arguments of `train`."""
    made: list[str] = []
    for name in WORDS:
        value = words.get(name)
        if name == "up" and value:
            # As an argument by itself, -y would be an option.
            made.append(f"--{name}={value}")
        elif name == "static":
            made += [f"--{name}"] if value else []
        elif value is not None:
            made += [word for one in (value if name == "set" else [value]) for word in (f"--{name}", str(one))]
    return tuple(made)


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
