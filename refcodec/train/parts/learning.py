"""Learning: Adam's steps for the anchors' tables and the rendering networks."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import Tensor

from ...bitstream.dimensions import RENDERING
from ..adam import ADAM_EPSILON, adam_anywhere, adam_rows, added, gather_rows, joined
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
        self._compiled = scaffold.device.type == "cpu"
        self.anchors_changed()

    def anchors_changed(self) -> None:
        """Makes arrays of all anchors' size, which are used again in each step: gather_rows says for what.

        Only the CPU has use for them.
        """
        n = self.scaffold.count if self._compiled else 0
        self._place, self._found = np.full(n, -1, np.int64), np.zeros(n, np.int64)
        self._total = {name: np.zeros((n, columns), np.float32) for name, columns in COLUMNS.items()}

    def descend(self, step: Step) -> None:
        """A step of Adam."""
        for group in self.optimiser.param_groups:
            group["lr"] = learning_rate(group["decay"], self.clock.share)
        self.optimiser.step()
        self.optimiser.zero_grad(set_to_none=True)
        joints: dict[tuple[int, ...], tuple[Tensor, Tensor]] = {}
        for name in COLUMNS:
            rate = learning_rate(getattr(self.settings, name), self.clock.share)
            if self._compiled:
                self._descend_on_cpu(name, step, rate)
            else:
                self._descend_on_device(name, step, rate, joints)

    def _descend_on_device(
        self, name: str, step: Step, rate: float, joints: dict[tuple[int, ...], tuple[Tensor, Tensor]]
    ) -> None:
        """_descend_on_cpu with torch. joints: adam.joined of the step's sets of rows, by the numbers of these sets.

        Most tables have gradients for the same sets, and each union makes the CPU wait for the device.
        """
        scaffold = self.scaffold
        found = tuple(i for i, (_, leaves) in enumerate(step.taken) if leaves[name].grad is not None)
        if not found:
            return
        if found not in joints:
            joints[found] = joined([step.taken[i][0] for i in found])
        rows, place = joints[found]
        gradient = added(place, [g for i in found if (g := step.taken[i][1][name].grad) is not None], len(rows))
        moments = scaffold.first[name], scaffold.second[name]
        adam_anywhere(scaffold.tables[name], *moments, self.clock.done + 1, rows, gradient, rate)

    def _descend_on_cpu(self, name: str, step: Step, rate: float) -> None:
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
            np.float32(rate),
        )
        self._place[self._found[:count]] = -1

    def state(self) -> dict[str, Any]:
        """The networks' moments; those of the anchors are the scaffold's."""
        return dict(moments(self.optimiser))

    def restore(self, state: Saved) -> None:
        """As Part."""
        restore_moments(self.optimiser, state)
