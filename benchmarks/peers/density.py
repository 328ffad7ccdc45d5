"""3DGS's adaptive density control: Gaussians are cloned, split and pruned, and their opacities reset.

Kerbl et al. 2023, section 5, with an additional limit on the number of Gaussians. If more would be cloned and split
than the limit allows, those with the largest gradients are.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from refcodec.bitstream.cameras import rotation_matrix
from refcodec.convert.drawing import Tensors

from .settings import DensitySettings


@dataclass(frozen=True, eq=False)
class Change:
    """A change of the Gaussians. The result is the kept ones, then clones, then children.

    kept: indices of unchanged Gaussians. cloned: indices of those that are copied. split: indices of those that are
    replaced, once for each child. moved: [children, 3], the offset of a child's mean from its parent's, in world units.
    """

    kept: Tensor
    cloned: Tensor
    split: Tensor
    moved: Tensor

    def values(self, name: str, table: Tensor, shrink: float) -> Tensor:
        """Returns a tensor of the Gaussians after the change. shrink: ratio of a parent's lengths to a child's."""
        children = table[self.split]
        if name == "mean":
            children = children + self.moved
        if name == "scale":
            children = children - math.log(shrink)
        return torch.cat([table[self.kept], table[self.cloned], children])

    def moments(self, table: Tensor) -> Tensor:
        """Returns a moment of Adam after the change, which is 0 for new Gaussians."""
        new = len(self.cloned) + len(self.split)
        return torch.cat([table[self.kept], table.new_zeros((new, *table.shape[1:]))])


class Density:
    """Statistics of the Gaussians between two changes, and the resulting change.

    gradient: float32 [N], sums of the lengths of the projected means' gradients. seen: float32 [N], the number of steps
    that drew each.
    """

    def __init__(self, settings: DensitySettings, extent: float, count: int) -> None:
        """extent: of the scene, in world units. count: of the Gaussians."""
        self.settings, self.extent = settings, extent
        self.begin(count)

    def begin(self, count: int) -> None:
        """Resets the statistics, for `count` Gaussians."""
        self.gradient, self.seen = torch.zeros(count), torch.zeros(count)

    def note(self, screen: Tensor, radius: Tensor) -> None:
        """Adds a step. screen: float32 [N], the gradients' lengths. radius: float32 [N], 0 if not drawn."""
        drawn = radius > 0
        self.gradient += torch.where(drawn, screen, 0)
        self.seen += drawn

    @torch.no_grad()
    def change(self, splats: Tensors, large: bool, random: torch.Generator) -> Change:
        """Returns the change. large: whether large Gaussians are pruned, too.

        If the number already exceeds the limit, after a change of settings, none is cloned or split.
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
        """Returns those of `grows` with the largest gradients, up to the limit; `count` are alive."""
        # A clone adds one Gaussian, a split one less than its children. The larger number always keeps the limit.
        room = max(self.settings.most - count, 0) // (self.settings.children - 1)
        if int(grows.sum()) <= room:
            return grows
        order = torch.where(grows, gradient, -1.0).argsort(descending=True, stable=True)
        chosen = torch.zeros_like(grows)
        chosen[order[:room]] = True
        return chosen

    @staticmethod
    def _drawn_inside(splats: Tensors, rows: Tensor, random: torch.Generator) -> Tensor:
        """Returns a sample of each Gaussian's distribution relative to its mean, [n, 3]."""
        lengths = splats["scale"][rows].exp()
        along = torch.randn(lengths.shape, generator=random) * lengths
        quaternion = torch.nn.functional.normalize(splats["quaternion"][rows]).double().numpy()
        rotation = torch.from_numpy(rotation_matrix(quaternion).astype(np.float32))
        return (rotation @ along[:, :, None])[:, :, 0]
