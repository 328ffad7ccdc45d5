"""Valid scenes and parts of them.

- `scene` takes its numbers from SHAKE-256 of a name (numbers.py), and every float is an integer times a power of two.
  Thus it is the same on every machine. The suite consists of such scenes. Their names are permanent, because another
  name gives another file.
- `random_scene` takes its numbers from NumPy's generator, with given spreads. It is for tests.
"""

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
from refcodec.bitstream.scene import Scene, take_anchors
from refcodec.bitstream.weights import to_grid
from refcodec.encoder.positions import morton_order

from .numbers import Int64, Numbers

Networks = dict[str, list[Layer]]

# For both profiles, the usual dimensions, the smallest and the largest.
TINY_DIMENSIONS = Dimensions(2, (2, 3), 2, 2, 4, (6,), (4, 4), (5,), 3)
MAIN_DIMENSIONS = Dimensions(10, (5, 10, 15, 20), 8, 10, 16, (100,), (16, 16), (100,), 50)
SMALLEST = Dimensions(1, (1,), 1, 1, 2, (1,), (1,), (), 1)
LARGEST = Dimensions(10, (16, 16, 16, 16), 8, 10, 32, (64, 64), (16, 16), (64, 64), 64)
# Without planes, without a positional encoding, and without either.
PLANELESS = Dimensions(2, (2, 3), 0, 2, 0, (6,), (), (5,), 3)
UNENCODED = Dimensions(2, (2, 3), 2, 0, 4, (6,), (4, 4), (5,), 3)
CONSTANT = Dimensions(2, (2, 3), 0, 0, 0, (), (), (5,), 3)
MAIN_SMALLEST = Dimensions(10, (5, 10, 15, 20), 8, 10, 2, (16,), (16, 16), (16,), 50)


def dyadic(integers: Int64, bits: int) -> NDArray[np.float32]:
    """Returns integers divided by 2^bits, exact in f32."""
    return np.ldexp(integers.astype(np.float32), -bits).astype(np.float32)


# --- whole scenes -----------------------------------------------------------------------------------------------------


def scene(name: str, anchors: int = 6, d: Dimensions = TINY_DIMENSIONS, seed: int = 0, **changes: Any) -> Scene:
    """Returns a valid scene of ordinary numbers. name, seed: of its Numbers. changes: given fields of Scene."""
    numbers = Numbers(name, seed)
    masks = numbers.integers(0, 4, anchors, d.offset_count) > 1
    offsets = numbers.centred(3, anchors, d.offset_count, 3).astype(np.int32)
    drawn = {
        "frame": Frame(
            numbers.integers(1 - (1 << 20), (1 << 20) - 1, 3, 3),
            numbers.integers(-(1 << 40), 1 << 40, 3),
            np.array([29, 30, 31]),
            *_BOUNDS,
        )
        if d.has_frame
        else None,
        "plane_shift": numbers.integer(1, 6) if d.plane_channels else 0,
        "carm_shift": numbers.integers(0, 2, d.carm_inputs).astype(np.uint8),
        "networks": networks(d, numbers),
        "planes": numbers.centred(3, 5, d.plane_channels, d.plane_size, d.plane_size).astype(np.int16),
        "mask_model": numbers.integers(2000, 14000, mask_contexts(d.offset_count)).astype(np.uint16),
        "positions": positions(numbers, anchors),
        "masks": masks,
        "attributes": Attributes(
            numbers.centred(3, anchors, d.features).astype(np.int32),
            numbers.centred(3, anchors, 6).astype(np.int32),
            offsets,
            np.zeros((anchors, 3), np.uint8),
        ),
    }
    return _assembled(d, {**drawn, **changes})


def random_scene(
    seed: int,
    anchors: int,
    d: Dimensions = TINY_DIMENSIONS,
    *,
    gain: float = 1.0,
    spread: float = 3.0,
    keep: float = 0.6,
    base_step: tuple[float, float, float] = (1.0, 0.03125, 0.2),
    **changes: Any,
) -> Scene:
    """Returns a valid scene of NumPy's random numbers.

    gain: of the networks, whose outputs are in useful ranges at 1. spread: standard deviation of the symbols.
    keep: share of kept offsets. base_step: rounded to f32. changes: given fields of Scene.
    """
    rng = np.random.default_rng(seed)
    where = rng.normal(0, 1, (anchors, 3)).astype(np.float16)
    where[where == 0] = 0
    masks = rng.random((anchors, d.offset_count)) < keep
    offsets = np.round(rng.normal(0, spread, (anchors, d.offset_count, 3))).astype(np.int32)
    drawn = {
        "base_step": tuple(float(np.float32(step)) for step in base_step),
        "frame": Frame(
            rng.integers(1 - (1 << 20), 1 << 20, (3, 3)),
            rng.integers(-(1 << 40), 1 << 40, 3),
            np.array([27, 28, 29]),
            *_BOUNDS,
        )
        if d.has_frame
        else None,
        "plane_shift": int(rng.integers(0, 8)) if d.plane_channels else 0,
        "carm_shift": rng.integers(0, 3, d.carm_inputs).astype(np.uint8),
        "networks": random_networks(d, rng, gain),
        "planes": np.round(rng.laplace(0, spread, (5, d.plane_channels, d.plane_size, d.plane_size))).astype(np.int16),
        "mask_model": rng.integers(1, 1 << 14, mask_contexts(d.offset_count)).astype(np.uint16),
        "positions": where,
        "masks": masks,
        "attributes": Attributes(
            np.round(rng.normal(0, spread, (anchors, d.features))).astype(np.int32),
            np.round(rng.normal(0, spread, (anchors, 6))).astype(np.int32),
            offsets,
            np.zeros((anchors, 3), np.uint8),
        ),
    }
    return _assembled(d, {**drawn, **changes})


# SPEC 5.7: low and high of the ordinary frames.
_BOUNDS = (np.array([-131072, -100000, -70000]), np.array([131072, 90000, 70001]))


def _assembled(d: Dimensions, fields: dict[str, Any]) -> Scene:
    """Returns a scene of these fields, usual other fields, and derived ones."""
    usual = {
        "profile": MAIN if d.features == 50 else TINY,
        "chunk_size": 4096,
        "lanes": Lanes(1, 1, 2),
        "base_step": (1.0, 0.03125, float(np.float32(0.2))),
        "grid": PositionGrid((-5, 1 << 40, 77), 40000, -15),
        "render": RenderInfo(),
    }
    return settled(Scene(dimensions=d, **{**usual, **fields}))


def settled(made: Scene) -> Scene:
    """Returns the scene with masked offsets at 0, and with the step indices of its networks."""
    a = made.attributes
    offsets = np.where(made.masks[:, :, None], a.offsets, 0).astype(np.int32)
    return with_steps(replace(made, attributes=replace(a, offsets=offsets)))


def with_steps(made: Scene) -> Scene:
    """Returns the scene with the step indices of its networks."""
    return replace(made, attributes=replace(made.attributes, steps=codec.derive_steps(made)))


def with_symbols(made: Scene, **symbols: NDArray[Any]) -> Scene:
    """Returns the scene with other symbols: features, scalings or offsets."""
    changes: dict[str, Any] = {kind: value.astype(np.int32) for kind, value in symbols.items()}
    return settled(replace(made, attributes=replace(made.attributes, **changes)))


def without_chunks(made: Scene, dropped: list[int]) -> Scene:
    """Returns the scene without the anchors of given chunks."""
    keep = np.ones(made.anchor_count, dtype=bool)
    for number in dropped:
        keep[number * made.chunk_size : (number + 1) * made.chunk_size] = False
    return take_anchors(made, keep)


# --- frames and positions ---------------------------------------------------------------------------------------------


def frame_of(
    matrix: Any, translation: Any = (0, 0, 0), shift: Any = (0, 0, 0), low: Any = None, high: Any = None
) -> Frame:
    """Returns a frame from lists. By default its range is -2 to 2, which is 2^17 of its units (SPEC 7.5.1)."""
    bounds = [np.full(3, -1 << 17) if low is None else low, np.full(3, 1 << 17) if high is None else high]
    return Frame(
        *(np.array(part, dtype=np.int64) for part in (np.reshape(matrix, (3, 3)), translation, shift, *bounds))
    )


def positions(numbers: Numbers, anchors: int) -> NDArray[np.float16]:
    """Returns finite f16 numbers of all magnitudes except -0."""
    bits = numbers.integers(0, 0x7BFF, anchors, 3) | numbers.chosen([0, 0x8000], anchors, 3)
    bits[bits == 0x8000] = 0
    return bits.astype(np.uint16).view(np.float16)


def f16(integers: Int64) -> NDArray[np.float16]:
    """Returns the positions whose P (SPEC 7.4) are these integers, which must be exact in f16."""
    found = np.ldexp(integers.astype(np.float64), -24).astype(np.float16)
    assert (np.ldexp(found.astype(np.float64), 24) == integers).all()
    found[found == 0] = 0
    return found


def lattice(numbers: Numbers, anchors: int, spread: int = 12) -> NDArray[np.float16]:
    """Returns distinct points of a lattice with the unit 1/4, in the order of their cells."""
    codes: Int64 = np.zeros(0, np.int64)
    side = 2 * spread + 1
    while len(codes) < anchors:
        codes = np.unique(np.append(codes, numbers.integers(0, side**3 - 1, anchors)))
    points = np.stack([codes // side**2, codes // side % side, codes % side], axis=1) - spread
    found = (points * 0.25).astype(np.float16)
    found = found[morton_order(found)]
    return found[np.linspace(0, len(found) - 1, anchors).astype(int)] if len(found) > anchors else found


# --- networks ---------------------------------------------------------------------------------------------------------


def networks(d: Dimensions, numbers: Numbers) -> Networks:
    """Returns networks with outputs in useful ranges."""
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


def random_networks(d: Dimensions, rng: np.random.Generator, gain: float = 1.0) -> Networks:
    """Returns networks of NumPy's random numbers, with outputs in useful ranges at gain 1."""
    found: Networks = {}
    for name, shapes in d.network_shapes().items():
        found[name] = []
        for index, (out, fan_in) in enumerate(shapes):
            last = index == len(shapes) - 1
            spread = gain * (0.05 if last else 1.0) / np.sqrt(max(fan_in, 1))
            weight = rng.normal(0, spread, (out, fan_in)).astype(np.float32)
            bias = rng.normal(0, 20 * gain, out).astype(np.float32)
            if last and name == "hyper":
                bias[-3:] += 32
            found[name].append((weight, bias))
    return found


def silent(layers: list[Layer]) -> list[Layer]:
    """Returns layers of zeros."""
    return [(np.zeros_like(weight), np.zeros_like(bias)) for weight, bias in layers]


def constant(d: Dimensions, numbers: Numbers, mean: Int64, scale: Int64) -> Networks:
    """Returns networks whose F_h gives the same for every anchor, and whose CARM gives zeros.

    mean: int64 [channels], in sixteenths of a symbol. scale: int64 [channels], scale indices.
    """
    found = {
        name: silent(layers) if name == "hyper" or name.startswith("carm") else layers
        for name, layers in networks(d, numbers).items()
    }
    found["hyper"][-1][1][:] = np.concatenate([mean, scale, [32, 32, 32]])
    return found


def observing(d: Dimensions, numbers: Numbers, scale: int = -8) -> Networks:
    """Returns networks that output the context, so that a context that is wrong by one gives another model.

    The mean of channel c is the context's number c modulo their count, in sixteenths. The hidden layer of F_h has two
    units for each number, one for either sign. scale: the scale index of all channels.
    """
    found = networks(d, numbers)
    inputs, total = 2 * d.plane_channels + 2 * d.frequency_count, d.attribute_width
    assert d.hyper_width == (2 * inputs,)
    first: Int64 = np.concatenate([np.eye(inputs, dtype=np.int64), -np.eye(inputs, dtype=np.int64)])
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


# --- weights in mode 1 ------------------------------------------------------------------------------------------------


def scales(found: Networks) -> NDArray[np.uint8]:
    """Returns scale indices of mode 1 by the bit lengths of the weights, uint8 [layers, 3], 0 for a raw layer."""
    rows = []
    for grid in (to_grid(layer) for layers in found.values() for layer in layers):
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
