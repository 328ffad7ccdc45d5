"""The hyperprior: the inputs of F_h, from planes of symbols and the position of an anchor (SPEC.md 7.5)."""

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from ...bitstream.context import LERP_BITS, UNIT_BITS, contract, frame_coordinates, positional_encoding, rescale
from ...bitstream.conventions import Int64
from ...bitstream.frame import Frame
from ...bitstream.networks import ACTIVATION_MAX
from ...bitstream.positions import position_integers
from ..cpu.query import Query
from ..device import has_kernel
from .units import GAMMA_UNIT, LATENT_UNIT, PLANE_SHIFT, round_through


class PlaneSamples:
    """SPEC 7.5.4 for given positions.

    corners: int64 [2, n, 4], of the planes of both scales. shares: float32 [2, n, 4], their weights.
    """

    corners: torch.Tensor
    shares: torch.Tensor

    def __init__(self, u: Int64, plane_size: int) -> None:
        """u: integers [n, 2] in [0, 2^16], columns of the plane along u[:, 0]. plane_size: B."""
        corners, shares = [], []
        for size in (plane_size, 2 * plane_size):
            grid = u * (size - 1)
            cell = np.minimum(grid >> UNIT_BITS, size - 2)
            cut = UNIT_BITS - LERP_BITS
            share = (grid - (cell << UNIT_BITS) + (1 << (cut - 1)) >> cut) / (1 << LERP_BITS)
            at = cell[:, 1] * size + cell[:, 0]
            fj, fi = share[:, 0], share[:, 1]
            corners.append(np.stack([at, at + 1, at + size, at + size + 1], axis=1))
            weights = [(1 - fj) * (1 - fi), fj * (1 - fi), (1 - fj) * fi, fj * fi]
            shares.append(np.stack(weights, axis=1))
        self.corners = torch.as_tensor(np.stack(corners))
        self.shares = torch.as_tensor(np.stack(shares).astype(np.float32))

    def query_torch(self, symbols: Tensor, rows: Tensor, rounding: bool) -> Tensor:
        """Contexts of the anchors `rows` from plane symbols [5, ch, B, B]: float32 [b, 2 ch], in [-1023, 1023]."""
        channels = symbols.shape[1]
        top, bottom = (torch.cat([symbols[i], symbols[i + 1]], dim=2) for i in (1, 3))
        parts = []
        for plane, corners, shares in zip(
            (symbols[0], torch.cat([top, bottom], dim=1)), self.corners, self.shares, strict=True
        ):
            table = plane.reshape(channels, -1).T.contiguous()
            parts.append(functional.embedding_bag(corners[rows], table, per_sample_weights=shares[rows], mode="sum"))
        units = torch.cat(parts, dim=1) * 2.0**PLANE_SHIFT
        return (round_through(units) if rounding else units).clamp(-ACTIVATION_MAX, ACTIVATION_MAX)


@dataclass(frozen=True)
class Contexts:
    """The contexts of given anchors. samples: None without planes. gamma: float32 [N, 2 L]."""

    samples: PlaneSamples | None
    gamma: Tensor

    def inputs(self, symbols: Tensor, rows: Tensor, rounding: bool) -> Tensor:
        """Returns the inputs of F_h for the anchors `rows`, float32 [n, inputs].

        symbols: of the planes, [5, ch, B, B]. rounding: whether contexts are integers, as in the decoder.
        """
        if self.samples is None:
            return self.gamma[rows]
        if has_kernel(symbols):
            inputs: Tensor = Query.apply(symbols, rows, self.samples.corners, self.samples.shares, self.gamma, rounding)
            return inputs
        return torch.cat([self.samples.query_torch(symbols, rows, rounding), self.gamma[rows]], dim=1)


def input_units(channels: int, frequencies: int) -> Tensor:
    """The integer that stands for one in each input of F_h: float32 [2 channels + 2 frequencies], powers of two."""
    planes = torch.full((2 * channels,), LATENT_UNIT * 2**PLANE_SHIFT)
    return torch.cat([planes, torch.full((2 * frequencies,), GAMMA_UNIT)])


def contexts(frame: Frame | None, positions: NDArray[np.float16], plane_size: int, frequencies: int) -> Contexts:
    """SPEC 7.5.1 to 7.5.3: the contexts of anchors at the given cells of the lattice, fp16 [N, 3].

    frame: None if F_h has no inputs (SPEC 6.6). plane_size: B, 0 without planes.
    """
    if frame is None:
        return Contexts(None, torch.zeros(len(positions), 0))
    u = rescale(frame, contract(frame_coordinates(frame, position_integers(positions))))
    gamma = torch.as_tensor(positional_encoding(u[:, 2], frequencies).astype(np.float32))
    return Contexts(PlaneSamples(u[:, :2], plane_size) if plane_size else None, gamma)


def plane_neighbours(symbols: Tensor) -> Tensor:
    """SPEC 7.3: the contexts (i-1, j-1), (i-1, j), (i-1, j+1) and (i, j-1) of all plane symbols, [planes ch B B, 4].

    symbols: [planes, ch, B, B]. A neighbour outside its plane is 0.
    """
    size = symbols.shape[-1]
    padded = functional.pad(symbols, (1, 1, 1, 0))
    views = [padded[..., di : di + size, dj : dj + size] for di, dj in ((0, 0), (0, 1), (0, 2), (1, 0))]
    return torch.stack([view.reshape(-1) for view in views], dim=1).clamp(-ACTIVATION_MAX, ACTIVATION_MAX)
