"""The entropy model in training: planes, F_h with its steps, SARM and CARM (SPEC.md chapter 7). Rates are bits."""

import math
from itertools import accumulate
from typing import cast

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from ...bitstream.attributes import KINDS, SCALINGS
from ...bitstream.networks import ACTIVATION_MAX, Layer
from ...bitstream.planes import PLANES
from ...bitstream.tables import STEP_LENGTH
from ...encoder.sizes import SLICES
from ..cpu.attributes import AttributeBits, Counting
from ..cpu.plane_bits import PlaneBits
from ..device import has_kernel
from ..settings import EntropySettings
from .bits import TorchBits
from .columns import Columns
from .folded import FoldedMlp
from .hyperprior import input_units, plane_neighbours
from .units import LATENT_UNIT, MEAN_UNIT, SCALE_UNIT, STEP_ONE, round_through

# The number of offsets of an anchor, and the widths of SARM's hidden layers, both as in the paper.
OFFSETS, SARM_WIDTH = 10, (16, 16)
PAPER = Columns(SLICES, OFFSETS)


def count_torch(out: Tensor, change: Tensor, symbols: Tensor, kept: Tensor, floor: float, of: Columns) -> Tensor:
    """RateModel.attribute_bits of F_h's outputs [n, 2 D] and CARM's [n, .], with torch on the tensors' device."""
    mean, scale = out[:, : of.width], out[:, of.width :]
    changed = slice(of.slices[0], of.features)
    by_mean, by_scale = (change[:, columns[changed].to(change.device)] for columns in of.changes())
    rest = (of.slices[0], of.width - of.features)
    mean, scale = mean + functional.pad(by_mean, rest), scale + functional.pad(by_scale, rest)
    bits: Tensor = TorchBits.apply(mean, scale, symbols, True, floor)
    some = 1 - torch.prod(1 - kept, dim=1)
    place = slice(of.features, of.features + SCALINGS)
    offsets = (bits[:, place.stop :].reshape(len(bits), of.offsets, 3).sum(dim=2) * kept).sum(dim=1)
    return torch.stack([bits[:, : of.features].sum(dim=1) * some, bits[:, place].sum(dim=1) * some, offsets], dim=1)


class RateModel(nn.Module):
    """Planes, F_h with its steps, SARM and CARM of one scene of Main.

    The trained values are `latents`, the planes in units of LATENT_UNIT symbols, and the parameters of the networks.
    sarm: None without planes. columns: of the attributes.
    """

    floor: float
    columns: Columns
    hyper: FoldedMlp
    carm: torch.nn.ModuleList
    latents: torch.nn.Parameter

    def __init__(
        self,
        plane_size: int,
        width: int,
        mean: NDArray[np.float64],
        deviation: NDArray[np.float64],
        generator: torch.Generator,
        settings: EntropySettings,
        carm_shift: NDArray[np.uint8] | None = None,
        columns: Columns = PAPER,
    ) -> None:
        """plane_size: B, 0 without planes. width: of the hidden layers of F_h and CARM.

        mean, deviation: [D], of each channel's symbols at the beginning, when every step is the base step. carm_shift:
        SPEC 7.9, of CARM's inputs; None for zeros.
        """
        super().__init__()
        self.floor, self.columns = settings.floor, columns
        slices, total = columns.slices, columns.width
        self.carm_unit: Tensor | None = None
        if carm_shift is not None and carm_shift.any():
            self.carm_unit = torch.from_numpy(np.exp2(carm_shift.astype(np.float32)))
        octave = np.log2(np.maximum(deviation, settings.deviation))
        unit = torch.tensor(2.0 ** np.round(octave), dtype=torch.float32)

        def network(widths: list[int], inputs: Tensor, outputs: Tensor, gain: float = settings.gain) -> FoldedMlp:
            return FoldedMlp(widths, inputs, outputs, generator, gain, settings.bias)

        inputs = input_units(settings.channels, settings.frequencies)
        outputs = torch.cat([unit * MEAN_UNIT, torch.full((total + len(KINDS),), SCALE_UNIT)])
        # SPEC 11.1: F_h without inputs is a row of constants.
        hidden = [width] * settings.layers
        self.hyper = network([len(inputs), *(hidden if len(inputs) else []), 2 * total + len(KINDS)], inputs, outputs)
        with torch.no_grad():
            start = np.concatenate([mean / unit.numpy(), octave, np.full(len(KINDS), STEP_ONE / SCALE_UNIT)])
            self.hyper.biases[-1].copy_(torch.tensor(start, dtype=torch.float32))
            self.hyper.weights[-1][2 * total :] = 0
        shape = PLANES, settings.channels, plane_size, plane_size
        self.sarm: FoldedMlp | None = None
        if math.prod(shape):
            outputs = torch.tensor([LATENT_UNIT * MEAN_UNIT, SCALE_UNIT])
            self.sarm = network([4, *SARM_WIDTH, 2], torch.full((4,), LATENT_UNIT), outputs)
        inputs = unit[: columns.carm_inputs] / (1 if self.carm_unit is None else self.carm_unit)
        carm, done = [], slices[0]
        for own in slices[1:]:
            outputs = torch.cat([unit[done : done + own] * MEAN_UNIT, torch.full((own,), SCALE_UNIT)])
            carm.append(network([done, *hidden, 2 * own], inputs[:done], outputs, 0.0))
            done += own
        self.carm = nn.ModuleList(carm)
        self.latents = nn.Parameter(torch.randn(shape, generator=generator) * settings.planes)

    def _networks(self) -> list[FoldedMlp]:
        """F_h, SARM, and CARM of slices 1, 2 and so on."""
        return [self.hyper, *([] if self.sarm is None else [self.sarm]), *self._carm()]

    def _carm(self) -> list[FoldedMlp]:
        return cast(list[FoldedMlp], list(self.carm))

    def coding_parameters(self) -> list[nn.Parameter]:
        """The weights of F_h, SARM and CARM."""
        return [p for name, p in self.named_parameters() if name != "latents"]

    # --- bits ---------------------------------------------------------------------------------------------------------

    def symbols(self, noise: torch.Generator | None) -> Tensor:
        """Plane symbols [planes, ch, B, B]: with uniform noise in place of rounding, or rounded if noise is None."""
        fine = self.latents * LATENT_UNIT
        return (
            round_through(fine)
            if noise is None
            else fine + torch.rand(fine.shape, generator=noise, device=fine.device) - 0.5
        )

    def plane_bits(self, symbols: Tensor) -> Tensor:
        """Bits of all plane symbols, which are part of a loss."""
        if self.sarm is None:
            return symbols.new_zeros(())
        if has_kernel(symbols):
            plans = [self.sarm.plan(i) for i in range(self.sarm.hidden + 1)]
            bits: Tensor = PlaneBits.apply(plans, symbols, self.floor, *self.sarm.pairs())
            return bits
        out = self.sarm(plane_neighbours(symbols))
        bits = TorchBits.apply(out[:, 0], out[:, 1], symbols.reshape(-1), False, self.floor)
        return bits.sum()

    def activations(self, inputs: Tensor) -> Tensor:
        """The last hidden activations of F_h, [n, .], for its inputs."""
        return self.hyper.activations(inputs)

    def steps(self, hidden: Tensor) -> Tensor:
        """SPEC 7.8: multiples of the base steps, [n, 3], for the hidden activations of F_h.

        Columns are those of features, scalings and offsets.
        """
        index = self.hyper.outputs(hidden, slice(2 * self.columns.width, None)).clamp(0, STEP_LENGTH - 1)
        if self.integers:
            index = round_through(index)
        return torch.exp2((index - STEP_ONE) / SCALE_UNIT)

    def hold_scalings(self) -> None:
        """Clears the gradient of the weights that would make the step of scalings depend on the anchor.

        It is one for all anchors: their symbols lie far from zero, and would move with it.
        """
        gradient = self.hyper.weights[-1].grad
        if gradient is not None:
            gradient[2 * self.columns.width + KINDS.index("scalings")] = 0

    def attribute_bits(self, hidden: Tensor, symbols: Tensor, kept: Tensor) -> Tensor:
        """Bits of features, scalings and offsets of each anchor, [n, 3].

        hidden [n, .]: of F_h. symbols [n, D]. kept: float32 [n, K]. An anchor without a kept offset has no bits.
        """
        # In the kernel, CARM's inputs have a gradient only where they equal the symbols (SPEC 7.9).
        if has_kernel(hidden) and not (self.carm_unit is not None and symbols.requires_grad):
            return self._attribute_bits_on_cpu(hidden, symbols, kept)
        out = self.hyper.outputs(hidden, slice(0, 2 * self.columns.width))
        earlier = self.carm_inputs(symbols[:, : self.columns.carm_inputs])
        widths = accumulate(self.columns.slices)
        changes = [network(earlier[:, :w]) for network, w in zip(self._carm(), widths, strict=False)]
        change = torch.cat([out.new_zeros(len(out), 0), *changes], dim=1)
        return count_torch(out, change, symbols, kept, self.floor, self.columns)

    def _attribute_bits_on_cpu(self, hidden: Tensor, symbols: Tensor, kept: Tensor) -> Tensor:
        of, last, carm = self.columns, self.hyper.hidden, self._carm()
        rows = slice(0, 2 * of.width)
        plans = [[network.plan(i) for i in range(network.hidden + 1)] for network in carm]
        counting = Counting(rows, self.hyper.plan(last, rows), plans, of.changes().numpy(), of.features, self.floor)
        parameters = self.hyper.pairs()[-2:]
        for network in carm:
            parameters += network.pairs()
        with torch.no_grad():
            earlier = self.carm_inputs(symbols[:, : of.carm_inputs])
        bits: Tensor = AttributeBits.apply(counting, hidden, symbols, earlier, kept, *parameters)
        return bits

    def carm_inputs(self, features: Tensor) -> Tensor:
        """SPEC 7.9: CARM's inputs for symbols of features [n, .], shifted where they are large, and cut."""
        if self.carm_unit is not None:
            features = torch.floor(features / self.carm_unit + 0.5)
        return features.clamp(-ACTIVATION_MAX, ACTIVATION_MAX)

    # --- as the decoder has it ----------------------------------------------------------------------------------------

    @property
    def integers(self) -> bool:
        """Whether activations are rounded and clamped as in the decoder."""
        return self.hyper.rounding

    def set_integers(self, on: bool) -> None:
        """Sets whether activations are rounded and clamped as in the decoder, in their present units."""
        for network in self._networks():
            network.rounding = on

    @torch.no_grad()
    def calibrate(self, inputs: Tensor, earlier: Tensor, symbols: Tensor) -> None:
        """set_integers, with units that fit these inputs of F_h [n, .] and of CARM [n, .], and these plane symbols."""
        self.hyper.calibrate(inputs)
        if self.sarm is not None:
            self.sarm.calibrate(plane_neighbours(symbols))
        for network, done in zip(self._carm(), accumulate(self.columns.slices), strict=False):
            network.calibrate(earlier[:, :done])
        self.set_integers(True)

    def set_grid(self, coarser: int) -> None:
        """Puts the networks' weights on grids, as FoldedMlp.set_grid does."""
        for network in self._networks():
            network.set_grid(coarser)

    def set_gridded(self, on: bool) -> None:
        """Sets whether the networks' weights are on their grids."""
        for network in self._networks():
            network.gridded = on

    def networks(self) -> dict[str, list[Layer]]:
        """F_h, SARM and CARM as SPEC 5.8 stores them."""
        carm = {f"carm.{i}": network.layers() for i, network in enumerate(self._carm(), start=1)}
        sarm = {} if self.sarm is None else {"sarm": self.sarm.layers()}
        return {"hyper": self.hyper.layers(), **sarm, **carm}
