"""Grids of weights: all networks are rounded to grids, which rate and distortion choose (docs/method.md).

Training continues with rounded weights and a straight-through gradient, which recovers most of what rounding loses.
"""

from typing import Any

import numpy as np
import torch

from ...bitstream.networks import WEIGHT_MAX
from ...formats.harmonics import DEGREE_MAX
from ..estimate import coded_bytes
from ..losses import photometric
from ..settings import CHOSEN
from ..stage import Run, Stage
from ..state import Saved
from .rate import Rate

# Bits of WEIGHT_MAX and a sign.
STATIC_BITS = WEIGHT_MAX.bit_length() + 1


class Weights(Stage):
    """Puts the weights on grids once, when its phase begins."""

    name = "weights"
    needs_rate = True
    rate: Rate

    def join(self, run: Run) -> None:
        super().join(run)
        self.rate = next(run.of(Rate))

    def before_step(self) -> None:
        if self.mode == "grid":
            self.finish()

    def finish(self) -> None:
        """Chooses the grids, if there are none yet."""
        if not self.run.scaffold.networks.gridded and self.rate.model is not None:
            self._choose()

    @torch.no_grad()
    def _choose(self) -> None:
        """Takes the grids of the least loss, the rendering networks' first, then the coding networks'."""
        settings, networks = self.run.settings, self.run.scaffold.networks
        bits = settings.weights.rendering_bits
        if networks.degree is not None:
            if settings.degree == CHOSEN:
                self._choose_degree()
            networks.set_units(self.run.scaffold.tables["features"])
            # SPEC 7.2: the integers of a static scene's networks.
            bits = min(bits[0], STATIC_BITS), min(bits[1], STATIC_BITS)
        coding = self.rate.started()
        for grid, (least, most) in ((networks.set_grid, bits), (coding.set_grid, settings.weights.coarser)):
            losses = []
            for choice in range(least, most + 1):
                grid(choice)
                losses.append(self._loss())
            grid(least + int(np.argmin(losses)))

    def _choose_degree(self) -> None:
        """Takes the degree of harmonics of the least loss."""
        losses = []
        for degree in range(DEGREE_MAX + 1):
            self.run.scaffold.networks.degree = degree
            losses.append(self._loss())
        self.run.scaffold.networks.degree = int(np.argmin(losses))

    def _loss(self) -> float:
        """L_Scaffold of a few photographs and lambda_r L_rate, in which bits of weights count like the others."""
        run, settings = self.run, self.run.settings
        train = run.photographs.train
        judges = train[:: max(len(train) // settings.weights.judges, 1)][: settings.weights.judges]
        shown = sum(float(photometric(run.draw(p.camera), run.pixels(p), settings.loss.ssim)) for p in judges)
        parts = coded_bytes(run.scaffold, self.rate)
        bits = 8 * (parts["attributes"] + parts["weights"] + settings.rate.planes * parts["planes"])
        symbols = self.rate.masks.total * run.scaffold.columns.width
        return shown / len(judges) + settings.rate.lambda_r * bits / symbols

    def state(self) -> dict[str, Any]:
        """Whether there are grids, and the degree of harmonics; steps and units are the networks' own."""
        networks = self.run.scaffold.networks
        return {"gridded": networks.gridded, **({} if networks.degree is None else {"degree": networks.degree})}

    def restore(self, state: Saved) -> None:
        """As Stage. The rate is restored before."""
        gridded = state.value("gridded", bool)
        if gridded and self.rate.model is None:
            raise state.fault("gridded", "is true before there is an entropy model")
        networks = self.run.scaffold.networks
        networks.gridded = gridded
        if networks.degree is not None:
            networks.degree = state.integer("degree", 0, networks.degree)
        if gridded:
            self.rate.started().set_gridded(True)
