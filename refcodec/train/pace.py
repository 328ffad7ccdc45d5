"""The remaining time of training, from the time of a step before the rate and with it."""

from itertools import pairwise
from typing import Any

from .schedule import Clock
from .state import Positive, Saved

# The number of steps in the mean time of a step, and the least number for a reliable mean.
LATELY, ENOUGH = 50, 10
# The assumed ratio of the step times with the rate and before it (1.5 to 4 were measured), until both are measured.
RATIO = 2.5
OFF, ON = 0, 1


class Pace:
    """The times of the training steps. coded: whether there is a rate at all.

    means: seconds of a step before the rate and with it. counts: the steps in these means, at most LATELY.
    """

    clock: Clock
    coded: bool
    counts: list[float]
    means: list[float]

    def __init__(self, clock: Clock, coded: bool) -> None:
        self.clock, self.coded = clock, coded
        self.counts, self.means = [0.0, 0.0], [0.0, 0.0]
        self._last: int | None = None

    def _stage(self, done: int) -> int:
        return ON if self.coded and self.clock.mode("rate", done) != "off" else OFF

    def note(self, seconds: float) -> None:
        """Records the time of the last step."""
        stage = self._stage(self.clock.done - 1)
        if stage != self._last:
            # The first step of a process compiles, and the first one with the rate begins it.
            self._last = stage
            return
        self.counts[stage] = min(self.counts[stage] + 1, LATELY)
        self.means[stage] += (seconds - self.means[stage]) / self.counts[stage]

    def left(self) -> tuple[float, bool] | None:
        """Returns the seconds of the steps that are left, and whether they follow only from measurements.

        None before any step was measured.
        """
        measured = [stage for stage in (OFF, ON) if self.counts[stage]]
        if not measured:
            return None
        total, sure = 0.0, True
        for stage, steps in enumerate(self._steps_left()):
            if steps:
                known = stage in measured
                mean = self.means[stage if known else measured[0]]
                total += steps * (mean if known else mean * RATIO if stage == ON else mean / RATIO)
                sure = sure and self.counts[stage] >= ENOUGH
        return total, sure

    def _steps_left(self) -> tuple[int, int]:
        """The steps that are left before the rate and with it."""
        clock = self.clock
        begins = (clock.step_of(phase.begin) for phase in clock.phases)
        bounds = sorted({clock.done, clock.steps, *(step for step in begins if clock.done < step < clock.steps)})
        counts = [0, 0]
        for begin, end in pairwise(bounds):
            counts[self._stage(begin)] += end - begin
        return counts[OFF], counts[ON]

    def state(self) -> dict[str, Any]:
        """The values for a saved state."""
        return {"counts": self.counts, "means": self.means}

    def restore(self, state: Saved) -> None:
        """Restores the values of `state`. Raises ValueError."""
        self.counts, self.means = (list(state.value(name, tuple[Positive, Positive])) for name in ("counts", "means"))
