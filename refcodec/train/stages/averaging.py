"""Averaging: training ends with the mean of the values of its last steps.

Each step follows one photograph, and values vary around the optimum of all photographs. Their mean is closer to it.
"""

from typing import Any

import torch
from torch import Tensor

from ..stage import Run, Stage
from ..state import Saved
from .rate import Rate

# Steps between two averaged values. Neighbouring steps hardly differ.
PERIOD = 5


class Averaging(Stage):
    """Means of the anchors' tables, of the rendering networks, and of planes and coding networks if there are any.

    means: by name, like the values; empty before the first. count: the number of values in them.
    """

    name = "averaging"
    means: dict[str, Tensor]
    count: int

    def join(self, run: Run) -> None:
        super().join(run)
        self.anchors_changed()

    def _values(self) -> dict[str, Tensor]:
        """The averaged values, by name: the tensors that training changes."""
        scaffold = self.run.scaffold
        values = {f"tables.{name}": table for name, table in scaffold.tables.items()}
        values |= {f"networks.{name}": value for name, value in scaffold.networks.named_parameters()}
        for rate in self.run.of(Rate):
            if rate.model is not None:
                values |= {f"model.{name}": value for name, value in rate.model.named_parameters()}
        return values

    def anchors_changed(self) -> None:
        """Starts again, because means of other anchors are useless."""
        self.means, self.count = {}, 0

    @torch.no_grad()
    def after_step(self) -> None:
        """Adds the present values at intervals, and sets the means at the end of training."""
        if self.mode == "off":
            return
        last = self.run.clock.done == self.run.clock.steps
        if last or self.run.clock.done % PERIOD == 0:
            self._count()
        if last:
            for name, value in self._values().items():
                value.copy_(self.means[name])
            self.anchors_changed()

    def _count(self) -> None:
        values = self._values()
        self.means = self.means or {name: torch.zeros_like(value) for name, value in values.items()}
        self.count += 1
        for name, value in values.items():
            self.means[name].lerp_(value, 1 / self.count)

    def state(self) -> dict[str, Any]:
        """The means, and the number of values in them."""
        return {"count": self.count, **self.means}

    def restore(self, state: Saved) -> None:
        """As Stage. The anchors and the rate are restored before."""
        self.count = state.integer("count", 0)
        values = self._values() if self.count else {}
        device = self.run.device
        self.means = {name: state.tensor(name, value.shape).to(device) for name, value in values.items()}
