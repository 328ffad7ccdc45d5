"""Learning: Adam's steps for the anchors' tables and the rendering networks."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch

from ...bitstream.dimensions import RENDERING
from ..adam import ADAM_EPSILON, adam_rows, gather_rows
from ..optimisers import learning_rate, moments, restore_moments
from ..part import Part, Step
from ..scaffold import COLUMNS, Scaffold
from ..schedule import Clock
from ..settings import LearningSettings
from ..state import Saved


class Learning(Part):
    """Follows the gradients of the anchors' tables and of the rendering networks.

    Only the rows that a step has taken are changed.
    """

    name = "learning"

    def __init__(self, settings: LearningSettings, scaffold: Scaffold, clock: Clock) -> None:
        self.settings, self.scaffold, self.clock = settings, scaffold, clock
        groups = [
            {"params": scaffold.networks.parameters_of(name), "decay": getattr(settings, name)} for name in RENDERING
        ]
        self.optimiser = torch.optim.Adam(groups, eps=ADAM_EPSILON, fused=True)
        self.anchors_changed()

    def anchors_changed(self) -> None:
        """Makes arrays of all anchors' size, which are used again in each step: gather_rows says for what."""
        n = self.scaffold.count
        self._place, self._found = np.full(n, -1, np.int64), np.zeros(n, np.int64)
        self._total = {name: np.zeros((n, columns), np.float32) for name, columns in COLUMNS.items()}

    def descend(self, step: Step) -> None:
        """A step of Adam."""
        for group in self.optimiser.param_groups:
            group["lr"] = learning_rate(group["decay"], self.clock.share)
        self.optimiser.step()
        self.optimiser.zero_grad(set_to_none=True)
        for name in COLUMNS:
            self._descend_table(name, step)

    def _descend_table(self, name: str, step: Step) -> None:
        """A step of Adam for the rows of one table that have a gradient."""
        scaffold, total, count = self.scaffold, self._total[name], 0
        for rows, leaves in step.taken:
            if (gradient := leaves[name].grad) is not None:
                count = gather_rows(rows.numpy(), gradient.numpy(), total, self._place, self._found, count)
        adam_rows(
            scaffold.tables[name].numpy(),
            scaffold.first[name].numpy(),
            scaffold.second[name].numpy(),
            self.clock.done + 1,
            self._found[:count],
            total,
            np.float32(learning_rate(getattr(self.settings, name), self.clock.share)),
        )
        self._place[self._found[:count]] = -1

    def state(self) -> dict[str, Any]:
        """The networks' moments; those of the anchors are the scaffold's."""
        return dict(moments(self.optimiser))

    def restore(self, state: Saved) -> None:
        """As Part."""
        restore_moments(self.optimiser, state)
