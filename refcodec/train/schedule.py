"""The time of a training: its steps, and what its phases say of each part."""

from __future__ import annotations

from collections.abc import Sequence

from .settings import MODES, Phase


class Clock:
    """How far a training is. done: the steps that are done, of `steps`."""

    def __init__(self, phases: Sequence[Phase], steps: int) -> None:
        self.phases, self.steps = tuple(phases), steps
        self.done = 0

    @property
    def share(self) -> float:
        """The share of the steps that is done."""
        return self.done / self.steps

    def mode(self, part: str, done: int | None = None) -> str:
        """The mode of a part after `done` steps, or now.

        It is that of the last phase that names the part, or else the part's first in MODES.
        """
        share = (self.done if done is None else done) / self.steps
        found = MODES[part][0]
        for phase in self.phases:
            if phase.begin <= share:
                found = phase.modes.get(part, found)
        return found

    def since(self, part: str) -> float:
        """The share that is done of the steps from the first phase that names a part to the end; 0 before."""
        begin = next((phase.begin for phase in self.phases if part in phase.modes), 0.0)
        return max((self.share - begin) / (1 - begin), 0.0)

    def begin(self, name: str) -> float:
        """The share of the steps at which the phase of a name begins."""
        return next(phase.begin for phase in self.phases if phase.name == name)
