"""3DGS's adaptive density control: Gaussians are cloned, split and pruned, and their opacities reset.

Kerbl et al. 2023, section 5, with one thing added: a largest number of Gaussians. Where more would be cloned and split
than there is room for, those of the largest gradients are.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from refcodec.bitstream.cameras import rotation_matrix
from refcodec.convert.splats import Splats

from .settings import DensitySettings


@dataclass(frozen=True, eq=False)
class Change:
    """What becomes of the Gaussians. The result is those that are kept, then clones, then children.

    kept: indices of those that stay as they are. cloned: indices of those of which a copy is added. split: indices of
    those whose children replace them, each once for each child. moved: [children, 3], how far a child's mean is from
    its parent's, world units.
    """

    kept: Tensor
    cloned: Tensor
    split: Tensor
    moved: Tensor

    def values(self, name: str, table: Tensor, shrink: float) -> Tensor:
        """A tensor of the Gaussians after the change. shrink: a child's lengths are its parent's over this."""
        children = table[self.split]
        if name == "mean":
            children = children + self.moved
        if name == "scale":
            children = children - math.log(shrink)
        return torch.cat([table[self.kept], table[self.cloned], children])

    def moments(self, table: Tensor) -> Tensor:
        """A moment of Adam after the change: new Gaussians begin with zeros."""
        new = len(self.cloned) + len(self.split)
        return torch.cat([table[self.kept], table.new_zeros((new, *table.shape[1:]))])


class Density:
    """What is noted of the Gaussians between two changes, and the change that follows from it.

    gradient: float32 [N], sums of the lengths of the projected means' gradients. seen: float32 [N], times that each was
    drawn.
    """

    def __init__(self, settings: DensitySettings, extent: float, count: int) -> None:
        """extent: of the scene, world units. count: of the Gaussians."""
        self.settings, self.extent = settings, extent
        self.begin(count)

    def begin(self, count: int) -> None:
        """Notes nothing of `count` Gaussians."""
        self.gradient, self.seen = torch.zeros(count), torch.zeros(count)

    def note(self, screen: Tensor, radius: Tensor) -> None:
        """Notes a step. screen: float32 [N], the gradients' lengths. radius: float32 [N], 0 for what was not drawn."""
        drawn = radius > 0
        self.gradient += torch.where(drawn, screen, 0)
        self.seen += drawn

    @torch.no_grad()
    def change(self, splats: Splats, large: bool, random: torch.Generator) -> Change:
        """The change for the Gaussians as they are. large: whether large ones are pruned, too.

        If there are more than the largest number, which only a new setting can make, none is cloned or split.
        """
        settings = self.settings
        length = splats["scale"].exp().amax(dim=1)
        dead = torch.sigmoid(splats["opacity"]) < settings.opacity
        if large:
            dead |= length > settings.largest * self.extent
        mean = self.gradient / self.seen.clamp_min(1)
        grows = self._within_the_cap(mean, (mean >= settings.gradient) & ~dead, int((~dead).sum()))
        splits = length > settings.dense * self.extent
        split = torch.nonzero(grows & splits)[:, 0].repeat(settings.children)
        moved = self._drawn_inside(splats, split, random)
        kept = torch.nonzero(~dead & ~(grows & splits))[:, 0]
        return Change(kept, torch.nonzero(grows & ~splits)[:, 0], split, moved)

    def _within_the_cap(self, gradient: Tensor, grows: Tensor, count: int) -> Tensor:
        """Those of `grows` with the largest gradients, as many as there is room for; `count` are alive."""
        # A clone adds one, a split one less than it has children. The larger number keeps the cap in any case.
        room = max(self.settings.most - count, 0) // (self.settings.children - 1)
        if int(grows.sum()) <= room:
            return grows
        order = torch.where(grows, gradient, -1.0).argsort(descending=True, stable=True)
        chosen = torch.zeros_like(grows)
        chosen[order[:room]] = True
        return chosen

    @staticmethod
    def _drawn_inside(splats: Splats, rows: Tensor, random: torch.Generator) -> Tensor:
        """A sample of each Gaussian's own distribution, less its mean: [n, 3]."""
        lengths = splats["scale"][rows].exp()
        along = torch.randn(lengths.shape, generator=random) * lengths
        quaternion = torch.nn.functional.normalize(splats["quaternion"][rows]).double().numpy()
        rotation = torch.from_numpy(rotation_matrix(quaternion).astype(np.float32))
        return (rotation @ along[:, :, None])[:, :, 0]
