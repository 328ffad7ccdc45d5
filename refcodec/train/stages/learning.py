"""Learning: Adam's steps for the anchors' tables and the rendering networks."""

from dataclasses import replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ...bitstream.dimensions import RENDERING
from ..adam import ADAM_EPSILON, adam_torch, added, joined
from ..cpu.adam import F32, I64, adam_rows, share_rows
from ..device import has_kernel
from ..optimisers import learning_rate, moments, restore_moments
from ..scaffold import TABLES
from ..stage import Run, Stage, Step
from ..state import Saved

# Steps between two measurements.
PERIOD = 20


class Learning(Stage):
    """Follows the gradients of the anchors' tables and of the rendering networks.

    Only the rows that a step has taken are changed.
    """

    name = "learning"
    optimiser: torch.optim.Adam

    def join(self, run: Run) -> None:
        super().join(run)
        self.settings, self.scaffold = run.settings.learning, run.scaffold
        groups = [
            {"params": run.scaffold.networks.parameters_of(name), "decay": getattr(self.settings, name)}
            for name in RENDERING
        ]
        self.optimiser = torch.optim.Adam(groups, eps=ADAM_EPSILON, fused=True)
        self.decays = {name: getattr(self.settings, name) for name in TABLES}
        for name in ("features", "offsets", "scalings") if run.scaffold.within == "cube" else ():
            self.decays[name] = replace(self.decays[name], start=self.decays[name].start * self.settings.cube)
        self.anchors_changed()

    def anchors_changed(self) -> None:
        """Allocates the place of each anchor in a step, -1 if it has none. Only the kernel uses it."""
        self._place = np.full(self.scaffold.count, -1, np.int64)

    def descend(self, step: Step) -> None:
        """A step of Adam."""
        for group in self.optimiser.param_groups:
            group["lr"] = learning_rate(group["decay"], self.run.clock.share)
        self.optimiser.step()
        self.optimiser.zero_grad(set_to_none=True)
        rates = {name: learning_rate(decay, self.run.clock.share) for name, decay in self.decays.items()}
        if has_kernel(self.scaffold.tables["features"]):
            self._descend_in_kernel(step, rates)
        else:
            self._descend_in_torch(step, rates)

    def _descend_in_torch(self, step: Step, rates: dict[str, float]) -> None:
        """The definition of _descend_in_kernel."""
        # Most tables have gradients for the same sets of rows, and each union makes the CPU wait for the device.
        joints: dict[tuple[int, ...], tuple[Tensor, Tensor]] = {}
        for name, rate in rates.items():
            given = [(rows, grad) for rows, leaves in step.taken if (grad := leaves[name].grad) is not None]
            if not given:
                continue
            sets = tuple(id(rows) for rows, _ in given)
            if sets not in joints:
                joints[sets] = joined([rows for rows, _ in given])
            rows, place = joints[sets]
            gradient = added(place, [grad for _, grad in given], len(rows))
            table, moments = self.scaffold.tables[name], (self.scaffold.first[name], self.scaffold.second[name])
            adam_torch(table, *moments, self.run.clock.done + 1, rows, gradient, rate)

    def _descend_in_kernel(self, step: Step, rates: dict[str, float]) -> None:
        """A step of Adam for the rows of each table that have a gradient.

        There are at most two sets of rows, each with an anchor at most once. The gradients of the second are added to
        those of the first where the two share an anchor.
        """
        (seen, _), *later = step.taken
        assert len(later) <= 1
        if later:
            self._place[seen.numpy()] = np.arange(len(seen))
        for name, rate in rates.items():
            gradients = [
                (rows.numpy(), grad.contiguous().numpy())
                for rows, leaves in step.taken
                if (grad := leaves[name].grad) is not None
            ]
            if len(gradients) == 2:
                (_, first), (rows, second) = gradients
                apart = share_rows(rows, second, self._place, first)
                gradients[1] = rows[apart], second[apart]
            for rows, gradient in gradients:
                self._adam(name, rows, gradient, rate)
        if later:
            self._place[seen.numpy()] = -1

    def _adam(self, name: str, rows: I64, gradient: F32, rate: float) -> None:
        """A step of Adam for some rows of a table."""
        tables = (kind[name].numpy() for kind in (self.scaffold.tables, self.scaffold.first, self.scaffold.second))
        adam_rows(*tables, self.run.clock.done + 1, rows, gradient, np.float32(rate))

    def after_step(self) -> None:
        """Measures the Gaussians of a static scene at intervals, because they change slowly."""
        if self.run.clock.done % PERIOD == 0:
            self.scaffold.measure()

    def state(self) -> dict[str, Any]:
        """The networks' moments; those of the anchors are the scaffold's."""
        return dict(moments(self.optimiser))

    def restore(self, state: Saved) -> None:
        restore_moments(self.optimiser, state)
