"""Networks whose weights are trained for their own code length too.

The weights and the biases of a layer are each multiples of one step, which is trained. They are coded as those of a
file are (SPEC 7.13), weights under a Gaussian and biases under a Laplace distribution around 0, whose scale a layer
states. The estimate adds what a layer and a row of a file have besides: SPEC 5.9's model, and a row's exponent.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.nn import functional

from refcodec.train.rate_model.bits import gauss_bits, laplace_bits
from refcodec.train.rate_model.units import SCALE_UNIT, round_through

# Bits of a layer's model, and of a row's exponent: about what files of the trainer spend.
MODEL_BITS, ROW_BITS = 48, 3
# Base-2 logarithm of the first steps.
STEP_START = -6.0


def value_bits(values: Tensor, laplace: bool) -> Tensor:
    """Bits of values, in steps, under a distribution around 0 of the scale that fits them best."""
    if not values.numel():
        return values.sum()
    # A part of a step keeps the gradient of layers that are all zeros.
    least = 1 / 64
    spread = values.abs().mean() if laplace else ((values * values).mean() + least * least).sqrt()
    scale = (torch.log2(spread.clamp_min(1 / 16)) * SCALE_UNIT).expand_as(values)
    return (laplace_bits if laplace else gauss_bits)(torch.zeros_like(values), scale, values).sum()


class Network(nn.Module):
    """An MLP with rectifiers. prepare sets the weights that calls use from then on, and returns their bits."""

    def __init__(
        self,
        widths: list[int],
        generator: torch.Generator,
        gain: float,
        masks: list[Tensor] | None = None,
        laplace: bool = False,
    ) -> None:
        """widths: inputs, hidden widths, outputs. gain: spread of the last layer's weights, times the root of inputs.

        masks: bool [out, in] of each layer, of the weights that there are; None for all. laplace: whether the weights
        are coded under a Laplace distribution, which no file can do.
        """
        super().__init__()
        self.weights, self.biases = nn.ParameterList(), nn.ParameterList()
        for i, (fan_in, out) in enumerate(pairwise(widths)):
            last = i == len(widths) - 2
            spread = (gain if last else math.sqrt(2)) / math.sqrt(max(fan_in, 1))
            self.weights.append(nn.Parameter(torch.randn(out, fan_in, generator=generator) * spread))
            self.biases.append(nn.Parameter(torch.zeros(out) if last else torch.rand(out, generator=generator) * 0.2))
        # Of the weights and of the biases of each layer.
        self.steps = nn.Parameter(torch.full((len(widths) - 1, 2), STEP_START))
        self.masks, self.laplace = masks, laplace
        self.used: list[tuple[Tensor, Tensor]] = []
        self.prepare("float", generator)

    def counted(self) -> int:
        """How many weights and biases there are."""
        kept = self.masks or [torch.ones_like(w, dtype=torch.bool) for w in self.weights]
        return int(sum(k.sum() for k in kept)) + sum(b.numel() for b in self.biases)

    def prepare(self, mode: str, generator: torch.Generator) -> Tensor:
        """Sets the weights that are used. mode: float, noise (in place of rounding) or round. Returns their bits."""
        total, self.used = torch.zeros(()), []
        for i, pair in enumerate(zip(self.weights, self.biases, strict=True)):
            found = []
            for j, value in enumerate(pair):
                here = value if j or self.masks is None else value * self.masks[i]
                if mode != "float":
                    step = torch.exp2(self.steps[i, j])
                    units = here / step
                    if mode == "noise":
                        units = units + torch.rand(units.shape, generator=generator) - 0.5
                    else:
                        units = round_through(units)
                    if not j and self.masks is not None:
                        units = units * self.masks[i]
                        there = units[self.masks[i]]
                    else:
                        there = units
                    total = total + value_bits(there.reshape(-1), bool(j) or self.laplace)
                    here = units * step
                found.append(here)
            self.used.append((found[0], found[1]))
        return total + MODEL_BITS * len(self.used) + ROW_BITS * sum(len(b) for b in self.biases)

    def forward(self, inputs: Tensor) -> Tensor:
        """inputs: float32 [n, in]. Returns float32 [n, out]."""
        x = inputs
        for i, (weight, bias) in enumerate(self.used):
            x = functional.linear(x, weight, bias)
            if i < len(self.used) - 1:
                x = functional.relu(x)
        return x


@torch.no_grad()
def choose_steps(networks: Iterable[Network], bits_of: object, generator: torch.Generator) -> None:
    """Sets the steps of networks that were trained without them: layer by layer, those of the fewest bits in all.

    bits_of: a call without arguments that returns the bits of what the networks code.
    """
    assert callable(bits_of)
    for network in networks:
        for i in range(len(network.weights)):
            best = None
            for log_step in range(-9, -1):
                network.steps[i] = float(log_step)
                total = float(network.prepare("round", generator)) + float(bits_of())
                if best is None or total < best[0]:
                    best = (total, log_step)
            assert best is not None
            network.steps[i] = float(best[1])
            network.prepare("round", generator)
