"""The rate of a scene in training: CAT-3DGS Pro's vector-matrix hyperprior with F_h, SARM and CARM, and what it is compared with.

Units are those of refcodec.fit.model, whose networks these are: symbols, means in 1/16 step, scale indices and step indices in 1/8 octave
(SPEC.md 7.7, 7.8). Rates are bits.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import accumulate
from typing import cast

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from ..bitstream.attributes import KINDS
from ..bitstream.context import contract, frame_coordinates, positional_encoding, rescale
from ..bitstream.frame import Frame
from ..bitstream.limits import MAIN_SLICES
from ..bitstream.networks import ACTIVATION_MAX, Layer
from ..bitstream.planes import PLANES
from ..bitstream.positions import position_integers
from ..bitstream.tables import STEP_LENGTH
from .rate_model import (
    MEAN_UNIT,
    PLANE_SHIFT,
    SCALE_UNIT,
    STEP_ONE,
    FoldedMlp,
    PlaneSamples,
    gauss_bits,
    laplace_bits,
    plane_neighbours,
    round_through,
)
from .scaffold import COLUMNS, FEATURES, OFFSETS, SCALINGS

# The three kinds of attributes, in file order, and D.
WIDTHS = {kind: COLUMNS[kind] for kind in KINDS}
WIDTH = sum(WIDTHS.values())
# SPEC 11.1: Main's dimensions.
SLICES, FREQUENCIES, SARM_WIDTH = MAIN_SLICES, 10, (16, 16)
# 16 plane symbols are a latent of one (SPEC 6.9).
LATENT_UNIT = 16.0


@dataclass(frozen=True)
class Hyperprior:
    """What tells of an anchor's attributes: planes over pairs of the principal axes, with some channels, at two scales each; gamma, the
    vector of the third axis, or not."""

    axes: tuple[tuple[int, int], ...]
    channels: int
    gamma: bool


# The rows of the paper's table of hyperpriors. Only vm can be written to a file; the others are for training and estimates.
HYPERPRIORS = {
    "vm": Hyperprior(((0, 1),), 8, True),
    "plane": Hyperprior(((0, 1),), 8, False),
    "triplane": Hyperprior(((0, 1), (0, 2), (1, 2)), 8, False),
    "triplane72": Hyperprior(((0, 1), (0, 2), (1, 2)), 72, False),
}


class Contexts:
    """SPEC 7.5 for given anchors: samples of the planes, and gamma."""

    def __init__(self, hyperprior: Hyperprior, frame: Frame, lattice: NDArray[np.float16], plane_size: int) -> None:
        u = rescale(frame, contract(frame_coordinates(frame, position_integers(lattice))))
        self.samples = [PlaneSamples(u[:, list(axes)], plane_size) for axes in hyperprior.axes]
        gamma = positional_encoding(u[:, 2], FREQUENCIES) if hyperprior.gamma else np.zeros((len(u), 0))
        self.gamma = torch.from_numpy(gamma.astype(np.float32))

    def inputs(self, symbols: Tensor, rows: Tensor, rounding: bool) -> Tensor:
        """Inputs of F_h for some anchors [n], from plane symbols [5 * pairs, ch, B, B]."""
        parts = [s.query(symbols[PLANES * i : PLANES * (i + 1)], rows, rounding) for i, s in enumerate(self.samples)]
        return torch.cat([*parts, self.gamma[rows]], dim=1)


class LearnedRate(nn.Module):
    """Planes, F_h with its steps, SARM and CARM.

    mean, deviation: float64 [D] of each channel's symbols at the beginning, when every step is the base step. width: of F_h's and
    CARM's hidden layers.
    """

    def __init__(
        self,
        hyperprior: Hyperprior,
        plane_size: int,
        width: int,
        mean: NDArray,
        deviation: NDArray,
        generator: torch.Generator,
    ) -> None:
        super().__init__()
        octave = np.log2(np.maximum(deviation, 2.0**-4))
        unit = torch.tensor(2.0 ** np.round(octave), dtype=torch.float32)
        channels = 2 * hyperprior.channels * len(hyperprior.axes)
        frequencies = 2 * FREQUENCIES if hyperprior.gamma else 0
        inputs = torch.cat([torch.full((channels,), LATENT_UNIT * 2**PLANE_SHIFT), torch.full((frequencies,), 1024.0)])
        outputs = torch.cat([unit * MEAN_UNIT, torch.full((WIDTH + len(KINDS),), SCALE_UNIT)])
        self.hyper = FoldedMlp([len(inputs), width, 2 * WIDTH + len(KINDS)], inputs, outputs, generator, 0.1)
        with torch.no_grad():
            start = np.concatenate([mean / unit.numpy(), octave, np.full(len(KINDS), STEP_ONE / SCALE_UNIT)])
            self.hyper.biases[-1].copy_(torch.tensor(start, dtype=torch.float32))
            self.hyper.weights[-1][2 * WIDTH :] = 0
        # The step of scalings is one for all anchors: their symbols lie far from zero, and would move with it.
        still = torch.ones(2 * WIDTH + len(KINDS), 1)
        still[2 * WIDTH + KINDS.index("scalings")] = 0
        self.hyper.weights[-1].register_hook(lambda gradient: gradient * still)
        sarm = [4, *SARM_WIDTH, 2]
        self.sarm = FoldedMlp(
            sarm, torch.full((4,), LATENT_UNIT), torch.tensor([LATENT_UNIT * MEAN_UNIT, SCALE_UNIT]), generator, 0.1
        )
        carm, done = [], SLICES[0]
        for columns in SLICES[1:]:
            outputs = torch.cat([unit[done : done + columns] * MEAN_UNIT, torch.full((columns,), SCALE_UNIT)])
            carm.append(FoldedMlp([done, width, 2 * columns], unit[:done], outputs, generator, 0.0))
            done += columns
        self.carm = nn.ModuleList(carm)
        shape = (PLANES * len(hyperprior.axes), hyperprior.channels, plane_size, plane_size)
        self.latents = nn.Parameter(torch.randn(shape, generator=generator) * 0.03)

    def carm_networks(self) -> list[FoldedMlp]:
        """CARM of slices 1, 2 and so on."""
        return cast(list[FoldedMlp], list(self.carm))

    def coding_parameters(self) -> list[nn.Parameter]:
        """The weights of F_h, SARM and CARM."""
        return [p for name, p in self.named_parameters() if name != "latents"]

    def symbols(self, noise: torch.Generator | None) -> Tensor:
        """Plane symbols [5 * pairs, ch, B, B]: with uniform noise in their rounding's place, or rounded (noise None)."""
        fine = self.latents * LATENT_UNIT
        return round_through(fine) if noise is None else fine + torch.rand(fine.shape, generator=noise) - 0.5

    def plane_bits(self, symbols: Tensor) -> Tensor:
        """Bits of all plane symbols."""
        out = self.sarm(plane_neighbours(symbols))
        return laplace_bits(out[:, 0], out[:, 1], symbols.reshape(-1)).sum()

    def steps(self, hidden: Tensor) -> Tensor:
        """SPEC 7.8: multiples of the base steps [n, 3] of features, scalings and offsets, for the hidden activations of F_h."""
        index = self.hyper.outputs(hidden, slice(2 * WIDTH, None)).clamp(0, STEP_LENGTH - 1)
        if self.hyper.rounding:
            index = round_through(index)
        return torch.exp2((index - STEP_ONE) / SCALE_UNIT)

    def attribute_bits(self, hidden: Tensor, symbols: Tensor, kept: Tensor) -> Tensor:
        """Bits of features, scalings and offsets of each anchor: [n, 3].

        hidden [n, .]: F_h's; symbols [n, D]; kept float32 [n, K]. An anchor without a kept offset costs nothing.
        """
        out = self.hyper.outputs(hidden, slice(0, 2 * WIDTH))
        mean, scale = out[:, :WIDTH], out[:, WIDTH:]
        means, scales = [mean[:, : SLICES[0]]], [scale[:, : SLICES[0]]]
        done = SLICES[0]
        earlier = symbols[:, : FEATURES - SLICES[-1]].clamp(-ACTIVATION_MAX, ACTIVATION_MAX)
        for columns, network in zip(SLICES[1:], self.carm_networks(), strict=True):
            change = network(earlier[:, :done])
            means.append(mean[:, done : done + columns] + change[:, :columns])
            scales.append(scale[:, done : done + columns] + change[:, columns:])
            done += columns
        bits = gauss_bits(
            torch.cat([*means, mean[:, done:]], dim=1), torch.cat([*scales, scale[:, done:]], dim=1), symbols
        )
        some = 1 - torch.prod(1 - kept, dim=1)
        offsets = (bits[:, FEATURES + SCALINGS :].reshape(len(bits), OFFSETS, 3).sum(dim=2) * kept).sum(dim=1)
        return torch.stack(
            [bits[:, :FEATURES].sum(dim=1) * some, bits[:, FEATURES : FEATURES + SCALINGS].sum(dim=1) * some, offsets],
            dim=1,
        )

    @torch.no_grad()
    def set_rounding(self, inputs: Tensor, earlier: Tensor, symbols: Tensor) -> None:
        """From now on activations are rounded and cut as in the decoder; their units are calibrated on these inputs of F_h, of CARM, and
        plane symbols."""
        self.hyper.calibrate(inputs)
        self.sarm.calibrate(plane_neighbours(symbols))
        for network, done in zip(self.carm_networks(), accumulate(SLICES), strict=False):
            network.calibrate(earlier[:, :done])
        self.rounding(True)

    def rounding(self, on: bool) -> None:
        """Whether activations are rounded and cut as in the decoder."""
        for network in (self.hyper, self.sarm, *self.carm_networks()):
            network.rounding = on

    def set_grid(self, coarser: int) -> None:
        """From now on the networks' weights are on grids (FoldedMlp.set_grid)."""
        for network in (self.hyper, self.sarm, *self.carm_networks()):
            network.set_grid(coarser)

    def gridded(self, on: bool) -> None:
        """Whether the networks' weights are on the grids that they have."""
        for network in (self.hyper, self.sarm, *self.carm_networks()):
            network.gridded = on

    def networks(self) -> dict[str, list[Layer]]:
        """F_h, SARM and CARM as SPEC 5.8 stores them."""
        carm = {f"carm.{i}": network.layers() for i, network in enumerate(self.carm_networks(), start=1)}
        return {"hyper": self.hyper.layers(), "sarm": self.sarm.layers(), **carm}
