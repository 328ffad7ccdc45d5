"""The schedule of training: its steps, and the mode of each part in its phases."""

import math
from collections.abc import Sequence
from typing import Any

from .settings import MODES, Phase
from .state import Saved, Share


class Clock:
    """The progress of training. done: the number of finished steps, of `steps`.

    An extended training run keeps its place in the schedule: the rest of the schedule is stretched over the remaining
    steps. Thus completed phases are not repeated, and learning rates continue from their values. A completed run
    continues in its last phase, at its last learning rates. first, base: the step at which the run was extended last,
    and the share of the schedule that was done there.
    """

    phases: tuple[Phase, ...]
    steps: int
    done: int
    first: int
    base: float

    def __init__(self, phases: Sequence[Phase], steps: int) -> None:
        self.phases, self.steps = tuple(phases), steps
        self.done = self.first = 0
        self.base = 0.0

    @property
    def share(self) -> float:
        """The share of the schedule that is done."""
        return self.share_at(self.done)

    def share_at(self, done: int) -> float:
        """The share of the schedule that is done after `done` steps."""
        return self.base + (1 - self.base) * ((done - self.first) / (self.steps - self.first))

    def step_of(self, share: float) -> int:
        """The number of steps after which a share of the schedule is done, of those since it was extended."""
        if share <= self.base:
            return self.first
        return self.first + math.ceil((share - self.base) / (1 - self.base) * (self.steps - self.first) - 1e-6)

    def mode(self, part: str, done: int | None = None) -> str:
        """The mode of a part after `done` steps, or now.

        It is that of the last phase that names the part, or else the part's first in MODES.
        """
        share = self.share_at(self.done if done is None else done)
        mode = MODES[part][0]
        for phase in self.phases:
            if phase.begin <= share:
                mode = phase.modes.get(part, mode)
        return mode

    def since(self, part: str) -> float:
        """The share that is done of the steps from the first phase that names a part to the end; 0 before."""
        begin = next((phase.begin for phase in self.phases if part in phase.modes), 0.0)
        return max((self.share - begin) / (1 - begin), 0.0)

    def phase(self, done: int) -> str:
        """The name of the last phase that has begun after `done` steps, empty before the first."""
        return next((phase.name for phase in reversed(self.phases) if phase.begin <= self.share_at(done)), "")

    def state(self) -> dict[str, Any]:
        """The values for a saved state."""
        return {"done": self.done, "steps": self.steps, "first": self.first, "base": self.base}

    def restore(self, state: Saved) -> None:
        """Restores the values of `state`, and extends a training run of fewer steps. Raises ValueError."""
        steps = state.integer("steps", 1)
        if steps > self.steps:
            raise state.fault("steps", f"is {steps}: a training can be extended, but not cut to {self.steps} steps")
        before = Clock(self.phases, steps)
        before.first, before.base = state.integer("first", 0, steps - 1), state.value("base", Share)
        self.done = before.done = state.integer("done", before.first, steps)
        extended = steps < self.steps
        self.first, self.base = (before.done, before.share) if extended else (before.first, before.base)
