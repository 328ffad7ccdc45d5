"""The rate model in float32, in the codec's own units, and its export to the weights of SPEC.md 5.8.

Inputs and outputs of each network are those of SPEC 7: integers in [-1023, 1023] in, means in 1/16 step and scale indices in 1/8
octave out. Between them the parameters are of order one; every factor between the two is a power of two, so that folding it into
a stored weight is exact.
"""

from __future__ import annotations

import math
from itertools import accumulate, pairwise
from typing import Any, cast

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from ..bitstream.context import LERP_BITS, UNIT_BITS
from ..bitstream.conventions import Int64
from ..bitstream.dimensions import Dimensions
from ..bitstream.networks import ACCUMULATOR_BOUND, ACTIVATION_MAX, WEIGHT_MAX, Layer, derive_layer
from ..bitstream.planes import PLANES
from ..bitstream.tables import SCALE_END, SCALE_MIN, STEP_LENGTH

# Probability added in training: about that of an escape (14 bits of its model and some raw ones, SPEC 8.7), so that an outlier costs
# what it will cost.
FLOOR = 2.0**-20
# Bits of the mean's fraction, of an octave of the scale, and the largest scale index worth training.
MEAN_UNIT, SCALE_UNIT = 16.0, 8.0
SCALE_MOST = SCALE_END + 8 * 16
# SPEC 7.8: the step index whose multiplier is one.
STEP_ONE = STEP_LENGTH // 2
# SPEC 7.5.4: a plane symbol becomes 16 units of context, so that interpolation keeps four bits of fraction.
PLANE_SHIFT = 4


class _Bits(torch.autograd.Function):
    """-log2 of a symbol's probability under SPEC A.3's distributions, with an analytic gradient."""

    @staticmethod
    def forward(ctx: Any, mean: Tensor, scale: Tensor, symbol: Tensor, gauss: bool) -> Tensor:
        deviation = torch.exp2(scale.clamp(SCALE_MIN, SCALE_MOST) / SCALE_UNIT)
        away = symbol - mean / MEAN_UNIT
        a = away.abs()
        t0, t1 = (a - 0.5) / deviation, (a + 0.5) / deviation
        tail = _gauss_tail if gauss else _laplace_tail
        p = tail(t0) - tail(t1)
        p = p.clamp_min(0) + FLOOR
        ctx.save_for_backward(away, deviation, t0, t1, p, scale)
        ctx.gauss = gauss
        return -torch.log2(p)

    @staticmethod
    def backward(ctx: Any, *outputs: Tensor) -> tuple[Tensor | None, ...]:
        away, deviation, t0, t1, p, scale = ctx.saved_tensors
        if ctx.gauss:
            d0, d1 = (torch.exp(-t * t / 2) * (1 / math.sqrt(2 * math.pi)) for t in (t0, t1))
        else:
            d0, d1 = (torch.exp(-t.abs()) / 2 for t in (t0, t1))
        upstream = outputs[0] / p
        by_mean = upstream * torch.sign(away) * (d1 - d0) / deviation / (MEAN_UNIT * math.log(2))
        by_scale = upstream * (t1 * d1 - t0 * d0) / SCALE_UNIT
        # Past the table's smallest scale a gradient may lead back inside, no further out.
        by_scale = torch.where((scale <= SCALE_MIN) & (by_scale > 0), torch.zeros_like(by_scale), by_scale)
        symbol = -by_mean * MEAN_UNIT if ctx.needs_input_grad[2] else None
        return by_mean, by_scale, symbol, None


def _gauss_tail(t: Tensor) -> Tensor:
    """The share of a unit Gaussian distribution above t."""
    return torch.erfc(t * math.sqrt(0.5)) / 2


def _laplace_tail(t: Tensor) -> Tensor:
    """The share of a unit Laplace distribution above t."""
    tail = torch.exp(-t.abs()) / 2
    return torch.where(t >= 0, tail, 1 - tail)


def gauss_bits(mean: Tensor, scale: Tensor, symbol: Tensor) -> Tensor:
    """Bits of each symbol; mean in 1/16 step, scale index in 1/8 octave (SPEC 7.7)."""
    return _Bits.apply(mean, scale, symbol, True)


def laplace_bits(mean: Tensor, scale: Tensor, symbol: Tensor) -> Tensor:
    """Bits of each plane symbol (SPEC 7.3); the gradient reaches the symbol too."""
    return _Bits.apply(mean, scale, symbol, False)


def round_through(x: Tensor) -> Tensor:
    """Rounding half up whose gradient is the identity's."""
    return x + (torch.floor(x + 0.5) - x).detach()


def grid_through(x: Tensor, step: Tensor) -> Tensor:
    """Rounding half up to multiples of a power of two, whose gradient is the identity's."""
    return x + (torch.floor(x / step + 0.5) * step - x).detach()


class FoldedMlp(nn.Module):
    """An MLP on integer activations (SPEC 7.2), trained in parameters of order one.

    widths: inputs, hidden widths, outputs; input_unit and output_unit: powers of two, float32 [in] and [out]: the integers that
    stand for one at the inputs and outputs. Buffers hidden_unit.*: the same for each hidden activation; calibrate sets them. Buffers
    step.*: of each row's weights and bias in the file, if they are multiples of one; set_grid sets them.
    """

    def __init__(
        self, widths: list[int], input_unit: Tensor, output_unit: Tensor, generator: torch.Generator, gain: float
    ) -> None:
        super().__init__()
        self.weights, self.biases = nn.ParameterList(), nn.ParameterList()
        for i, (fan_in, out) in enumerate(pairwise(widths)):
            last = i == len(widths) - 2
            spread = (gain if last else math.sqrt(2)) / math.sqrt(fan_in)
            self.weights.append(nn.Parameter(torch.randn(out, fan_in, generator=generator) * spread))
            self.biases.append(nn.Parameter(torch.zeros(out) if last else torch.rand(out, generator=generator) * 0.2))
        self.register_buffer("input_unit", input_unit)
        self.register_buffer("output_unit", output_unit)
        self.hidden = len(widths) - 2
        for i in range(self.hidden):
            self.register_buffer(f"hidden_unit_{i}", torch.full((widths[i + 1],), 64.0))
        for i, out in enumerate(widths[1:]):
            self.register_buffer(f"step_{i}", torch.ones(out))
        self.rounding = self.gridded = False

    def forward(self, inputs: Tensor) -> Tensor:
        """inputs: integers as float32 [n, in]. Returns float32 [n, out] in the units of the file."""
        return self.outputs(self.activations(inputs), slice(None))

    def outputs(self, hidden: Tensor, columns: slice) -> Tensor:
        """Some columns of the outputs for the last hidden activations."""
        return functional.linear(hidden, *self._layer(self.hidden, columns)) * self.get_buffer("output_unit")[columns]

    def activations(self, inputs: Tensor) -> Tensor:
        """The last hidden activations."""
        x = inputs / self.get_buffer("input_unit")
        for i in range(self.hidden):
            x = functional.relu(functional.linear(x, *self._layer(i, slice(None))))
            if self.rounding:
                unit = self.get_buffer(f"hidden_unit_{i}")
                x = round_through((x * unit).clamp_max(ACTIVATION_MAX)) / unit
        return x

    @torch.no_grad()
    def calibrate(self, inputs: Tensor) -> None:
        """Sets each hidden activation's unit to the largest power of two that keeps it within 1023 for these inputs, and its
        row of weights within half of SPEC 7.2's bounds."""
        x = inputs / self.get_buffer("input_unit")
        before = self.get_buffer("input_unit")
        for i in range(self.hidden):
            x = functional.relu(functional.linear(x, self.weights[i], self.biases[i]))
            row = (self.weights[i] / before).abs()
            total = row.sum(dim=1) * ACTIVATION_MAX + self.biases[i].abs()
            limits = (
                ACTIVATION_MAX / x.max(dim=0).values,
                WEIGHT_MAX / 2 / row.max(dim=1).values,
                ACCUMULATOR_BOUND / 2 / total,
            )
            unit = torch.stack(limits).min(dim=0).values.clamp(2.0**-16, 2.0**16)
            before = self.get_buffer(f"hidden_unit_{i}").copy_(torch.exp2(torch.floor(torch.log2(unit))))

    def _units(self, layer: int) -> tuple[Tensor, Tensor]:
        """What a layer's weights [out, in] and biases [out] are multiplied by in the file: powers of two."""
        before = self.get_buffer(f"hidden_unit_{layer - 1}" if layer else "input_unit")
        after = self.get_buffer(f"hidden_unit_{layer}" if layer < self.hidden else "output_unit")
        return after[:, None] / before[None, :], after

    def _layer(self, layer: int, rows: slice) -> tuple[Tensor, Tensor]:
        """Some rows of a layer's weights and biases, on their grid if there is one."""
        weight, bias = self.weights[layer][rows], self.biases[layer][rows]
        if not self.gridded:
            return weight, bias
        weight_unit, bias_unit = self._units(layer)
        step = self.get_buffer(f"step_{layer}")[rows]
        return grid_through(weight, step[:, None] / weight_unit[rows]), grid_through(bias, step / bias_unit[rows])

    @torch.no_grad()
    def set_grid(self, coarser: int) -> None:
        """From now on each row's weights and bias are multiples of 2^coarser steps of its integers (SPEC 7.2). Raises
        networks.BoundError for a row that has none."""
        self.gridded = False
        for i, (weight, bias) in enumerate(self.layers()):
            exponent = torch.from_numpy(coarser - derive_layer(weight, bias).exponent)
            self.get_buffer(f"step_{i}").copy_(torch.exp2(exponent.float()))
        self.gridded = True

    @torch.no_grad()
    def layers(self) -> list[Layer]:
        """The weights that SPEC 5.8 stores: float32 (weight [out, in], bias [out]) of each layer."""
        found = []
        for i in range(self.hidden + 1):
            layer = zip(self._layer(i, slice(None)), self._units(i), strict=True)
            weight, bias = ((value * unit).numpy().astype(np.float32) for value, unit in layer)
            found.append((weight, bias))
        return found


class PlaneSamples:
    """SPEC 7.5.4 for given positions: corners int64 [n, 4] and weights float32 [n, 4] of both planes.

    u: integers [n, 2] in [0, 2^16], columns along u[:, 0].
    """

    def __init__(self, u: Int64, plane_size: int) -> None:
        self.corners, self.shares = [], []
        for size in (plane_size, 2 * plane_size):
            grid = u * (size - 1)
            cell = np.minimum(grid >> UNIT_BITS, size - 2)
            cut = UNIT_BITS - LERP_BITS
            share = (grid - (cell << UNIT_BITS) + (1 << (cut - 1)) >> cut) / (1 << LERP_BITS)
            at = cell[:, 1] * size + cell[:, 0]
            fj, fi = share[:, 0], share[:, 1]
            self.corners.append(torch.from_numpy(np.stack([at, at + 1, at + size, at + size + 1], axis=1)))
            weights = [(1 - fj) * (1 - fi), fj * (1 - fi), (1 - fj) * fi, fj * fi]
            self.shares.append(torch.from_numpy(np.stack(weights, axis=1).astype(np.float32)))

    def query(self, symbols: Tensor, rows: Tensor, rounding: bool) -> Tensor:
        """Context of the anchors `rows` [b] from plane symbols [5, ch, B, B]: float32 [b, 2 ch], in [-1023, 1023]."""
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


def plane_neighbours(symbols: Tensor) -> Tensor:
    """SPEC 7.3: contexts (i-1, j-1), (i-1, j), (i-1, j+1), (i, j-1) of symbols [5, ch, B, B], zero padded: [5 ch B B, 4]."""
    size = symbols.shape[-1]
    padded = functional.pad(symbols, (1, 1, 1, 0))
    views = [padded[..., di : di + size, dj : dj + size] for di, dj in ((0, 0), (0, 1), (0, 2), (1, 0))]
    return torch.stack([view.reshape(-1) for view in views], dim=1).clamp(-ACTIVATION_MAX, ACTIVATION_MAX)


class RateModel(nn.Module):
    """Planes, F_h, SARM and CARM of one scene.

    mean and deviation: float64 [D], of each channel's symbols; carm_shift: SPEC 7.9. Rates are bits.
    """

    def __init__(
        self,
        d: Dimensions,
        mean: NDArray[np.float64],
        deviation: NDArray[np.float64],
        carm_shift: NDArray[np.uint8],
        seed: int,
    ) -> None:
        super().__init__()
        generator = torch.Generator().manual_seed(seed)
        self.d = d
        octave = np.log2(np.maximum(deviation, 2.0**-4))
        unit = torch.tensor(2.0 ** np.round(octave), dtype=torch.float32)
        width = d.attribute_width
        # A plane symbol of 16 is a latent of one (SPEC 6.9); the sine table's amplitude is 1023.
        inputs = torch.cat(
            [torch.full((2 * d.plane_channels,), 16.0 * 2**PLANE_SHIFT), torch.full((2 * d.frequency_count,), 1024.0)]
        )
        outputs = torch.cat([unit * MEAN_UNIT, torch.full((width,), SCALE_UNIT)])
        self.hyper = FoldedMlp([len(inputs), *d.hyper_width, 2 * width], inputs, outputs, generator, 0.1)
        with torch.no_grad():
            start = np.concatenate([mean / unit.numpy(), octave])
            self.hyper.biases[-1].copy_(torch.tensor(start, dtype=torch.float32))
        self.sarm = FoldedMlp(
            [4, *d.sarm_width, 2], torch.full((4,), 16.0), torch.tensor([16 * MEAN_UNIT, SCALE_UNIT]), generator, 0.1
        )
        carm = []
        shifted = unit[: d.carm_inputs] / torch.tensor(2.0 ** carm_shift.astype(np.float64), dtype=torch.float32)
        done = d.slices[0]
        for columns in d.slices[1:]:
            part = slice(done, done + columns)
            outputs = torch.cat([unit[part] * MEAN_UNIT, torch.full((columns,), SCALE_UNIT)])
            carm.append(FoldedMlp([done, *d.carm_width, 2 * columns], shifted[:done], outputs, generator, 0.0))
            done += columns
        self.carm = nn.ModuleList(carm)
        size = d.plane_size
        self.latents = nn.Parameter(torch.randn(PLANES, d.plane_channels, size, size, generator=generator) * 0.03)

    def carm_networks(self) -> list[FoldedMlp]:
        """CARM of slices 1, 2 and so on."""
        return cast(list[FoldedMlp], list(self.carm))

    def symbols(self, noise: torch.Generator | None) -> Tensor:
        """Plane symbols [5, ch, B, B]: with uniform noise in their rounding's place, or rounded (noise None)."""
        fine = self.latents * 16
        if noise is None:
            return round_through(fine)
        return fine + torch.rand(fine.shape, generator=noise) - 0.5

    def plane_bits(self, symbols: Tensor) -> Tensor:
        """Bits of all plane symbols."""
        out = self.sarm(plane_neighbours(symbols))
        return laplace_bits(out[:, 0], out[:, 1], symbols.reshape(-1)).sum()

    def attribute_bits(self, context: Tensor, symbols: Tensor, earlier: Tensor, kept: Tensor) -> Tensor:
        """Bits of the attributes of some anchors.

        context [n, 2 ch + 2 L]; symbols [n, D]; earlier [n, CARM inputs], shifted and clamped; kept float32 [n, 3 K].
        """
        d, width = self.d, self.d.attribute_width
        hyper = self.hyper(context)
        mean, scale = hyper[:, :width], hyper[:, width:]
        means, scales = [mean[:, : d.slices[0]]], [scale[:, : d.slices[0]]]
        done = d.slices[0]
        for columns, network in zip(d.slices[1:], self.carm_networks(), strict=True):
            change = network(earlier[:, :done])
            means.append(mean[:, done : done + columns] + change[:, :columns])
            scales.append(scale[:, done : done + columns] + change[:, columns:])
            done += columns
        bits = gauss_bits(
            torch.cat([*means, mean[:, done:]], dim=1), torch.cat([*scales, scale[:, done:]], dim=1), symbols
        )
        free = width - kept.shape[1]
        return bits[:, :free].sum() + (bits[:, free:] * kept).sum()

    def set_rounding(self, context: Tensor, earlier: Tensor, symbols: Tensor) -> None:
        """From now on activations are rounded and cut as in the decoder; their units are calibrated on these inputs."""
        self.hyper.calibrate(context)
        self.sarm.calibrate(plane_neighbours(symbols))
        for network, done in zip(self.carm_networks(), accumulate(self.d.slices), strict=False):
            network.calibrate(earlier[:, :done])
        self.rounding(True)

    def rounding(self, on: bool) -> None:
        """Whether activations are rounded and cut as in the decoder."""
        for network in (self.hyper, self.sarm, *self.carm_networks()):
            network.rounding = on

    def networks(self) -> dict[str, list[Layer]]:
        """F_h (with three step rows of zero weights and bias 32), SARM and CARM as SPEC 5.8 stores them."""
        *hidden, (weight, bias) = self.hyper.layers()
        weight = np.concatenate([weight, np.zeros((3, weight.shape[1]), np.float32)])
        bias = np.concatenate([bias, np.full(3, STEP_ONE, np.float32)])
        carm = {f"carm.{i}": network.layers() for i, network in enumerate(self.carm_networks(), start=1)}
        return {"hyper": [*hidden, (weight, bias)], "sarm": self.sarm.layers(), **carm}
