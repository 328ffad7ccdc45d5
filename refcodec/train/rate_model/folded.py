"""A network on integer activations, trained in float32, and its export to the weights of SPEC.md 5.8.

Inputs and outputs are those of SPEC 7: integers in [-1023, 1023] in, means in 1/16 symbol and scale indices in 1/8
octave out. Between them the parameters are of order one. Every factor between the two is a power of two, so that
folding it into a stored weight is exact.
"""

import math
from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.nn import functional

from ...bitstream.networks import ACCUMULATOR_BOUND, ACTIVATION_MAX, WEIGHT_MAX, Layer, derive_layer
from ..cpu.layers import FoldedLayer, Plan
from ..device import has_kernel
from ..settings import EntropySettings
from .units import grid_through, round_through

# A row's share of SPEC 7.2's bounds at which it is cut: rounding to a coarse grid may add to it.
FULL = 0.9


class FoldedMlp(nn.Module):
    """An MLP on integer activations (SPEC 7.2), trained in parameters of order one.

    The buffers hidden_unit_* hold the integers that stand for one at each hidden activation; calibrate sets them. The
    buffers step_* hold the step of each row's weights and bias in the file, if they are multiples of one; set_grid sets
    them.
    """

    weights: torch.nn.ParameterList
    biases: torch.nn.ParameterList
    hidden: int
    gridded: bool

    def __init__(
        self,
        widths: list[int],
        input_unit: Tensor,
        output_unit: Tensor,
        generator: torch.Generator,
        gain: float = EntropySettings.gain,
        bias: float = EntropySettings.bias,
    ) -> None:
        """widths: inputs, hidden widths, outputs.

        input_unit, output_unit: float32 [in] and [out], powers of two, the integers that stand for one at the inputs
        and outputs. gain, bias: see EntropySettings.
        """
        super().__init__()
        self.weights, self.biases = nn.ParameterList(), nn.ParameterList()
        for i, (fan_in, out) in enumerate(pairwise(widths)):
            last = i == len(widths) - 2
            spread = (gain if last else math.sqrt(2)) / math.sqrt(max(fan_in, 1))
            self.weights.append(nn.Parameter(torch.randn(out, fan_in, generator=generator) * spread))
            self.biases.append(nn.Parameter(torch.zeros(out) if last else torch.rand(out, generator=generator) * bias))
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
        return self._run(self.hidden, hidden, columns)

    def activations(self, inputs: Tensor) -> Tensor:
        """The last hidden activations, in the units of the file."""
        x = inputs
        for i in range(self.hidden):
            x = self._run(i, x, slice(None))
        return x

    def _run(self, layer: int, x: Tensor, rows: slice) -> Tensor:
        if not has_kernel(x):
            return self.run_torch(layer, x, rows)
        values = self.weights[layer], self.biases[layer]
        weight, bias = values if rows == slice(None) else (v[rows] for v in values)
        outputs: Tensor = FoldedLayer.apply(self.plan(layer, rows), x, weight, bias)
        return outputs

    def pairs(self) -> list[Tensor]:
        """Weights and biases of each layer, alternating."""
        return [p for pair in zip(self.weights, self.biases, strict=True) for p in pair]

    def plan(self, layer: int, rows: slice = slice(None)) -> Plan:
        """The properties of some rows of a layer besides their weights, for passes on CPUs."""
        before, after = self._ends(layer)
        step = self.get_buffer(f"step_{layer}")
        arrays = before.numpy(), after[rows].numpy(), step[rows].numpy()
        return Plan(*arrays, self.gridded, layer < self.hidden, self.rounding)

    def run_torch(self, layer: int, x: Tensor, rows: slice) -> Tensor:
        """The outputs of some rows of a layer, with torch on the device of the tensors."""
        x = functional.linear(x, *self._layer(layer, rows))
        if layer < self.hidden:
            x = functional.relu(x)
            if self.rounding:
                x = round_through(x.clamp_max(ACTIVATION_MAX))
        return x

    @torch.no_grad()
    def calibrate(self, inputs: Tensor) -> None:
        """Sets the unit of each hidden activation, from inputs like those of the file.

        It is the largest power of two that keeps the activation within 1023 for these inputs, and its row of weights
        within half of SPEC 7.2's bounds.
        """
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

    def _ends(self, layer: int) -> tuple[Tensor, Tensor]:
        """The integers that stand for one at a layer's inputs [in] and outputs [out]: powers of two."""
        before = self.get_buffer(f"hidden_unit_{layer - 1}" if layer else "input_unit")
        return before, self.get_buffer(f"hidden_unit_{layer}" if layer < self.hidden else "output_unit")

    def _layer(self, layer: int, rows: slice) -> tuple[Tensor, Tensor]:
        """Some rows of a layer's weights and biases in the units of the file, on their grid if there is one."""
        before, after = self._ends(layer)
        after = after[rows]
        weight = self.weights[layer][rows] * (after[:, None] / before)
        bias = self.biases[layer][rows] * after
        if not self.gridded:
            return weight, bias
        step = self.get_buffer(f"step_{layer}")[rows]
        return grid_through(weight, step[:, None]), grid_through(bias, step)

    @torch.no_grad()
    def set_grid(self, coarser: int) -> None:
        """Makes each row's weights and bias multiples of 2^coarser steps of its integers from now on (SPEC 7.2)."""
        self.gridded = False
        for i, (weight, bias) in enumerate(self.layers()):
            exponent = torch.from_numpy(coarser - derive_layer(weight, bias).exponent)
            self.get_buffer(f"step_{i}").copy_(torch.exp2(exponent.float()))
        self.gridded = True

    @torch.no_grad()
    def layers(self) -> list[Layer]:
        """The weights that SPEC 5.8 stores: float32 (weight [out, in], bias [out]) of each layer.

        Rows that reach SPEC 7.2's bounds, as extreme symbols make them, are first cut to half of these: other weights
        cost bits, but a training would be lost.
        """
        layers = []
        for i, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            before, after = self._ends(i)
            row, own = (weight / before).abs() * after[:, None], bias.abs() * after
            largest = torch.cat([row, torch.zeros_like(own)[:, None]], dim=1).amax(dim=1)
            share = torch.maximum(largest / WEIGHT_MAX, (row.sum(dim=1) * ACTIVATION_MAX + own) / ACCUMULATOR_BOUND)
            if bool((share > FULL).any()):
                cut = torch.where(share > FULL, 2 * share, 1)
                weight.div_(cut[:, None])
                bias.div_(cut)
        for i in range(self.hidden + 1):
            weight, bias = (value.cpu().numpy() for value in self._layer(i, slice(None)))
            layers.append((weight, bias))
        return layers
