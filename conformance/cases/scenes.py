"""Scenes of the generator: every float in them is an integer times a power of two, so that they are the same on every machine."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from refcodec.bitstream import codec
from refcodec.bitstream.attributes import Attributes
from refcodec.bitstream.dimensions import Dimensions, mask_contexts
from refcodec.bitstream.frame import Frame
from refcodec.bitstream.header import Lanes, PositionGrid, RenderInfo
from refcodec.bitstream.limits import MAIN, TINY
from refcodec.bitstream.networks import Layer
from refcodec.bitstream.scene import Scene
from refcodec.bitstream.weights import to_grid

from .numbers import Numbers

Networks = dict[str, list[Layer]]

SMALL = Dimensions(2, (2, 3), 2, 2, 4, (6,), (4, 4), (5,), 3)
SMALLEST = Dimensions(1, (1,), 1, 1, 2, (1,), (1,), (), 1)
LARGEST = Dimensions(10, (16, 16, 16, 16), 8, 10, 32, (64, 64), (16, 16), (64, 64), 64)
MAIN_SMALLEST = Dimensions(10, (5, 10, 15, 20), 8, 10, 2, (16,), (16, 16), (16,), 50)


def dyadic(integers: NDArray[np.int64], bits: int) -> NDArray[np.float32]:
    """Integers over 2^bits, exact in f32."""
    return np.ldexp(integers.astype(np.float32), -bits).astype(np.float32)


def networks(d: Dimensions, numbers: Numbers) -> Networks:
    """Networks whose outputs stay in useful ranges."""
    found: Networks = {}
    for name, shapes in d.network_shapes().items():
        found[name] = []
        for index, (out, fan_in) in enumerate(shapes):
            last = index == len(shapes) - 1
            weight = dyadic(numbers.integers(-200, 200, out, fan_in), 12 if last else 8)
            bias = dyadic(numbers.integers(-640, 640, out), 5)
            if last and name == "hyper":
                bias[-3:] += 32
            found[name].append((weight, bias))
    return found


def positions(numbers: Numbers, anchors: int) -> NDArray[np.float16]:
    """Finite f16 of all magnitudes, no -0."""
    bits = numbers.integers(0, 0x7BFF, anchors, 3) | numbers.chosen([0, 0x8000], anchors, 3)
    bits[bits == 0x8000] = 0
    return bits.astype(np.uint16).view(np.float16)


def lattice(numbers: Numbers, anchors: int, spread: int = 12) -> NDArray[np.float16]:
    """Different points of a lattice of the unit 1/4, in the order of their cells."""
    codes: NDArray[np.int64] = np.zeros(0, np.int64)
    while len(codes) < anchors:
        codes = np.unique(np.append(codes, numbers.integers(0, (2 * spread + 1) ** 3 - 1, anchors)))
    side = 2 * spread + 1
    points = np.stack([codes // side**2, codes // side % side, codes % side], axis=1) - spread
    found = (points * 0.25).astype(np.float16)
    # Imported late: the encoder's choices are no part of most scenes.
    from refcodec.encoder.positions import morton_order  # noqa: PLC0415

    found = found[morton_order(found)]
    return found[np.linspace(0, len(found) - 1, anchors).astype(int)] if len(found) > anchors else found


def scene(name: str, anchors: int = 6, d: Dimensions = SMALL, seed: int = 0, **changes: Any) -> Scene:
    """A valid scene of ordinary numbers; changes: fields of Scene, of which the symbols may be given too."""
    numbers = Numbers(name, seed)
    main = d.features == 50
    masks = numbers.integers(0, 4, anchors, d.offset_count) > 1
    offsets = numbers.centred(3, anchors, d.offset_count, 3).astype(np.int32)
    made = Scene(
        profile=MAIN if main else TINY,
        dimensions=d,
        chunk_size=4096,
        lanes=Lanes(1, 1, 2),
        base_step=(1.0, 0.03125, float(np.float32(0.2))),
        grid=PositionGrid((-5, 1 << 40, 77), 40000, -15),
        render=RenderInfo(),
        frame=Frame(
            numbers.integers(1 - (1 << 20), (1 << 20) - 1, 3, 3),
            numbers.integers(-(1 << 40), 1 << 40, 3),
            np.array([29, 30, 31]),
            np.array([-131072, -100000, -70000]),
            np.array([131072, 90000, 70001]),
        ),
        plane_shift=numbers.integer(1, 6),
        carm_shift=numbers.integers(0, 2, d.carm_inputs).astype(np.uint8),
        networks=networks(d, numbers),
        planes=numbers.centred(3, 5, d.plane_channels, d.plane_size, d.plane_size).astype(np.int16),
        mask_model=numbers.integers(2000, 14000, mask_contexts(d.offset_count)).astype(np.uint16),
        positions=positions(numbers, anchors),
        masks=masks,
        attributes=Attributes(
            numbers.centred(3, anchors, d.features).astype(np.int32),
            numbers.centred(3, anchors, 6).astype(np.int32),
            offsets,
            np.zeros((anchors, 3), np.uint8),
        ),
    )
    return settled(replace(made, **changes))


def settled(made: Scene) -> Scene:
    """The scene with masked offsets at 0 and the step indices that its networks give."""
    a = made.attributes
    attributes = replace(a, offsets=np.where(made.masks[:, :, None], a.offsets, 0).astype(np.int32))
    found = replace(made, attributes=attributes)
    return replace(found, attributes=replace(attributes, steps=codec.derive_steps(found)))


def with_symbols(made: Scene, **symbols: NDArray[Any]) -> Scene:
    """The scene with other symbols: features, scalings or offsets."""
    changes: dict[str, Any] = {kind: value.astype(np.int32) for kind, value in symbols.items()}
    return settled(replace(made, attributes=replace(made.attributes, **changes)))


def scales(found: Networks) -> NDArray[np.uint8]:
    """Scale indices of mode 1 that suit the weights, from bit lengths: uint8 [layers, 3], 0 for a raw layer."""
    rows = []
    for grid in (to_grid(layer) for layers in found.values() for layer in layers):
        parts = [] if grid is None else [grid.difference, grid.weight, grid.bias]
        rows.append(
            [min(40 + 8 * (int(np.abs(p).max()).bit_length() - 1), 255) if p.any() else 0 for p in parts] or [0, 0, 0]
        )
    return np.array(rows, dtype=np.uint8)


def packed_weights(made: Scene, values: NDArray[np.uint8] | None = None) -> Scene:
    """The scene with its weights in mode 1 as they are; values: other scale indices."""
    return replace(made, weight_scales=scales(made.networks) if values is None else values)


def observing(d: Dimensions, numbers: Numbers, scale: int = -8) -> Networks:
    """Networks that pass the context on: the mean of channel c is the context's number c modulo their count, in 1/16 steps, so that a
    context that is wrong by one gives another model. The hidden layer of F_h has two units for each number, for either sign."""
    found = networks(d, numbers)
    inputs, total = 2 * d.plane_channels + 2 * d.frequency_count, d.attribute_width
    assert d.hyper_width == (2 * inputs,)
    first: NDArray[np.int64] = np.concatenate([np.eye(inputs, dtype=np.int64), -np.eye(inputs, dtype=np.int64)])
    last = np.zeros((2 * total + 3, 2 * inputs), np.int64)
    bias = np.zeros(2 * total + 3, np.int64)
    for c in range(total):
        last[c, [c % inputs, inputs + c % inputs]] = 1, -1
    bias[total : 2 * total], bias[2 * total :] = scale, 32
    found["hyper"] = [(dyadic(first, 0), dyadic(np.zeros(2 * inputs, np.int64), 0)), (dyadic(last, 0), dyadic(bias, 0))]
    for name in found:
        if name.startswith("carm"):
            found[name] = silent(found[name])
    return found


def silent(layers: list[Layer]) -> list[Layer]:
    """Layers of zeros."""
    return [(np.zeros_like(weight), np.zeros_like(bias)) for weight, bias in layers]


def constant(d: Dimensions, numbers: Numbers, mean: NDArray[np.int64], scale: NDArray[np.int64]) -> Networks:
    """Networks whose F_h says the same of every anchor: means and scale indices of the D channels; CARM adds nothing."""
    found = networks(d, numbers)
    found = {
        name: silent(layers) if name == "hyper" or name.startswith("carm") else layers for name, layers in found.items()
    }
    found["hyper"][-1][1][:] = np.concatenate([mean, scale, [32, 32, 32]])
    return found
