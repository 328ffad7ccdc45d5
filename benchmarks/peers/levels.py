"""ContextGS's hyperprior (Wang et al. 2024): anchors in levels, of which coarser ones predict finer ones.

An anchor of each coarse voxel stands for it. The context of a finer anchor is what the decoder has of the one that
stands for its voxel: rounded features and scalings, and how far away that is. The levels are three, each with about a
fifth of the anchors of the next finer one, as in ContextGS's code. Two things of it are left out:

- Its latents for each anchor. A Hyperprior's latents have a shape that follows from B, before anchors are known.
- The gradient that reaches coarse anchors through the contexts of fine ones. A step of the trainer collects gradients
  of visible and sampled anchors only.

It has a network for each level. Here one network reads the level.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from refcodec.bitstream.attributes import SCALINGS
from refcodec.bitstream.frame import Frame
from refcodec.bitstream.networks import ACTIVATION_MAX
from refcodec.train.rate_model.hyperprior import Contexts
from refcodec.train.rate_model.model import RateModel
from refcodec.train.stages.rate import Rate

I64 = NDArray[np.int64]

LEVELS, RATIO = 3, 0.2
# Integers that stand for one in an input: of features and scalings in base steps, of distances in voxels, of levels.
FEATURE_UNIT, SCALING_UNIT, PLACE_UNIT, LEVEL_UNIT = 4.0, 16.0, 256.0, 256.0


@dataclass(frozen=True, eq=False)
class Ladder:
    """The levels of anchors.

    level: int64 [N], 0 for the finest. parent: int64 [N], the anchor that predicts one, itself on the coarsest level.
    away: float32 [N, 3], from the parent, in edges of its voxel.
    """

    level: I64
    parent: I64
    away: NDArray[np.float32]


def ladder(cells: I64) -> Ladder:
    """The levels of anchors at cells int64 [N, 3] of the lattice."""
    n = len(cells)
    level, parent = np.zeros(n, np.int64), np.arange(n)
    away = np.zeros((n, 3), np.float32)
    # The anchors that stand for a voxel of the level at hand; of the finest level, all of them.
    standing = np.arange(n)
    for number in range(1, LEVELS):
        edge = _edge(cells[standing], RATIO)
        _, first, inverse = np.unique(
            np.floor_divide(cells[standing], edge), axis=0, return_index=True, return_inverse=True
        )
        parent[standing] = standing[first[inverse.reshape(-1)]]
        away[standing] = (cells[standing] - cells[parent[standing]]) / edge
        standing = standing[np.sort(first)]
        level[standing] = number
    # An anchor that stands for its voxel is predicted on the level above; those at the top are not.
    parent[standing], away[standing] = standing, 0
    return Ladder(level, parent, away)


def _edge(cells: I64, ratio: float) -> int:
    """The smallest edge, in cells, of voxels that are at most `ratio` as many as the anchors."""
    low, high = 1, max(int(np.ptp(cells, axis=0).max()) + 1, 2)
    while low < high:
        middle = (low + high) // 2
        if len(np.unique(np.floor_divide(cells, middle), axis=0)) > ratio * len(cells):
            low = middle + 1
        else:
            high = middle
    return low


class Levels:
    """The levels as a Hyperprior. rate: of the training that uses it, which must be set before the rate starts."""

    coded = False
    rate: Rate

    def input_units(self) -> Tensor:
        """As Hyperprior."""
        features = self.rate.scaffold.columns.features
        counts = ((FEATURE_UNIT, features), (SCALING_UNIT, SCALINGS), (PLACE_UNIT, 3), (LEVEL_UNIT, LEVELS))
        return torch.cat([torch.full((count,), unit) for unit, count in counts])

    def latent_shape(self, plane_size: int) -> tuple[int, int, int, int]:
        """As Hyperprior. NoPlanes does not use them."""
        return 1, 1, plane_size, plane_size

    def contexts(self, frame: Frame, positions: NDArray[np.float16], plane_size: int) -> Contexts:
        """As Hyperprior."""
        return _LevelContexts(ladder(positions.astype(np.int64)), self.rate)


class _LevelContexts:
    def __init__(self, found: Ladder, rate: Rate) -> None:
        self.level, self.parent = torch.from_numpy(found.level), torch.from_numpy(found.parent)
        self.away, self.rate = torch.from_numpy(found.away), rate

    def inputs(self, symbols: Tensor, rows: Tensor, rounding: bool) -> Tensor:
        level = self.level[rows]
        own = [self.away[rows] * PLACE_UNIT, torch.nn.functional.one_hot(level, LEVELS) * LEVEL_UNIT]
        context = torch.zeros(len(rows), self.rate.scaffold.columns.features + SCALINGS)
        parent = self.parent[rows]
        # A parent without a kept offset is not in the file.
        known = (parent != rows) & self.rate.masks.decided().any(dim=1)[parent]
        if bool(known.any()):
            context[known] = self._decoded(symbols, parent[known], rounding)
        found = torch.cat([context, *own], dim=1)
        return (torch.floor(found + 0.5) if rounding else found).clamp(-ACTIVATION_MAX, ACTIVATION_MAX)

    @torch.no_grad()
    def _decoded(self, symbols: Tensor, anchors: Tensor, rounding: bool) -> Tensor:
        """Features and scalings of anchors as the decoder has them, in base steps: [n, F + 6]."""
        rows, place = torch.unique(anchors, return_inverse=True)
        rate, model = self.rate, self.rate.started()
        steps = model.steps(model.activations(self.inputs(symbols, rows, rounding)))
        parts = []
        for i, kind in enumerate(("features", "scalings")):
            step = steps[:, i : i + 1] * rate.base_step[i]
            rounded = rate.quantisation.symbols([rate.scaffold.tables[kind][rows]], step)
            parts.append(rounded * steps[:, i : i + 1])
        return torch.cat(parts, dim=1)[place]


class NoPlanes(RateModel):
    """An entropy model whose hyperprior has no symbols of its own."""

    def symbols(self, noise: torch.Generator | None) -> Tensor:
        """As RateModel: zeros."""
        return torch.zeros_like(self.latents)

    def plane_bits(self, symbols: Tensor) -> Tensor:
        """As RateModel: none."""
        return torch.zeros(())
