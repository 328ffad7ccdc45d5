"""What a training notes of itself: how good held-out images are, how large the file would be, how fast it goes."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from torch import Tensor

from .pace import Pace
from .schedule import Clock
from .settings import LookSettings
from .stage import Stage
from .state import Saved
from .views import Views

# About how many photographs a look takes: enough for a curve, and a small share of the time of training.
IMAGES = 5
# Steps whose mean PSNR is reported.
LATELY = 50
# What is noted of the file's parts, in bytes; and of a look, in numbers, with the name of the phase beside them.
PARTS = ("positions", "attributes", "masks", "planes", "weights")
COLUMNS, PHASE = ("step", "seconds", "psnr", "anchors", "bytes", *PARTS), "phase"


def psnr(error: float) -> float:
    """Of a mean squared error, dB."""
    return -10 * math.log10(error + 1e-12)


class Looks(Stage):
    """A training's notes.

    history: COLUMNS of each look at held-out images, and the phase of its last step. recent: PSNR of the latest steps,
    dB. seconds: of the training so far. pace: of its steps.
    """

    name = "looks"

    def __init__(
        self, settings: LookSettings, views: Views, estimate: Callable[[], dict[str, float]], clock: Clock, pace: Pace
    ) -> None:
        """estimate: bytes of each part of the file."""
        self.settings, self.views, self.estimate, self.clock = settings, views, estimate, clock
        self.history: list[dict[str, Any]] = []
        self.recent: list[float] = []
        self.seconds, self.pace = 0.0, pace

    def step_done(self, image: Tensor, photograph: Tensor, seconds: float) -> None:
        """Notes a step: its image, and the time that it took."""
        self.recent = [*self.recent[1 - LATELY :], psnr(float((image.detach() - photograph).square().mean()))]
        self.seconds += seconds
        self.pace.note(seconds)

    def look(self) -> None:
        """Adds to the history, if it is time or the training is at its end."""
        done, steps = self.clock.done, self.clock.steps
        if done % max(steps // self.settings.count, 1) and done < steps:
            return
        began = time.perf_counter()
        test = self.views.photographs.test
        some = test[:: max(len(test) // IMAGES, 1)] or self.views.photographs.train[:1]
        errors = [float((self.views.draw(p.camera) - self.views.pixels(p)).square().mean()) for p in some]
        self.seconds += time.perf_counter() - began
        estimated = self.estimate()
        sizes = {name: estimated.get(name, 0) for name in PARTS}
        self.history.append(
            {
                "step": done,
                "seconds": round(self.seconds, 2),
                "psnr": float(np.mean([psnr(e) for e in errors])),
                "anchors": self.views.scaffold.count,
                "bytes": round(sum(sizes.values())),
                **{name: round(size) for name, size in sizes.items()},
                PHASE: self.clock.phase(done - 1),
            }
        )

    def state(self) -> dict[str, Any]:
        """The notes."""
        pace = {f"pace/{name}": value for name, value in self.pace.state().items()}
        return {"history": self.history, "recent": self.recent, "seconds": self.seconds, **pace}

    def restore(self, state: Saved) -> None:
        """As Stage."""
        self.history = state.records("history", COLUMNS, (PHASE,))
        self.pace.restore(state.within("pace"))
        self.recent, self.seconds = state.numbers("recent"), state.real("seconds", 0)
