"""Valid scenes of NumPy's random numbers, with given spreads, scenes without some chunks, and damaged files."""

from typing import Any

import numpy as np

from conformance.cases.scenes import BOUNDS, TINY_DIMENSIONS, assembled
from conformance.cases.weights import Networks
from refcodec.bitstream.attributes import Attributes
from refcodec.bitstream.dimensions import Dimensions, mask_contexts
from refcodec.bitstream.frame import Frame
from refcodec.bitstream.scene import Scene, take_anchors


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
    frame = None
    if d.has_frame:
        matrix, translation = rng.integers(1 - (1 << 20), 1 << 20, (3, 3)), rng.integers(-(1 << 40), 1 << 40, 3)
        frame = Frame(matrix, translation, np.array([27, 28, 29]), *BOUNDS)
    drawn = {
        "base_step": tuple(float(np.float32(step)) for step in base_step),
        "frame": frame,
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
    return assembled(d, {**drawn, **changes})


def random_networks(d: Dimensions, rng: np.random.Generator, gain: float = 1.0) -> Networks:
    """Returns networks of NumPy's random numbers, with outputs in useful ranges at gain 1."""
    networks: Networks = {}
    for name, shapes in d.network_shapes().items():
        networks[name] = []
        for index, (out, fan_in) in enumerate(shapes):
            last = index == len(shapes) - 1
            spread = gain * (0.05 if last else 1.0) / np.sqrt(max(fan_in, 1))
            weight = rng.normal(0, spread, (out, fan_in)).astype(np.float32)
            bias = rng.normal(0, 20 * gain, out).astype(np.float32)
            if last and name == "hyper":
                bias[-3:] += 32
            networks[name].append((weight, bias))
    return networks


def flipped(data: bytes, *places: int) -> bytes:
    """Returns a file with one bit flipped in each of some bytes. Negative places count from the end."""
    changed = bytearray(data)
    for place in places:
        changed[place] ^= 1
    return bytes(changed)


def without_chunks(made: Scene, dropped: list[int]) -> Scene:
    """Returns the scene without the anchors of given chunks."""
    keep = np.ones(made.anchor_count, dtype=bool)
    for number in dropped:
        keep[number * made.chunk_size : (number + 1) * made.chunk_size] = False
    return take_anchors(made, keep)
