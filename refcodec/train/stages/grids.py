"""Grids: the weights of all networks are rounded to grids, which rate and distortion choose (docs/method.md).

Training continues with rounded weights and a straight-through gradient, which recovers most of what rounding loses.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import torch

from ...bitstream.networks import WEIGHT_MAX
from ...formats.harmonics import DEGREE_MAX
from ..losses import photometric
from ..scaffold import Scaffold
from ..schedule import Clock
from ..settings import CHOSEN, TrainSettings
from ..stage import Stage
from ..state import Saved
from ..views import Views
from .rate import Rate

# Bits of WEIGHT_MAX and a sign.
STATIC_BITS = WEIGHT_MAX.bit_length() + 1


class Grids(Stage):
    """Puts the weights on grids once, when its phase begins."""

    settings: TrainSettings
    scaffold: Scaffold
    rate: Rate
    views: Views
    estimate: Callable[[], dict[str, float]]
    clock: Clock

    name = "weights"

    def __init__(
        self,
        settings: TrainSettings,
        scaffold: Scaffold,
        rate: Rate,
        views: Views,
        estimate: Callable[[], dict[str, float]],
        clock: Clock,
    ) -> None:
        """estimate: bytes of each part of the file."""
        self.settings, self.scaffold, self.rate = settings, scaffold, rate
        self.views, self.estimate, self.clock = views, estimate, clock

    def begin(self) -> None:
        """As Stage."""
        if self.clock.mode(self.name) == "grid":
            self.finish()

    def finish(self) -> None:
        """Chooses the grids, if there are none yet."""
        if not self.scaffold.networks.gridded and self.rate.model is not None:
            self._choose()

    @torch.no_grad()
    def _choose(self) -> None:
        """Takes the grids of the least loss, the rendering networks' first, then the coding networks'."""
        settings, networks = self.settings.weights, self.scaffold.networks
        bits = settings.rendering_bits
        if networks.degree is not None:
            if self.settings.degree == CHOSEN:
                self._choose_degree()
            networks.set_units(self.scaffold.tables["features"])
            # SPEC 7.2: the integers of a static scene's networks.
            bits = min(bits[0], STATIC_BITS), min(bits[1], STATIC_BITS)
        for grid, (least, most) in (
            (networks.set_grid, bits),
            (self.rate.started().set_grid, settings.coarser),
        ):
            losses = []
            for choice in range(least, most + 1):
                grid(choice)
                losses.append(self._loss())
            grid(least + int(np.argmin(losses)))

    def _choose_degree(self) -> None:
        """Takes the degree of harmonics of the least loss."""
        losses = []
        for degree in range(DEGREE_MAX + 1):
            self.scaffold.networks.degree = degree
            losses.append(self._loss())
        self.scaffold.networks.degree = int(np.argmin(losses))

    def _loss(self) -> float:
        """L_Scaffold of a few photographs and lambda_r L_rate, in which bits of weights count like the others."""
        train, settings = self.views.photographs.train, self.settings
        judges = train[:: max(len(train) // settings.weights.judges, 1)][: settings.weights.judges]
        views = self.views
        shown = sum(float(photometric(views.draw(p.camera), views.pixels(p), settings.loss.ssim)) for p in judges)
        parts = self.estimate()
        bits = 8 * (parts["attributes"] + parts["weights"] + settings.rate.planes * parts["planes"])
        return shown / len(judges) + settings.rate.lambda_r * bits / (
            self.rate.masks.total * self.scaffold.columns.width
        )

    def state(self) -> dict[str, Any]:
        """Whether there are grids, and the degree of harmonics; steps and units are the networks' own."""
        networks = self.scaffold.networks
        return {"gridded": networks.gridded, **({} if networks.degree is None else {"degree": networks.degree})}

    def restore(self, state: Saved) -> None:
        """As Stage. The rate is restored before."""
        gridded = state.flag("gridded")
        if gridded and self.rate.model is None:
            raise state.fault("gridded", "is true before there is an entropy model")
        networks = self.scaffold.networks
        networks.gridded = gridded
        if networks.degree is not None:
            networks.degree = state.integer("degree", 0, networks.degree)
        if gridded:
            self.rate.started().set_gridded(True)
