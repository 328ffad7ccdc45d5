"""Cases of clause 9.4: static scenes, of which the plain Gaussians are decoded."""

from dataclasses import replace
from functools import cache, partial
from typing import Any

import numpy as np

from refcodec.bitstream import codec
from refcodec.bitstream.conventions import round_to_f32
from refcodec.bitstream.dimensions import RENDER_MODELS, RENDERING, STATIC
from refcodec.bitstream.header import PositionGrid, RenderInfo
from refcodec.bitstream.scene import Scene
from refcodec.bitstream.splat import SCALING_BOUND, exponential

from . import limits, networks
from .numbers import Numbers
from .scenes import SMALLEST, TINY_DIMENSIONS, drawn_symbols, f16, lattice, scene, with_symbols
from .table import NAME, More, label_of, refused, valid
from .target import Target
from .targets import target_of
from .weights import ALL, BASE_STEPS, dyadic, packed_weights, with_weights

DEGREES = RENDER_MODELS[STATIC][1]
RENDER = RenderInfo(render_model=STATIC)


def ordinary(name: str, anchors: int = 9, outputs: int = 12, offsets: int = TINY_DIMENSIONS.offset_count) -> Scene:
    """Returns a scene of ordinary sizes: features fill the range of activations, outputs are below 16."""
    numbers, d = Numbers(name), replace(TINY_DIMENSIONS, view_inputs=0, colour_outputs=outputs, offset_count=offsets)
    where, grid = lattice(numbers, anchors), PositionGrid((0, 0, 0), 1, 0)
    made = scene(name, anchors, d, positions=where, base_step=(16.0, 0.0625, 0.25), grid=grid, render=RENDER)
    with_weights(made, BASE_STEPS)
    for layers in (made.networks[network] for network in RENDERING):
        for (weight, bias), bits in zip(layers, (7, 4), strict=True):
            weight[:] = dyadic(numbers.integers(-99, 99, *weight.shape), bits)
            bias[:] = dyadic(numbers.integers(-9999, 9999, len(bias)), bits)
    return drawn_symbols(made, partial(numbers.integers, -60, 60))


@cache
def of_degree(degree: int) -> bytes:
    """Returns a static file with harmonics of a degree."""
    return codec.emit(ordinary(f"static-degree-{degree}", 9, DEGREES[degree]))


@cache
def target() -> Target:
    """Returns a static file of degree 1 in mode 0."""
    return Target(of_degree(1))


def _packed() -> Scene:
    # A bias of -0 cannot be packed.
    return packed_weights(with_weights(ordinary("static-packed"), ("colour.0", 0, None, -0.0)))


def _of_steps(name: str, step: float) -> Scene:
    made, largest = replace(ordinary(name, 12, 3), base_step=(step,) * 3), (1 << 23) - 1
    with_weights(made, ("hyper.-1", slice(-3, None), None, 63 if step > 1 else 0))
    values = [0, 1, -1, 3, -77, largest, -largest]
    return drawn_symbols(made, partial(Numbers(f"{name}/symbols").chosen, values))


def _turned() -> Scene:
    turned = ("covariance.-1", slice(3, 7), 0, 0), ("covariance.-1", slice(10, 14), 0, (0, 0, -1, 0))
    made = with_weights(ordinary("static-turned"), *turned)
    return replace(made, masks=np.ones_like(made.masks))


def _one_of_four() -> Scene:
    """Offset k has a quaternion whose number k alone is not 0."""
    made = ordinary("static-one-of-four", 5, offsets=4)
    weight, bias = made.networks["covariance"][-1]
    for k in range(4):
        weight[7 * k + 3 : 7 * k + 7], bias[7 * k + 3 : 7 * k + 7] = 0, np.eye(4)[k] * (k - 1.5)
    return replace(made, masks=np.ones_like(made.masks))


def _long_outputs() -> Scene:
    """Outputs of all three networks have up to 24 bits, of either sign."""
    made = ordinary("static-long-outputs", 3)
    for network in RENDERING:
        weight, bias = made.networks[network][-1]
        weight[:], bias[:] = 0, np.resize([(1 << 24) - 1, 1 - (1 << 24), (1 << 23) + 5, -(1 << 16)], len(bias))
    return replace(made, masks=np.ones_like(made.masks))


def _cancelled(name: str, exponent: int, signs: int) -> Scene:
    """Positions are 2^(exponent - 24), offsets -1 and their neighbours. exp(0) is 1. signs: of every second anchor."""
    near, grid = [-1, -1, 1, -(1 << 22), (1 << 23) - 1, -((1 << 23) - 1), 3, -3], PositionGrid((0, 0, 0), 1, exponent)
    sign = np.resize([1, signs], (len(near), 1))
    d, where = replace(SMALLEST, view_inputs=0, colour_outputs=3), f16(np.tile(sign, 3))
    fields: dict[str, Any] = {"masks": np.ones((len(near), 1), bool), "base_step": (1.0, 1.0, 1.0), "render": RENDER}
    made = scene(name, len(near), d, positions=where, grid=grid, **fields)
    with_weights(made, BASE_STEPS, *((network, ALL, 0, 1) for network in RENDERING))
    offsets = np.array([[[x, x - 1, -x]] for x in near]) * sign[:, None]
    scalings = np.zeros((len(near), 6), np.int64)
    # 2^-24 of 1, where sums are ties.
    scalings[2:, :3] = np.array([-17, -17, -8, -8, -17, -17])[:, None]
    return with_symbols(made, scalings=scalings, offsets=np.clip(offsets, 1 - (1 << 23), (1 << 23) - 1))


def _with_lengths(name: str, anchors: int) -> Scene:
    """Returns a scene that keeps all offsets. A step of scalings is 2^-16."""
    made = ordinary(name, anchors)
    return replace(made, masks=np.ones_like(made.masks), base_step=(0.5, 2.0**-16, 0.25))


def _zero_lengths() -> Scene:
    """Logarithms of lengths are -2^-12 + 2^-12 and 2^-12 - 2^-12."""
    made = replace(_cancelled("static-zero-lengths", 24, 1), base_step=(1.0, 2.0**-12, 1.0))
    with_weights(made, ("covariance.1", 1, 0, -1))
    return with_symbols(made, scalings=np.tile([0, 0, 0, -1, 1, -1], (len(made.positions), 1)))


def _halves() -> Scene:
    made = _with_lengths("static-scaling-ties", 12)
    return replace(made, base_step=(0.5, 2.0**-17, 0.25))


def _lengths() -> Scene:
    made = _with_lengths("static-lengths", 61)
    # Exponentials that are rounded to another f32 if they are changed by 1.
    t = np.arange(1 - SCALING_BOUND, SCALING_BOUND, 991)
    m, _ = exponential(t)
    right, less, more = (round_to_f32(m + change, 0) for change in (0, -1, 1))
    near = t[(right != less) | (right != more)]
    chosen = near[np.linspace(0, len(near) - 1, 61 * 3).astype(np.int64)].reshape(61, 3)
    scalings = np.concatenate([chosen, -chosen], axis=1)
    offsets = np.broadcast_to(np.array([4, -1, 16]), made.attributes.offsets.shape)
    return with_symbols(made, scalings=scalings, offsets=offsets)


def _long() -> Scene:
    """The covariance network gives lengths of 24 bits, which have 28 in the unit of scalings."""
    numbers, made = Numbers("static-long/symbols"), _with_lengths("static-long", 8)
    weight, bias = made.networks["covariance"][-1]
    largest = np.array([(1 << 24) - 1, 1 - (1 << 24), (1 << 23) + 5])
    for k in range(made.dimensions.offset_count):
        weight[7 * k : 7 * k + 3] = 0
        bias[7 * k : 7 * k + 3] = np.roll(largest, k) // (1 + k % 2)
    ends = [SCALING_BOUND, SCALING_BOUND - 1, 1 - SCALING_BOUND, -SCALING_BOUND]
    scalings = numbers.integers(-99, 99, *made.attributes.scalings.shape)
    # Halves of the unit of the last place of sums from 2^27 and from 2^28 on.
    scalings[:4, 3:] = np.array([8, -8, 24, 16])[:, None]
    scalings[4:, 3:] = np.array(ends)[:, None]
    return with_symbols(made, scalings=scalings)


# fmt: off
CASES = [
    *valid("static reconstruction", "static-part harmonics", "D9.4-1 D9.3-1 R11.1-2", *(
        (f"static-degree-{degree}", f"a static scene with harmonics of degree {degree}", of_degree, degree)
        for degree in range(len(DEGREES)))),
    *valid("static reconstruction", "static-part value-rounding", "D9.4-1 D9.3-1 R11.1-2",
        ("static-packed", "a static scene in mode 1, one layer raw", _packed),
        ("static-empty", "a static scene without anchors", ordinary, "static-empty", 0),
        ("static-far", "features, scalings and offsets beyond what 9.4 limits", _of_steps, "static-far", 2.0**60),
        ("static-near", "the least features, scalings and offsets", _of_steps, "static-near", 2.0**-60),
        ("static-turned", "quaternions of zeros, and one with a single number", _turned),
        ("static-one-of-four", "quaternions with a single number, each of the four", _one_of_four),
        ("static-long-outputs", "outputs of 24 bits, of either sign", _long_outputs),
        ("static-cancelled", "means halfway between two f32, or that lose all but their last bits", _cancelled, NAME, 0,
         1),
        ("static-mean-zero", "means that are 0, from positions of either sign", _cancelled, NAME, 24, -1),
        ("static-zero-lengths", "logarithms of lengths that are 0, of parts with either sign", _zero_lengths),
        ("static-scaling-ties", "scalings halfway between two units of 2^-16", _halves),
        ("static-lengths", "scalings over the whole range of the exponential, and features with halves", _lengths),
        ("static-long", "logarithms of lengths with up to 29 bits, some halfway between two f32", _long)),
    *refused("static dimensions", "limit-off-by-one", *(
        (f"static-{label_of(field)}-{value}", f"{field} {value} in a static scene", target, limits.dimension, field,
         value)
        for field, values in (("view_inputs", (1, 4)), ("colour_outputs", (1, 9, 13, 47))) for value in values)),
    *refused("static networks", "accumulator-bound row-order",
        *((f"static-bound-{label_of(layer)}", f"a weight of {layer} that leaves no exponent, in a static scene", target,
           networks.large_value, layer, 0, 0, 4096.0) for layer in ("opacity.0", "colour.1")),
        ("static-bound-packed", "a packed layer whose rows have no exponent, in a static scene", target_of(_packed),
         networks.large_integer, "colour.1", (1 << 23) + 1, More(features="packed-weights"))),
]
