"""Growth (Scaffold-GS): anchors are added where the image needs more, and transparent ones are removed.

An anchor grows where the gradient of an offset's projected centre is large, on the mean of the steps that drew it.
Larger gradients add anchors on finer lattices.
"""

import math
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ..stage import Run, Stage, Step
from ..start import LATTICE_MAX, lattice_positions
from ..state import Saved

I64 = NDArray[np.int64]

_STATISTICS = ("gradient", "drawn", "opacity", "seen")


class Growth(Stage):
    """Observes the drawn Gaussians, and adds and removes anchors.

    gradient, drawn: float32 [N, K], sums of gradients of the projected centres, and how often each offset was drawn.
    opacity, seen: float32 [N], sums of the opacities of an anchor's offsets, and how often each anchor was seen.
    """

    name = "growth"
    most: int
    threshold: float
    gradient: Tensor
    drawn: Tensor
    opacity: Tensor
    seen: Tensor

    def join(self, run: Run) -> None:
        """As Stage. most: of the anchors that the photographs allow. threshold: GrowthSettings.gradient, times hull."""
        super().join(run)
        self.settings, self.scaffold = run.settings.growth, run.scaffold
        photographs, settings = run.photographs, self.settings
        self.most = min(settings.most, photographs.pixels // settings.pixels, len(photographs.train) * settings.each)
        self.threshold = settings.gradient * (settings.hull if self.scaffold.within == "hull" else 1.0)
        self.anchors_changed()

    def anchors_changed(self) -> None:
        """Resets the statistics."""
        n, device = self.scaffold.count, self.scaffold.device
        self.gradient, self.drawn = (torch.zeros((n, self.scaffold.columns.offsets), device=device) for _ in range(2))
        self.opacity, self.seen = (torch.zeros(n, device=device) for _ in range(2))

    def descend(self, step: Step) -> None:
        """Adds a step's statistics."""
        if self.mode == "off":
            return
        assert step.chosen is not None
        assert step.opacity is not None
        assert step.screen is not None
        screen = step.screen.detach() if step.screen.grad is None else step.screen.grad
        rows, chosen = step.rows, step.chosen
        offsets = self.scaffold.columns.offsets
        anchor, offset = rows[chosen // offsets], chosen % offsets
        drawn = screen > 0
        self.gradient[anchor, offset] += torch.where(drawn, screen, 0)
        self.drawn[anchor, offset] += drawn.float()
        self.opacity[rows] += step.opacity.detach().clamp_min(0).sum(dim=1)
        self.seen[rows] += 1

    def after_step(self) -> None:
        """Grows when it is time, also where growing begins or ends with this step."""
        clock = self.run.clock
        modes = [clock.mode(self.name, done) for done in (clock.done - 1, clock.done)]
        if clock.done % self.settings.period == 0 and "grow" in modes:
            self.grow()
            self.scaffold.place()
            self.run.anchors_changed()

    def grow(self) -> None:
        """Adds and drops anchors. Scaffold.place, and anchors_changed of all stages, must be called afterwards."""
        scaffold = self.scaffold
        units = scaffold.units
        cells, owner, edge = self._asked_for()
        stays = np.flatnonzero(~self._transparent())
        room = max(self.most - len(stays), 0)
        if room < len(cells):
            chosen = torch.randperm(len(cells), generator=self.run.random).numpy()[:room]
            cells, owner, edge = cells[chosen], owner[chosen], edge[chosen]
        born = {
            name: table[torch.from_numpy(owner).to(table.device)].clone() for name, table in scaffold.tables.items()
        }
        born["offsets"].zero_()
        born["scalings"][:] = torch.from_numpy(np.log(edge * units.cell * units.length)).float()[:, None]
        born["masks"].fill_(self.run.settings.masks.start)
        scaffold.keep(stays)
        scaffold.add(cells, born)

    def _transparent(self) -> NDArray[np.bool_]:
        """The anchors that were seen often and are nearly transparent, bool [N]."""
        settings, seen, opacity = self.settings, self.seen.cpu().numpy(), self.opacity.cpu().numpy()
        return np.asarray((seen > settings.anchor_views) & (opacity < settings.opacity * seen))

    def _asked_for(self) -> tuple[I64, I64, NDArray[np.float64]]:
        """New anchors: their cells [n, 3], the anchors that they come from [n], the edges of their lattices [n]."""
        settings, scaffold = self.settings, self.scaffold
        total, drawn = self.gradient.cpu().numpy(), self.drawn.cpu().numpy()
        mean = total / np.maximum(drawn, 1) * (drawn >= settings.offset_views)
        units = scaffold.units
        scalings, offsets = (scaffold.tables[name].cpu().numpy() for name in ("scalings", "offsets"))
        spread = np.exp(scalings[:, None, :3] - math.log(units.length)) / units.cell
        centre = scaffold.lattice[:, None] + offsets.reshape(scaffold.count, -1, 3) * spread
        centre, gradient = centre.reshape(-1, 3), mean.reshape(-1)
        added, owners, edges = [scaffold.lattice], [np.zeros(0, np.int64)], [np.zeros(0)]
        for level, edge in enumerate(settings.edges):
            lucky = torch.rand(len(gradient), generator=self.run.random).numpy() > settings.chance ** (level + 1)
            asks = gradient > self.threshold * settings.ratio**level
            grows = asks & lucky & (np.abs(centre).max(axis=1) < LATTICE_MAX)
            if not grows.any():
                continue
            cells, first = np.unique(np.round(centre[grows] / edge).astype(np.int64), axis=0, return_index=True)
            taken = {tuple(c) for c in np.round(np.concatenate(added) / edge).astype(np.int64).tolist()}
            free = np.array([tuple(c) not in taken for c in cells.tolist()], bool)
            added.append(cells[free] * edge)
            owners.append(np.flatnonzero(grows)[first[free]] // scaffold.columns.offsets)
            edges.append(np.full(int(free.sum()), edge))
        cells = lattice_positions(np.concatenate([np.zeros((0, 3), np.int64), *added[1:]])).astype(np.int64)
        return cells, np.concatenate(owners), np.concatenate(edges)

    def state(self) -> dict[str, Any]:
        """The statistics."""
        return {name: getattr(self, name) for name in _STATISTICS}

    def restore(self, state: Saved) -> None:
        for name in _STATISTICS:
            shape = getattr(self, name).shape
            setattr(self, name, state.tensor(name, shape, low=0).to(self.scaffold.device))
