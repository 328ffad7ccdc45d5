"""The three networks that turn anchors into Gaussians (SPEC.md 9.4, 14.3), in training."""

import math
from collections.abc import Mapping

import torch
from torch import Tensor, nn
from torch.nn import functional

from ..bitstream.dimensions import RENDER_MODELS, RENDERING, STATIC
from ..bitstream.networks import ACTIVATION_MAX, Layer
from ..bitstream.splat import OUTPUT_BITS
from ..encoder.weights import rendering_exponent
from ..rendering.gaussians import VIEW_DEPENDENT
from .rate_model.columns import Columns
from .rate_model.units import grid_through

# SPEC 11.1: units of the hidden layer in Main.
RENDER_WIDTH = 50
# SPEC B.5, "Static scenes": the largest feature and the largest value of a hidden unit, where grids begin. The rest up
# to ACTIVATION_MAX is left for later steps of training.
FULL = 0.9 * ACTIVATION_MAX
# Red, green and blue.
COLOURS = 3
# A parameter of a higher harmonic is this times its learned value: 3DGS learns them more slowly, too.
HIGHER = 0.3
# The first biases of a static scene: opacities of a tenth, axes of half the length of their scaling.
OPACITY_START, LENGTH_START = math.log(0.1 / 0.9), math.log(0.5)


class RenderNetworks(nn.Module):
    """The rendering networks, with one hidden layer each, as torch starts linear layers.

    degree: of the harmonics of a static scene, None for a view-dependent scene. It can be lowered: the outputs of
    higher harmonics are then not used. The networks of a static scene have integers in the file (SPEC 9.4). The buffers
    *_unit are the integers that stand for 1: of a feature, each hidden unit and an output. In a view-dependent scene
    they are 1.
    """

    width: int
    degree: int | None
    view_inputs: int
    gridded: bool

    def __init__(
        self, columns: Columns, generator: torch.Generator, width: int = RENDER_WIDTH, degree: int | None = None
    ) -> None:
        """columns: of the attributes. width: of the hidden layers."""
        super().__init__()
        self.width, self.degree = width, degree
        # SPEC 6.5
        self.render_model = VIEW_DEPENDENT if degree is None else STATIC
        self.view_inputs, _ = RENDER_MODELS[self.render_model]
        self._harmonics = self.colour_outputs // COLOURS
        inputs = columns.features + self.view_inputs
        for name, outputs in zip(RENDERING, (1, 7, self.colour_outputs), strict=True):
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
            self.register_buffer(f"{name}_unit", torch.ones(width))
        self.register_buffer("feature_unit", torch.ones(()))
        self.register_buffer("output_unit", torch.tensor(1.0 if degree is None else 2.0**OUTPUT_BITS))
        self.gridded = False
        if degree is not None:
            self._start_static()

    @torch.no_grad()
    def _start_static(self) -> None:
        """First biases of a static scene, whose colours do not depend on the direction at first."""
        p = dict(self.named_parameters())
        p["opacity_1_bias"].add_(OPACITY_START)
        p["covariance_1_bias"].view(-1, 7)[:, :3].add_(LENGTH_START)
        for kind in ("weight", "bias"):
            self._by_harmonic(p[f"colour_1_{kind}"])[:, 1:] = 0

    @property
    def colour_outputs(self) -> int:
        """SPEC 5.3"""
        return RENDER_MODELS[self.render_model][1][self.degree or 0]

    def _by_harmonic(self, value: Tensor) -> Tensor:
        """A parameter of the last layer of the colour network, as [K, harmonics, COLOURS, ...]."""
        return value.view(-1, self._harmonics, COLOURS, *value.shape[1:])

    def _used(self) -> dict[str, Tensor]:
        """The parameters as forward has them, without those of harmonics that are not used."""
        p: dict[str, Tensor] = dict(self.named_parameters())
        for name in ("colour_1_weight", "colour_1_bias"):
            used = self._by_harmonic(p[name])[:, : self.colour_outputs // COLOURS]
            if self.degree:
                used = torch.cat([used[:, :1], HIGHER * used[:, 1:]], dim=1)
            p[name] = used.reshape(-1, *p[name].shape[1:])
        return p

    def parameters_of(self, network: str) -> list[nn.Parameter]:
        """Weights and biases of one of the three networks."""
        return [value for name, value in self.named_parameters() if name.startswith(network)]

    def _units(self, name: str) -> Tensor:
        """The factor from a parameter to its value in the file, which broadcasts."""
        layer, _, kind = name.rpartition("_")
        network, _, number = layer.rpartition("_")
        feature, hidden, output = map(self.get_buffer, ("feature_unit", f"{network}_unit", "output_unit"))
        if number == "0":
            return hidden[:, None] / feature if kind == "weight" else hidden
        return output / hidden if kind == "weight" else output

    def _steps(self, name: str) -> Tensor:
        """The steps of the grid of a parameter, in the units of the file."""
        return self.get_buffer(f"{name.rpartition('_')[0]}_step")

    def _values(self) -> dict[str, Tensor]:
        """The parameters, each layer's on its grid if there is one."""
        p = self._used()
        if not self.gridded:
            return p
        return {name: grid_through(value, self._steps(name) / self._units(name)) for name, value in p.items()}

    @torch.no_grad()
    def set_units(self, features: Tensor) -> None:
        """SPEC B.5: sets the units of features and of hidden units of a static scene. features: all, [N, F]."""
        self.get_buffer("feature_unit").fill_(FULL / max(float(features.abs().max()), 1e-6))
        for name, hidden in zip(RENDERING, self._hidden(features, self._used()), strict=True):
            # A unit that is hardly used needs no precision, and its first weights must not exceed WEIGHT_MAX.
            self.get_buffer(f"{name}_unit").copy_(FULL / hidden.amax(dim=0).clamp_min(FULL / 2**OUTPUT_BITS))

    @torch.no_grad()
    def set_grid(self, bits: int) -> None:
        """Makes weights and biases of each layer multiples of a power of two in the file (rendering_exponent)."""
        for name, value in self._used().items():
            if name.endswith("_weight"):
                exponent = rendering_exponent((value * self._units(name)).cpu().numpy(), bits)
                self._steps(name).fill_(2.0**-exponent)
        self.gridded = True

    def _hidden(self, inputs: Tensor, p: Mapping[str, Tensor]) -> tuple[Tensor, ...]:
        """The hidden units of each network [n, width]."""
        weight, bias = (torch.cat([p[f"{name}_0_{kind}"] for name in RENDERING]) for kind in ("weight", "bias"))
        return functional.relu(functional.linear(inputs, weight, bias)).split(self.width, dim=1)

    def forward(self, inputs: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Opacities before masks [n, K], covariance [n, 7 K], colour [n, colour_outputs K].

        inputs: float32 [n, F + view_inputs].
        """
        p = self._values()
        opacity, covariance, colour = (
            functional.linear(h, p[f"{name}_1_weight"], p[f"{name}_1_bias"])
            for h, name in zip(self._hidden(inputs, p), RENDERING, strict=True)
        )
        return torch.tanh(opacity) if self.degree is None else torch.sigmoid(opacity), covariance, colour

    @torch.no_grad()
    def take(self, networks: Mapping[str, list[Layer]], unit: float) -> None:
        """Takes the weights of a view-dependent scene. unit: the factor of the distance before the network."""
        p = dict(self.named_parameters())
        for name in RENDERING:
            for i, (weight, bias) in enumerate(networks[name]):
                p[f"{name}_{i}_weight"].copy_(torch.from_numpy(weight))
                p[f"{name}_{i}_bias"].copy_(torch.from_numpy(bias))
            p[f"{name}_0_weight"][:, -1] *= unit

    @torch.no_grad()
    def layers(self) -> dict[str, list[Layer]]:
        """The weights that SPEC 5.8 stores."""
        p = {}
        for name, value in self._used().items():
            stored = value * self._units(name)
            if self.gridded:
                stored = torch.floor(stored / self._steps(name) + 0.5) * self._steps(name) + 0.0
            p[name] = stored.cpu().numpy().copy()
        return {name: [(p[f"{name}_{i}_weight"], p[f"{name}_{i}_bias"]) for i in range(2)] for name in RENDERING}
