"""The records of training: the quality of held-out images, the estimated size of the file, and the speed."""

import math
import time
from typing import Any

import numpy as np
from msgspec import defstruct
from msgspec.structs import asdict
from torch import Tensor

from .estimate import estimate
from .losses import squared_error
from .pace import Pace
from .stage import Run, Stage
from .state import Positive, Saved

# About the number of photographs of an evaluation: enough for a curve, in a small share of the training time.
IMAGES = 5
# Steps whose mean PSNR is reported.
LATELY = 50
# The recorded parts of the file, in bytes, and the recorded numbers of an evaluation, beside the name of the phase.
PARTS = ("positions", "attributes", "masks", "planes", "weights")
COLUMNS, PHASE = ("step", "seconds", "psnr", "anchors", "bytes", *PARTS), "phase"
# An integer stays one, so that a training that was interrupted writes the bytes of one that was not.
_FIELDS = [*((name, int | float) for name in COLUMNS), (PHASE, str)]
Look: Any = defstruct("Look", _FIELDS, forbid_unknown_fields=True)


def psnr(error: float) -> float:
    """The PSNR of a mean squared error, in dB."""
    return -10 * math.log10(error + 1e-12)


class Looks(Stage):
    """The records of a training run.

    history: COLUMNS of each evaluation on held-out images, and the phase of its last step. recent: PSNR of the latest
    steps, dB. seconds: the training time. pace: of its steps.
    """

    name = "looks"
    history: list[dict[str, Any]]
    recent: list[float]
    seconds: float
    pace: Pace

    def join(self, run: Run) -> None:
        super().join(run)
        self.history, self.recent, self.seconds = [], [], 0.0
        self.pace = Pace(run.clock, bool(run.settings.rate.lambda_r))

    def step_done(self, image: Tensor, photograph: Tensor, seconds: float) -> None:
        """Records a step: its image, and its time."""
        self.recent = [*self.recent[1 - LATELY :], psnr(squared_error(image.detach(), photograph))]
        self.seconds += seconds
        self.pace.note(seconds)

    def look(self) -> None:
        """Adds to the history, if it is due or the training run is at its end."""
        run, done, steps = self.run, self.run.clock.done, self.run.clock.steps
        if done % max(steps // run.settings.looks.count, 1) and done < steps:
            return
        began = time.perf_counter()
        test = run.photographs.test
        some = test[:: max(len(test) // IMAGES, 1)] or run.photographs.train[:1]
        errors = [squared_error(run.draw(p.camera), run.pixels(p)) for p in some]
        self.seconds += time.perf_counter() - began
        estimated = estimate(run)
        sizes = {name: estimated.get(name, 0) for name in PARTS}
        self.history.append(
            {
                "step": done,
                "seconds": round(self.seconds, 2),
                "psnr": float(np.mean([psnr(e) for e in errors])),
                "anchors": run.scaffold.count,
                "bytes": round(sum(sizes.values())),
                **{name: round(size) for name, size in sizes.items()},
                PHASE: run.clock.phase(done - 1),
            }
        )

    def state(self) -> dict[str, Any]:
        """The records."""
        pace = {f"pace/{name}": value for name, value in self.pace.state().items()}
        return {"history": self.history, "recent": self.recent, "seconds": self.seconds, **pace}

    def restore(self, state: Saved) -> None:
        self.history = [asdict(look) for look in state.value("history", list[Look])]
        self.pace.restore(state.within("pace"))
        self.recent, self.seconds = state.value("recent", list[float]), state.value("seconds", Positive)
