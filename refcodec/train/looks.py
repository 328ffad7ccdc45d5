"""What a training notes of itself: how good held-out images are, how large the file would be, how fast it goes."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from torch import Tensor

from ..bitstream.attributes import KINDS
from .part import Part
from .schedule import Clock
from .settings import LookSettings
from .state import Saved
from .views import Views, pixels

# Steps whose mean PSNR is told, and the weight of the newest step in the mean time of a step.
LATELY, NEWEST = 50, 0.02


def psnr(error: float) -> float:
    """Of a mean squared error, dB."""
    return -10 * math.log10(error + 1e-12)


class Looks(Part):
    """A training's notes.

    history: what each look at held-out images found. recent: PSNR of the latest steps, dB. seconds: of the training so
    far. pace: seconds of a step, lately.
    """

    name = "looks"

    def __init__(
        self, settings: LookSettings, views: Views, estimate: Callable[[], dict[str, float]], clock: Clock
    ) -> None:
        """estimate: bytes of each part of the file."""
        self.settings, self.views, self.estimate, self.clock = settings, views, estimate, clock
        self.history: list[dict[str, Any]] = []
        self.recent: list[float] = []
        self.seconds = self.pace = 0.0

    def step_done(self, image: Tensor, photograph: Tensor, seconds: float) -> None:
        """Notes a step: its image, and the time that it took."""
        self.recent = [*self.recent[1 - LATELY :], psnr(float((image.detach() - photograph).square().mean()))]
        self.seconds += seconds
        # The first step compiles; it says nothing of those to come.
        if self.clock.done > 1:
            self.pace = (1 - NEWEST) * self.pace + NEWEST * seconds if self.pace else seconds

    def look(self) -> None:
        """Adds to the history, if it is time or the training is at its end."""
        done, steps = self.clock.done, self.clock.steps
        if done % max(steps // self.settings.count, 1) and done < steps:
            return
        began = time.perf_counter()
        test = self.views.photographs.test
        some = test[:: max(len(test) // self.settings.images, 1)] or self.views.photographs.train[:1]
        errors = [float((self.views.draw(p.camera) - pixels(p)).square().mean()) for p in some]
        self.seconds += time.perf_counter() - began
        self.history.append(
            {
                "step": done,
                "seconds": round(self.seconds, 2),
                "psnr": float(np.mean([psnr(e) for e in errors])),
                "anchors": self.views.scaffold.count,
                "bytes": round(sum(v for name, v in self.estimate().items() if name not in KINDS)),
            }
        )

    def state(self) -> dict[str, Any]:
        """The notes."""
        return {"history": self.history, "recent": self.recent, "seconds": self.seconds}

    def restore(self, state: Saved) -> None:
        """As Part."""
        self.history = state.records("history", ("step", "seconds", "psnr", "anchors", "bytes"))
        self.recent, self.seconds = state.numbers("recent"), state.real("seconds", 0)
