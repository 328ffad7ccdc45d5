"""HAC's hyperprior (Chen et al. 2024): hash tables of signs, for grids in space and on planes at many resolutions.

Corners of a grid's cell are looked up in its table, by their number or, where there are more corners than entries, by
the hash of Mueller et al., "Instant Neural Graphics Primitives" (2022). Their features, which are signs, are
interpolated. The bits of the tables are the entropy of all signs, with one probability.

HAC has tables of a fixed size, for scenes of about 400,000 anchors, and resolutions to go with them. Here both are
scaled: tables with the number of anchors, resolutions with its root. There are about 6 signs for an anchor (HAC: 4.5).
Places are those of SPEC 7.5.3, as for the other hyperpriors of the comparison. HAC's are of a box without contraction.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from refcodec.bitstream.context import UNIT_BITS
from refcodec.bitstream.frame import Frame
from refcodec.bitstream.networks import ACTIVATION_MAX
from refcodec.train.rate_model.hyperprior import Contexts, scene_coordinates
from refcodec.train.rate_model.model import RateModel
from refcodec.train.rate_model.units import round_through

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

# Features of an entry (HAC's code).
FEATURES = 4
# The integer that stands for a sign in an input of F_h.
SIGN_UNIT = 256.0
# Factors of the hash, for the first, second and third axis.
PRIMES = (1, 2654435761, 805459861)
# HAC's coarsest and finest grids over the root of 400,000, and 5, the root of the anchors over B (SPEC B.3).
_ROOT = 400_000**0.5 / 5


@dataclass(frozen=True)
class Grid:
    """Grids over some axes. axes: of the principal ones. levels: how many. coarsest, finest: cells over B.

    units: entries of a table, in B^2.
    """

    axes: tuple[int, ...]
    levels: int
    coarsest: float
    finest: float
    units: int

    def resolutions(self, plane_size: int) -> list[int]:
        """Cells along an axis at each level."""
        cells = np.geomspace(self.coarsest * plane_size, self.finest * plane_size, self.levels)
        return [max(round(float(c)), 2) for c in cells]


# HAC's code: twelve levels in space, four on each plane, of larger tables.
GRIDS = (
    Grid((0, 1, 2), 12, 18 / _ROOT, 514 / _ROOT, 1),
    *(Grid(axes, 4, 130 / _ROOT, 1026 / _ROOT, 2) for axes in ((0, 1), (0, 2), (1, 2))),
)


@dataclass(frozen=True)
class HashGrid:
    """HAC's grids (a Hyperprior). The planes' symbols are the tables, of B x B entries each."""

    grids: tuple[Grid, ...] = GRIDS
    coded: bool = False

    def input_units(self) -> Tensor:
        """As Hyperprior."""
        return torch.full((FEATURES * sum(grid.levels for grid in self.grids),), SIGN_UNIT)

    def latent_shape(self, plane_size: int) -> tuple[int, int, int, int]:
        """As Hyperprior."""
        return sum(grid.levels * grid.units for grid in self.grids), FEATURES, plane_size, plane_size

    def contexts(self, frame: Frame, positions: NDArray[np.float16], plane_size: int) -> Contexts:
        """As Hyperprior."""
        u = scene_coordinates(frame, positions) / 2.0**UNIT_BITS
        return _HashContexts(u, self.grids, plane_size)


class _HashContexts:
    def __init__(self, u: F64, grids: tuple[Grid, ...], plane_size: int) -> None:
        self.samples: list[tuple[slice, Tensor, Tensor]] = []
        first = 0
        for grid in grids:
            for cells in grid.resolutions(plane_size):
                corners, shares = corner_entries(u[:, list(grid.axes)], cells, grid.units * plane_size**2)
                self.samples.append((slice(first, first + grid.units), torch.from_numpy(corners), shares))
                first += grid.units

    def inputs(self, symbols: Tensor, rows: Tensor, rounding: bool) -> Tensor:
        parts = []
        for units, corners, shares in self.samples:
            table = symbols[units].transpose(0, 1).reshape(FEATURES, -1).T.contiguous()
            parts.append(functional.embedding_bag(corners[rows], table, per_sample_weights=shares[rows], mode="sum"))
        found = torch.cat(parts, dim=1) * SIGN_UNIT
        return (round_through(found) if rounding else found).clamp(-ACTIVATION_MAX, ACTIVATION_MAX)


def corner_entries(u: F64, cells: int, entries: int) -> tuple[I64, Tensor]:
    """The entries of the 2^d corners around places u [N, d] in [0, 1], int64 [N, 2^d], and float32 weights of them.

    cells: along each axis. entries: of the table.
    """
    axes = u.shape[1]
    at = u * cells
    low = np.minimum(np.floor(at), cells - 1).astype(np.int64)
    share = at - low
    numbers, weights = [], []
    for corner in product((0, 1), repeat=axes):
        place = low + np.array(corner)
        numbers.append(_entry(place, cells + 1, entries))
        weights.append(np.prod(np.where(corner, share, 1 - share), axis=1))
    return np.stack(numbers, axis=1), torch.from_numpy(np.stack(weights, axis=1).astype(np.float32))


def _entry(place: I64, side: int, entries: int) -> I64:
    if side ** place.shape[1] <= entries:
        return np.asarray(place @ (side ** np.arange(place.shape[1])))
    found = np.zeros(len(place), np.int64)
    for column, prime in zip(place.T, PRIMES, strict=False):
        found ^= column * prime
    return found % entries


class Signs(RateModel):
    """An entropy model whose planes are signs, whatever the phase of training, with the gradient of the latents."""

    def symbols(self, noise: torch.Generator | None) -> Tensor:
        """As RateModel: 1 or -1. The gradient is the identity's where a latent is within -1 and 1, else 0."""
        cut = self.latents.clamp(-1, 1)
        return cut + (torch.where(self.latents >= 0, 1.0, -1.0) - cut).detach()

    def plane_bits(self, symbols: Tensor) -> Tensor:
        """As RateModel: the entropy of all signs. Its gradient is that of the share of ones."""
        share = ((symbols + 1) / 2).mean().clamp(1e-6, 1 - 1e-6)
        return -symbols.numel() * (share * share.log2() + (1 - share) * (1 - share).log2())
