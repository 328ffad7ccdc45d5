"""Networks of valid scenes, and weights of given values. Every float is an integer times a power of two."""

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from refcodec.bitstream.dimensions import Dimensions
from refcodec.bitstream.networks import Layer
from refcodec.bitstream.scene import Scene
from refcodec.bitstream.weights import to_grid

from .numbers import Int64, Numbers

Networks = dict[str, list[Layer]]


def dyadic(integers: Int64, bits: int) -> NDArray[np.float32]:
    """Returns integers divided by 2^bits, exact in f32."""
    return np.ldexp(integers.astype(np.float32), -bits).astype(np.float32)


def networks(d: Dimensions, numbers: Numbers) -> Networks:
    """Returns networks with outputs in useful ranges."""
    network_weights: Networks = {}
    for name, shapes in d.network_shapes().items():
        network_weights[name] = []
        for index, (out, fan_in) in enumerate(shapes):
            last = index == len(shapes) - 1
            weight = dyadic(numbers.integers(-200, 200, out, fan_in), 12 if last else 8)
            bias = dyadic(numbers.integers(-640, 640, out), 5)
            if last and name == "hyper":
                bias[-3:] += 32
            network_weights[name].append((weight, bias))
    return network_weights


# Values of weights: a layer ("hyper.0", "hyper.-1" for the last one, "*.0" for the first of each network) or all layers
# ("hyper", "*"), rows or another index, and what the weights and the biases there are: values, a function of the old
# ones, or None for no change.
Values = tuple[str, Any, Any, Any]
ALL = slice(None)


def set_weights(network_weights: Networks, *values: Values) -> Networks:
    """Changes weights and biases, and returns the networks."""
    for path, rows, weight, bias in values:
        network, _, number = (path, "", "") if path in (*network_weights, "*") else path.rpartition(".")
        for layers in network_weights.values() if network == "*" else [network_weights[network]]:
            for w, b in [layers[int(number)]] if number else layers:
                for array, value in ((w, weight), (b, bias)):
                    if value is not None:
                        array[rows] = value(array[rows]) if callable(value) else value
    return network_weights


def with_weights(made: Scene, *values: Values) -> Scene:
    """Returns the scene with changed weights and biases, in mode 0 as long as they are not packed again."""
    set_weights(made.networks, *values)
    return made


# SARM predicts zeros, and a symbol of 0 takes almost no bits.
QUIET_SARM: tuple[Values, ...] = (("sarm", ALL, 0, 0), ("sarm.-1", 1, None, -40))
# The steps are the base steps.
BASE_STEPS: Values = ("hyper.-1", slice(-3, None), 0, 32)


def constant(d: Dimensions, numbers: Numbers, mean: Int64 | int = 0, scale: Int64 | int = -40) -> Networks:
    """Returns networks whose F_h gives the same for every anchor, and whose CARM gives zeros.

    mean: int64 [channels], in sixteenths of a symbol. scale: int64 [channels], scale indices. A number is that of all
    channels. By default a symbol of 0 takes almost no bits.
    """
    network_weights, width = networks(d, numbers), d.attribute_width
    still = [(name, ALL, 0, 0) for name in network_weights if name == "hyper" or name.startswith("carm")]
    outputs = (*np.broadcast_to(mean, width), *np.broadcast_to(scale, width), 32, 32, 32)
    return set_weights(network_weights, *still, ("hyper.-1", ALL, None, outputs))


def observing(d: Dimensions, numbers: Numbers, scale: int = -8) -> Networks:
    """Returns networks that output the context, so that a context that is wrong by one gives another model.

    The mean of channel c is the context's number c modulo their count, in sixteenths. The hidden layer of F_h has two
    units for each number, one for either sign. scale: the scale index of all channels.
    """
    network_weights = networks(d, numbers)
    inputs, total = 2 * d.plane_channels + 2 * d.frequency_count, d.attribute_width
    assert d.hyper_width == (2 * inputs,)
    first: Int64 = np.concatenate([np.eye(inputs, dtype=np.int64), -np.eye(inputs, dtype=np.int64)])
    last = np.zeros((2 * total + 3, 2 * inputs), np.int64)
    bias = np.zeros(2 * total + 3, np.int64)
    for c in range(total):
        last[c, [c % inputs, inputs + c % inputs]] = 1, -1
    bias[total : 2 * total], bias[2 * total :] = scale, 32
    network_weights["hyper"] = [
        (dyadic(first, 0), dyadic(np.zeros(2 * inputs, np.int64), 0)),
        (dyadic(last, 0), dyadic(bias, 0)),
    ]
    return set_weights(network_weights, *((name, ALL, 0, 0) for name in network_weights if name.startswith("carm")))


# --- weights in mode 1 ------------------------------------------------------------------------------------------------


def scales(network_weights: Networks) -> NDArray[np.uint8]:
    """Returns scale indices of mode 1 by the bit lengths of the weights, uint8 [layers, 3], 0 for a raw layer."""
    rows = []
    for grid in (to_grid(layer) for layers in network_weights.values() for layer in layers):
        parts = [] if grid is None else [grid.difference, grid.weight, grid.bias]
        rows.append(
            [min(40 + 8 * (int(np.abs(p).max()).bit_length() - 1), 255) if p.any() else 0 for p in parts] or [0, 0, 0]
        )
    return np.array(rows, dtype=np.uint8)


def packed_weights(made: Scene) -> Scene:
    """Returns the scene with its weights in mode 1, unchanged."""
    return replace(made, weight_scales=scales(made.networks))


def sparse(made: Scene, one_in: int = 16) -> Scene:
    """Returns the scene with few nonzero weights, in mode 1: large networks in few bytes."""
    numbers = Numbers("sparse")
    kept = {
        name: [
            (np.where(numbers.integers(0, one_in - 1, *w.shape) == 0, w, 0).astype(np.float32), b) for w, b in layers
        ]
        for name, layers in made.networks.items()
    }
    return packed_weights(replace(made, networks=kept))
