"""Cases of clauses 5.11, 6.10, 6.12, 7.6 to 7.10 and 9: masks, steps, attributes, and their values in f32.

The faults of their substreams are in entropy_substreams.py. World positions are with the position grid in header.py.
"""

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from refcodec.bitstream.attributes import ATTRIBUTE_SYMBOL_MAX
from refcodec.bitstream.conventions import round_to_f32
from refcodec.bitstream.dimensions import Dimensions, mask_contexts
from refcodec.bitstream.scene import Scene
from refcodec.bitstream.tables import tables

from .fault import element, padding
from .numbers import Int64, Numbers
from .samplers import Sampler, drawn, sampled
from .scenes import SMALLEST, TINY_DIMENSIONS, f16, frame_of, scene, with_symbols
from .table import NAME, More, refused, valid
from .targets import five_cells, packed, plain
from .weights import constant, dyadic, networks, set_weights

mask_model = element(
    "index.mask_model",
    "index.mask_model.frequency[{}]",
    lambda d, t: d.integer(0, mask_contexts(t.header.dimensions.offset_count) - 1),
    [0, 1 << 14, 65535],
)
padding_byte = padding("index.padding", r"index\.mask_model\.padding")


# Four slices, with small offsets and networks.
SLICES = Dimensions(2, (3, 4, 2, 3), 1, 1, 3, (8,), (3,), (12,), 2)


def _carm(name: str, shift: Int64, spread: int) -> Scene:
    """Returns a scene whose slices depend on each other.

    shift: carm_shift, int64 [inputs]. spread: the largest mean, in sixteenths of a symbol.
    """
    numbers, width = Numbers(name), SLICES.attribute_width
    carm = {network: layers for network, layers in networks(SLICES, numbers).items() if network.startswith("carm")}
    for layers in carm.values():
        w, b = layers[-1]
        w[:] = dyadic(numbers.integers(-100, 100, *w.shape), 7)
        b[:] = dyadic(numbers.integers(-40, 40, len(b)), 1)
    mean = numbers.integers(-spread, spread, width)
    network_weights = {**constant(SLICES, numbers, mean, numbers.integers(-10, 20, width)), **carm}
    return sampled(
        scene(name, 25, SLICES, networks=network_weights, carm_shift=shift.astype(np.uint8)), Sampler(numbers, 30)
    )


def _channels() -> Scene:
    numbers, channel = Numbers("channel-order"), np.arange(SLICES.attribute_width)
    network_weights = constant(SLICES, numbers, 160 * channel - 1500, channel - 20)
    return sampled(scene("channel-order", 12, SLICES, networks=network_weights), Sampler(numbers, 0))


def _steps() -> Scene:
    numbers = Numbers("steps")
    network_weights = set_weights(
        networks(SLICES, numbers),
        ("hyper.-1", slice(-3, None), lambda w: dyadic(numbers.integers(-90, 90, *w.shape), 3), (0, 32, 63)),
    )
    return sampled(scene("steps", 60, SLICES, networks=network_weights), Sampler(numbers, 0))


FOUR = Dimensions(1, (4,), 1, 1, 2, (1,), (1,), (), 1)


def _of_steps(name: str, anchors: int, d: Dimensions, scale: int, base_step: Any, steps: Any) -> Scene:
    """Returns a scene that keeps all offsets. scale: index of all channels. steps: step indices."""
    network_weights = set_weights(constant(d, Numbers(name), 0, scale), ("hyper.-1", slice(-3, None), None, steps))
    masks = np.ones((anchors, d.offset_count), bool)
    return scene(name, anchors, d, base_step=base_step, masks=masks, networks=network_weights)


def _values(name: str, base_step: tuple[float, float, float], steps: tuple[int, int, int] = (3, 41, 63)) -> Scene:
    """Returns a scene of small and large symbols. steps: step indices; those that are not 32 make long products."""
    numbers, made, most = Numbers(name), _of_steps(name, 12, FOUR, 60, base_step, steps), ATTRIBUTE_SYMBOL_MAX
    networks(FOUR, numbers)
    return with_symbols(
        made,
        features=numbers.chosen([3, -3, 5, 7, -9, 1, 0, most, -most, 1 << 20, 12345], 12, 4),
        scalings=numbers.chosen([3, -3, 5, 2, -7, 11, most, -most], 12, 6),
        offsets=numbers.chosen([3, -3, 5, 6, -1, 13, most, -most], 12, 1, 3),
    )


def _table() -> Scene:
    # 64 anchors, one for each step index. The planes select it, because the positional encoding cannot.
    d = Dimensions(1, (2,), 1, 1, 32, (2,), (1,), (), 1)
    numbers = Numbers("values-table")
    network_weights = constant(d, numbers, 0, 0)
    set_weights(
        network_weights,
        ("hyper.0", (0, 1), 1, None),
        ("hyper.1", slice(-3, None), None, 0),
        ("hyper.1", np.s_[-3:, 0], 1, None),
    )
    planes = np.zeros((5, 1, 32, 32), np.int16)
    for quadrant in range(1, 5):
        planes[quadrant, 0] = np.arange(32)[None, :] + (32 if quadrant in (2, 4) else 0)
    frame = frame_of(np.eye(3, dtype=np.int64), low=(0, 0, 0), high=(63, 1, 1))
    fields: dict[str, Any] = {"planes": planes, "plane_shift": 0, "frame": frame, "networks": network_weights}
    points, masks = f16(np.stack([np.arange(64), *np.zeros((2, 64), int)], axis=1)), np.ones((64, 1), bool)
    made = scene("values-table", 64, d, positions=points, masks=masks, **fields)
    return sampled(made, Sampler(numbers, 0), planes=False)


def _with_step(name: str, index: int, base_step: tuple[float, ...], symbols: Int64) -> Scene:
    """Returns a scene with an anchor for each symbol, in all attributes. index: step index of all kinds."""
    made, y = _of_steps(name, len(symbols), SMALLEST, 160, base_step, index), symbols[:, None]
    return with_symbols(made, features=y, scalings=y.repeat(6, axis=1), offsets=y.repeat(3, axis=1)[:, None, :])


def _rounded_steps() -> Scene:
    significand, index = 14832217, 63
    bases = tuple(significand * 2.0**-e for e in (24, 30, 20))
    exact = int(tables().step[index]) * significand
    symbols = np.arange(8388607, 8380000, -1234)
    values = round_to_f32(np.array([exact]), 0) * symbols.astype(np.float32)
    # Symbols whose value differs if the product of all three numbers is rounded once.
    other = symbols[values != round_to_f32(exact * symbols, 0)]
    assert len(other) >= 3
    return _with_step("values-of-rounded-steps", index, bases, np.concatenate([other, -other]))


def _tied_steps() -> Scene:
    # An odd number of 25 bits is a tie. Its half is even or odd.
    index = 1
    entry = int(tables().step[index])
    first = (1 << 24) // entry | 1
    odd = [k for k in range(first, first + 40, 2) if k * entry > 1 << 24]
    chosen = [next(k for k in odd if k * entry % 4 == rest) for rest in (1, 3)]
    bases = (chosen[0] * 2.0**-20, chosen[1] * 2.0**-20, chosen[1] * 2.0**-9)
    return _with_step("values-of-tied-steps", index, bases, np.array([1, -1, 3, -7, 8388607]))


# fmt: off
_FOUR = replace(TINY_DIMENSIONS, offset_count=4)
_SIX, _TEN = (replace(TINY_DIMENSIONS, offset_count=count, slices=(1,), carm_width=()) for count in (6, 10))
_EVERY = np.array([[n >> k & 1 for k in range(6)] for n in range(64)], dtype=bool)
_EXTREME = Numbers("mask-model-extreme").chosen([1, 2, (1 << 14) - 1, (1 << 14) - 2, 1 << 13], 15).astype(np.uint16)
_NONE, _SHIFTS = np.zeros(SLICES.carm_inputs, np.int64), Numbers("carm").integers(1, 4, SLICES.carm_inputs)
_TIES = (1 + 2.0**-23, 1 + 3 * 2.0**-23, 1 + 5 * 2.0**-23)
_LONG = (float(np.float32(0.1)), float(np.float32(1 / 3)), 2 - 2.0**-23)
CASES = [
    *refused("masks", "limit-off-by-one", *(
        (f"mask-model-{value}", f"a frequency of {value} in the mask model", mask_model, number, value)
        for number, value in ((0, 0), (2, 1 << 14), (1, 65535)))),
    *refused("masks", "padding-unchecked", *(
        (f"mask-model-padding-{name}", f"padding of the mask model that is not zero: {name.replace('-', ' ')}", base,
         padding_byte, "index.mask_model.padding", at, 1)
        for name, base, at in (("first", plain, 0), ("last", packed, 1), ("one-model", five_cells, 1)))),
    *valid("masks attributes", "masked-offsets", "D7.6-1 D7.10-1", *(
        (f"masks-{name}", title, partial(drawn, f"masks-{kept:d}", 9, _FOUR, masks=np.full((9, 4), kept), chunk_size=5))
        for name, title, kept in (("none", "no offset is kept", False), ("all", "every offset is kept", True)))),
    *valid("masks", "mask-context", "D7.6-1",
        ("masks-every", "every mask of six offsets", partial(drawn, "masks-every", 64, _SIX, masks=_EVERY),
         More("masked-offsets", "D7.10-1")),
        ("mask-model-extreme", "the least and the largest frequencies of a mask bit",
         partial(drawn, "mask-model-extreme", 40, replace(TINY_DIMENSIONS, offset_count=5), mask_model=_EXTREME),
         More("limit-off-by-one", "R6.10-1 D8.2-1")),
        ("mask-contexts", "a frequency of its own for each of 55 contexts",
         partial(drawn, "mask-contexts", 60, _TEN, mask_model=np.arange(1, 56).astype(np.uint16) * 280))),

    *valid("carm attributes", "carm-ignored carm-slices stage-order", "D7.9-1 D7.10-1 D7.7-1",
        ("carm", "slices that depend on each other", _carm, "carm", _NONE, 100)),
    *valid("carm", "", "D7.9-1", (_carm, NAME),
        ("carm-shifts", "inputs of CARM that are shifted, ties of either sign", _SHIFTS, 600, More("carm-rounding")),
        ("carm-largest-shift", "the largest carm_shift", _NONE + 16, 1 << 20,
         More("carm-rounding limit-off-by-one", "R6.8-1")),
        ("carm-clamp", "inputs of CARM beyond the largest activation", _NONE, 40000, More("activation-clamp"))),
    *valid("attributes", "channel-order stage-order", "D7.7-1 D7.10-1 D8.5-1",
        ("channel-order", "a mean and a scale of its own for each channel", _channels)),
    *valid("steps", "step-clamp step-kinds", "D7.8-1 D9.2-1 DA-1",
        ("steps", "step indices from one end of the table to the other, and beyond", _steps)),

    *valid("reconstruction steps", "limit-off-by-one symbol-limit", "D9.2-1 R6.2-7 R8.5-1",
        ("values-least", "the least base steps", _values, "values-least", (2.0**-60,) * 3),
        ("values-largest", "the largest base steps", _values, "values-largest", (2.0**60,) * 3)),
    *valid("reconstruction steps", "value-rounding symbol-limit", "D9.2-1 R6.2-7 R8.5-1",
        ("values-ties", "values halfway between two f32", _values, "values-ties", _TIES, (32, 32, 32)),
        ("values-long", "significands of 24 bits", _values, "values-long", _LONG)),
    *valid("steps reconstruction", "step-clamp step-table", "D7.8-1 D9.2-1 DA-1",
        ("values-table", "each entry of the step table", _table)),
    *valid("reconstruction steps", "value-rounding", "D9.2-1",
        ("values-of-rounded-steps", "values that are others if their step is not rounded to f32", _rounded_steps),
        ("values-of-tied-steps", "steps halfway between two f32, of which the even one counts", _tied_steps)),
]
