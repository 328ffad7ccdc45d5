"""Cases of clause 9.4: static scenes, of which the plain Gaussians are decoded."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial

import numpy as np

from refcodec.bitstream import codec
from refcodec.bitstream.conventions import round_to_f32
from refcodec.bitstream.dimensions import RENDER_MODELS, RENDERING, STATIC, Dimensions
from refcodec.bitstream.header import PositionGrid, RenderInfo
from refcodec.bitstream.scene import Scene
from refcodec.bitstream.splat import SCALING_BOUND, exponential

from . import limits, networks
from .book import Book
from .numbers import Numbers
from .scenes import SMALLEST, TINY_DIMENSIONS, dyadic, f16, lattice, packed_weights, scene, with_symbols
from .target import Target

DEGREES = RENDER_MODELS[STATIC][1]
RENDER = RenderInfo(render_model=STATIC)


def add(book: Book) -> None:
    """Adds the vectors."""
    valid = partial(book.valid, features="static reconstruction", requirements="D9.4-1 D9.3-1 R11.1-2")
    for degree in range(len(DEGREES)):
        title = f"a static scene with harmonics of degree {degree}"
        valid(f"static-degree-{degree}", title, partial(of_degree, degree), flags="static-part harmonics")
    rows: list[tuple[str, str, Callable[[], Scene]]] = [
        ("packed", "a static scene in mode 1, one layer raw", _packed),
        ("empty", "a static scene without anchors", partial(_scene, "static-empty", 0)),
        ("far", "features, scalings and offsets beyond what 9.4 limits", partial(_of_steps, "static-far", 2.0**60)),
        ("near", "the least features, scalings and offsets", partial(_of_steps, "static-near", 2.0**-60)),
        ("turned", "quaternions of zeros, and one with a single number", _turned),
        ("cancelled", "means that are 0, halfway between two f32, or lose all but their last bits", _cancelled),
        ("lengths", "scalings over the whole range of the exponential, and features with halves", _lengths),
        ("long", "logarithms of lengths with up to 29 bits, some halfway between two f32", _long),
    ]
    for name, title, make in rows:
        valid(f"static-{name}", title, make, flags="static-part value-rounding")
    refused = partial(book.add, features="static dimensions", flags="limit-off-by-one")
    for field, values in (("view_inputs", (1, 4)), ("colour_outputs", (1, 9, 13, 47))):
        for value in values:
            title, wrong = f"{field} {value} in a static scene", limits.dimension.of(target, field, value)
            refused(f"invalid-static-{field.replace('_', '-')}-{value}", title, wrong)
    bound = partial(book.add, features="static networks", flags="accumulator-bound row-order")
    for layer in ("opacity.0", "colour.1"):
        title = f"a weight of {layer} that leaves no exponent, in a static scene"
        wrong = networks.large_value.of(target, layer, 0, 0, 4096.0)
        bound(f"invalid-static-bound-{layer.replace('.', '-')}", title, wrong)
    title = "a packed layer whose rows have no exponent, in a static scene"
    bound("invalid-static-bound-packed", title, networks.large_integer.of(_packed_target, "colour.1", (1 << 23) + 1))


def _dimensions(outputs: int, d: Dimensions = TINY_DIMENSIONS) -> Dimensions:
    return replace(d, view_inputs=0, colour_outputs=outputs)


def _scene(name: str, anchors: int = 9, outputs: int = 12) -> Scene:
    """Returns a scene of ordinary sizes: features fill the range of activations, outputs are below 16."""
    numbers, d = Numbers(name), _dimensions(outputs)
    where = lattice(numbers, anchors)
    grid = PositionGrid((0, 0, 0), 1, 0)
    made = scene(name, anchors, d, positions=where, base_step=(16.0, 0.0625, 0.25), grid=grid, render=RENDER)
    w, b = made.networks["hyper"][-1]
    # The steps are the base steps.
    w[-3:], b[-3:] = 0, 32
    for layers in (made.networks[network] for network in RENDERING):
        for (weight, bias), bits in zip(layers, (7, 4), strict=True):
            weight[:] = dyadic(numbers.integers(-99, 99, *weight.shape), bits)
            bias[:] = dyadic(numbers.integers(-9999, 9999, len(bias)), bits)
    shapes = {"features": (anchors, d.features), "scalings": (anchors, 6), "offsets": (anchors, d.offset_count, 3)}
    return with_symbols(made, **{kind: numbers.integers(-60, 60, *shape) for kind, shape in shapes.items()})


@cache
def of_degree(degree: int) -> bytes:
    """Returns a static file with harmonics of a degree."""
    return codec.emit(_scene(f"static-degree-{degree}", 9, DEGREES[degree]))


@cache
def target() -> Target:
    """Returns a static file of degree 1 in mode 0."""
    return Target(of_degree(1))


def _packed() -> Scene:
    made = _scene("static-packed")
    # A bias of -0 cannot be packed.
    made.networks["colour"][0][1][0] = -0.0
    return packed_weights(made)


@cache
def _packed_target() -> Target:
    return Target(codec.emit(_packed()))


def _of_steps(name: str, step: float) -> Scene:
    numbers, made = Numbers(f"{name}/symbols"), _scene(name, 12, 3)
    made = replace(made, base_step=(step,) * 3)
    made.networks["hyper"][-1][1][-3:] = 63 if step > 1 else 0
    largest = (1 << 23) - 1
    values = [0, 1, -1, 3, -77, largest, -largest]
    shapes = {kind: getattr(made.attributes, kind).shape for kind in ("features", "scalings", "offsets")}
    return with_symbols(made, **{kind: numbers.chosen(values, *shape) for kind, shape in shapes.items()})


def _turned() -> Scene:
    made = _scene("static-turned")
    w, b = made.networks["covariance"][-1]
    w[3:7], b[3:7] = 0, 0
    w[10:14], b[10:14] = 0, [0, 0, -1, 0]
    return replace(made, masks=np.ones_like(made.masks))


def _cancelled() -> Scene:
    """Positions are 1, offsets -1 and their neighbours. The exponential of 0 is 1."""
    d = _dimensions(3, SMALLEST)
    near = [-1, -1, 1, -(1 << 22), (1 << 23) - 1, -((1 << 23) - 1), 3, -3]
    made = scene(
        "static-cancelled",
        len(near),
        d,
        positions=f16(np.ones((len(near), 3), np.int64)),
        grid=PositionGrid((0, 0, 0), 1, 0),
        masks=np.ones((len(near), 1), bool),
        base_step=(1.0, 1.0, 1.0),
        render=RENDER,
    )
    made.networks["hyper"][-1][0][-3:], made.networks["hyper"][-1][1][-3:] = 0, 32
    for layers in (made.networks[network] for network in RENDERING):
        for weight, bias in layers:
            weight[:], bias[:] = 0, 1
    offsets = np.array([[[x, x - 1, -x]] for x in near])
    scalings = np.zeros((len(near), 6), np.int64)
    # 2^-24 of 1, where sums are ties.
    scalings[2:, :3] = np.array([-17, -17, -8, -8, -17, -17])[:, None]
    return with_symbols(made, scalings=scalings, offsets=np.clip(offsets, 1 - (1 << 23), (1 << 23) - 1))


def _lengths() -> Scene:
    made = _scene("static-lengths", 61)
    made = replace(made, masks=np.ones_like(made.masks), base_step=(0.5, 2.0**-16, 0.25))
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
    numbers, made = Numbers("static-long/symbols"), _scene("static-long", 8)
    made = replace(made, masks=np.ones_like(made.masks), base_step=(0.5, 2.0**-16, 0.25))
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
