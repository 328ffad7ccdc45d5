"""SPEC.md B.5: weights as integers on grids."""

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..bitstream.conventions import F32
from ..bitstream.dimensions import RENDERING
from ..bitstream.networks import Layer, derive_networks
from ..bitstream.scene import Scene
from ..bitstream.tables import SCALE_MIN
from ..bitstream.weights import to_grid


def exact_networks(networks: Mapping[str, list[Layer]]) -> dict[str, list[Layer]]:
    """SPEC B.5: returns the networks with F_h, SARM and CARM on the grids of their integers.

    Their values become the integers of 7.2 divided by a power of two. The outputs of these networks do not change, nor
    do the rendering networks. Raises BoundError.
    """
    exact = dict(networks)
    for name, network in derive_networks(networks).items():
        exact[name] = [
            (
                np.ldexp(layer.weight.astype(np.float32), -layer.exponent[:, None]).astype(np.float32),
                np.ldexp(layer.bias.astype(np.float32), -layer.exponent).astype(np.float32),
            )
            for layer in network.layers
        ]
    return exact


def rendering_exponent(weight: F32, bits: int) -> int:
    """SPEC B.5: returns the largest e for which no weight, times 2^e and rounded, needs more than `bits` bits.

    The bits include the sign. If all weights are 0, the result is 0.
    """
    largest = float(np.abs(weight).max())
    return math.floor(math.log2(((1 << (bits - 1)) - 0.5) / largest)) if largest else 0


def quantise_rendering(networks: Mapping[str, list[Layer]], bits: int) -> dict[str, list[Layer]]:
    """SPEC B.5: returns the networks with each layer of the rendering networks on a grid.

    The weights and biases of a layer become multiples of the least power of two for which no weight needs more than
    `bits` bits, including the sign. bits: 2 to 24.
    """
    on_grids = dict(networks)
    for name in RENDERING:
        on_grids[name] = []
        for weight, bias in networks[name]:
            e = rendering_exponent(weight, bits)
            on_grid = [
                np.ldexp(np.rint(np.ldexp(value, e)) + np.float32(0), -e).astype(np.float32) for value in (weight, bias)
            ]
            on_grids[name].append((on_grid[0], on_grid[1]))
    return on_grids


def weight_scales(networks: Mapping[str, list[Layer]]) -> NDArray[np.uint8]:
    """SPEC B.5: returns the scale indices of each layer in mode 1, uint8 [layers, 3], 0 for a raw layer."""

    def index(scale: float) -> int:
        return min(max(round(8 * math.log2(scale)) - SCALE_MIN, 0), 255) if scale else 0

    indices = []
    for grid in (to_grid(layer) for layers in networks.values() for layer in layers):
        if grid is None:
            indices.append((0, 0, 0))
            continue
        # F_h without inputs has no weights.
        spread = math.sqrt(float(np.square(grid.weight, dtype=np.float64).mean())) if grid.weight.size else 0.0
        indices.append(
            (index(float(np.abs(grid.difference).mean())), index(spread), index(float(np.abs(grid.bias).mean())))
        )
    return np.array(indices, dtype=np.uint8)


def pack_weights(scene: Scene) -> Scene:
    """SPEC B.5: returns the scene with its weights in mode 1. No symbol changes.

    F_h, SARM and CARM get the values of exact_networks.
    """
    networks = exact_networks(scene.networks)
    return replace(scene, networks=networks, weight_scales=weight_scales(networks), weight_forms=None)
