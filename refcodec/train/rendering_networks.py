"""The three networks that turn anchors into Gaussians (SPEC.md 14.3), in training."""

from __future__ import annotations

import math
from collections.abc import Mapping

import torch
from torch import Tensor, nn
from torch.nn import functional

from ..bitstream.dimensions import RENDERING
from ..bitstream.networks import Layer
from ..encoder.weights import rendering_exponent
from .rate_model.columns import Columns
from .rate_model.units import grid_through

# SPEC 11.1: units of the hidden layer in Main.
RENDER_WIDTH = 50
# Beside an anchor's features: the direction and the distance from the camera.
VIEW_INPUTS = 4


class RenderNetworks(nn.Module):
    """SPEC 14.3's networks, with one hidden layer each, as torch starts linear layers."""

    def __init__(self, columns: Columns, generator: torch.Generator, width: int = RENDER_WIDTH) -> None:
        """columns: of the attributes. width: of the hidden layers."""
        super().__init__()
        self.width = width
        inputs = columns.features + VIEW_INPUTS
        for name, outputs in zip(RENDERING, (1, 7, 3), strict=True):
            shapes = ((inputs, width), (width, outputs * columns.offsets))
            for layer, (fan_in, out) in enumerate(shapes):
                bound = 1 / math.sqrt(fan_in)
                weight, bias = (
                    nn.Parameter((torch.rand(shape, generator=generator) * 2 - 1) * bound)
                    for shape in ((out, fan_in), (out,))
                )
                self.register_parameter(f"{name}_{layer}_weight", weight)
                self.register_parameter(f"{name}_{layer}_bias", bias)
                self.register_buffer(f"{name}_{layer}_step", torch.ones(()))
        self.gridded = False

    def parameters_of(self, network: str) -> list[nn.Parameter]:
        """Weights and biases of one of the three networks."""
        return [value for name, value in self.named_parameters() if name.startswith(network)]

    def _values(self) -> dict[str, Tensor]:
        """The parameters, each layer's on its grid if there is one."""
        p: dict[str, Tensor] = dict(self.named_parameters())
        if not self.gridded:
            return p
        return {
            name: grid_through(value, self.get_buffer(f"{name.rpartition('_')[0]}_step")) for name, value in p.items()
        }

    @torch.no_grad()
    def set_grid(self, bits: int) -> None:
        """Makes weights and biases of each layer multiples of a power of two (weights.rendering_exponent)."""
        for name, value in self.named_parameters():
            layer, _, kind = name.rpartition("_")
            if kind == "weight":
                self.get_buffer(f"{layer}_step").fill_(2.0 ** -rendering_exponent(value.cpu().numpy(), bits))
        self.gridded = True

    def forward(self, inputs: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Opacities before masks [n, K], covariance [n, 7 K], colour before its logistic function [n, 3 K].

        inputs: float32 [n, F + 4].
        """
        p = self._values()
        weight, bias = (torch.cat([p[f"{name}_0_{kind}"] for name in RENDERING]) for kind in ("weight", "bias"))
        hidden = functional.relu(functional.linear(inputs, weight, bias)).split(self.width, dim=1)
        opacity, covariance, colour = (
            functional.linear(h, p[f"{name}_1_weight"], p[f"{name}_1_bias"])
            for h, name in zip(hidden, RENDERING, strict=True)
        )
        return torch.tanh(opacity), covariance, colour

    @torch.no_grad()
    def take(self, networks: Mapping[str, list[Layer]], unit: float) -> None:
        """Takes the weights of a scene. unit: the factor of the distance before the network."""
        p = dict(self.named_parameters())
        for name in RENDERING:
            for i, (weight, bias) in enumerate(networks[name]):
                p[f"{name}_{i}_weight"].copy_(torch.from_numpy(weight))
                p[f"{name}_{i}_bias"].copy_(torch.from_numpy(bias))
            p[f"{name}_0_weight"][:, -1] *= unit

    def layers(self) -> dict[str, list[Layer]]:
        """The weights that SPEC 5.8 stores."""
        p = {name: value.detach().cpu().numpy().copy() for name, value in self._values().items()}
        return {name: [(p[f"{name}_{i}_weight"], p[f"{name}_{i}_bias"]) for i in range(2)] for name in RENDERING}
