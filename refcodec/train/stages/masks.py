"""Masks of offsets (CAT-3DGS Pro), as settings.MaskSettings describes them."""

from typing import Any

import torch
from torch import Tensor

from ..stage import Run, Sight, Stage, Step
from ..state import Saved


class Masks(Stage):
    """Which offsets are kept, and the loss that drops them.

    weight: float32 [N]. dropped: the number of anchors that were dropped as lost.
    """

    name = "masks"
    needs_rate = True
    dropped: int
    lambda_m: float
    weight: Tensor

    def join(self, run: Run) -> None:
        super().join(run)
        self.settings, self.scaffold = run.settings.masks, run.scaffold
        self.dropped = 0
        self.lambda_m = max(self.settings.least, self.settings.share * run.settings.rate.lambda_r)
        self.weight = torch.ones(run.scaffold.count, device=run.device)
        self._shares: Tensor | None = None

    @property
    def on(self) -> bool:
        """Whether offsets may be masked now."""
        return self.settings.used and self.mode == "on"

    def anchors_changed(self) -> None:
        """Counts the views again."""
        run = self.run
        self.weight = (
            run.scaffold.views(run.cameras) if self.settings.used else torch.ones(run.scaffold.count, device=run.device)
        )

    def kept(self, logits: Tensor, rows: Tensor) -> Tensor:
        """Masks of 0 and 1, float32 [n, K], of some anchors, with the gradient of their shares."""
        return self._kept(torch.sigmoid(logits), rows) if self.on else torch.ones_like(logits)

    def _kept(self, share: Tensor, rows: Tensor) -> Tensor:
        hard = (share * self.weight[rows, None] > self.settings.epsilon).float()
        return share + (hard - share).detach()

    def prepare(self, step: Step) -> None:
        """Masks the image."""
        if self.on:
            self._shares = torch.sigmoid(step.leaves["masks"])
            step.masks = self._kept(self._shares, step.rows)

    def loss(self, step: Step) -> Tensor | None:
        """lambda_m L_m, where L_m is the mean share of the visible anchors' offsets.

        Dropped anchors count in it, with shares of zero.
        """
        if not self.on:
            return None
        assert self._shares is not None
        return self.lambda_m * self._shares.mean() * (self.scaffold.count / self.total)

    @property
    def total(self) -> int:
        """The number of anchors, counted with those that were dropped as lost."""
        return self.scaffold.count + self.dropped

    def after_step(self) -> None:
        """Drops the anchors that are lost, once the rate counts.

        A lost anchor has no kept offset. It is in no image and costs time but no bits, and the gradient of its low
        shares rarely restores it. While averaging is on, all anchors stay.
        """
        clock = self.run.clock
        late = clock.mode("rate") != "off" and clock.mode("averaging") == "off"
        if not (self.on and late) or clock.done % self.settings.drop_period:
            return
        share = torch.sigmoid(self.scaffold.tables["masks"]) * self.weight[:, None]
        stay = (share > self.settings.lost * self.settings.epsilon).any(dim=1)
        if bool(stay.all()) or not bool(stay.any()):
            return
        self.dropped += int((~stay).sum())
        self.scaffold.keep(torch.nonzero(stay)[:, 0].cpu().numpy())
        self.scaffold.place()
        self.run.anchors_changed()

    def show(self, sight: Sight) -> None:
        if self.on:
            sight.masks = self.kept(sight.values["masks"], sight.rows)

    @torch.no_grad()
    def decided(self) -> Tensor:
        """Which offsets are kept, bool [N, K]."""
        return (
            self.kept(self.scaffold.tables["masks"], torch.arange(self.scaffold.count, device=self.weight.device)) > 0.5
        )

    def state(self) -> dict[str, Any]:
        """The weights, and the number of dropped anchors."""
        return {"weight": self.weight, "dropped": self.dropped}

    def restore(self, state: Saved) -> None:
        self.weight = state.tensor("weight", (self.scaffold.count,), low=0).to(self.run.device)
        self.dropped = state.integer("dropped", 0)
