"""Random scenes for the tests: every number that SPEC.md leaves free is drawn."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from refcodec.bitstream import codec
from refcodec.bitstream.attributes import Attributes
from refcodec.bitstream.dimensions import Dimensions, mask_contexts
from refcodec.bitstream.frame import Frame
from refcodec.bitstream.header import Lanes, PositionGrid, RenderInfo
from refcodec.bitstream.limits import MAIN, TINY
from refcodec.bitstream.scene import Scene, take_anchors

MAIN_DIMENSIONS = Dimensions(10, (5, 10, 15, 20), 8, 10, 16, (100,), (16, 16), (100,), 50)
LANES = Lanes(1, 1, 2)
TINY_DIMENSIONS = Dimensions(2, (2, 3), 2, 2, 4, (6,), (4, 4), (5,), 3)


def random_networks(d: Dimensions, rng: np.random.Generator, gain: float = 1.0) -> dict:
    """Networks whose outputs stay in useful ranges at gain 1."""
    networks = {}
    for name, shapes in d.network_shapes().items():
        layers = []
        for index, (out, fan_in) in enumerate(shapes):
            last = index == len(shapes) - 1
            spread = gain * (0.05 if last else 1.0) / np.sqrt(fan_in)
            weight = rng.normal(0, spread, (out, fan_in)).astype(np.float32)
            bias = rng.normal(0, 20 * gain, out).astype(np.float32)
            if last and name == "hyper":
                bias[-3:] += 32
            layers.append((weight, bias))
        networks[name] = layers
    return networks


def random_scene(
    seed: int,
    anchors: int,
    d: Dimensions = TINY_DIMENSIONS,
    *,
    profile: int | None = None,
    chunk_size: int = 4096,
    lanes: Lanes = LANES,
    gain: float = 1.0,
    spread: float = 3.0,
    keep: float = 0.6,
    base_step: tuple[float, float, float] = (1.0, 0.03125, 0.2),
) -> Scene:
    """A valid scene. spread: standard deviation of the symbols; keep: share of offsets that are kept."""
    rng = np.random.default_rng(seed)
    positions = rng.normal(0, 1, (anchors, 3)).astype(np.float16)
    positions[positions == 0] = 0
    masks = rng.random((anchors, d.offset_count)) < keep
    offsets = np.round(rng.normal(0, spread, (anchors, d.offset_count, 3))).astype(np.int32)
    offsets[~masks] = 0
    matrix = rng.integers(-(1 << 20) + 1, 1 << 20, (3, 3))
    size = d.plane_size
    scene = Scene(
        profile=(MAIN if d.features == 50 else TINY) if profile is None else profile,
        dimensions=d,
        chunk_size=chunk_size,
        lanes=lanes,
        base_step=(float(np.float32(base_step[0])), float(np.float32(base_step[1])), float(np.float32(base_step[2]))),
        grid=PositionGrid((-5, 1 << 40, 77), 40000, -15),
        render=RenderInfo(),
        frame=Frame(
            matrix,
            rng.integers(-(1 << 40), 1 << 40, 3),
            np.array([27, 28, 29]),
            np.array([-131072, -100000, -70000]),
            np.array([131072, 90000, 70001]),
        ),
        plane_shift=int(rng.integers(0, 8)),
        carm_shift=rng.integers(0, 3, d.carm_inputs).astype(np.uint8),
        networks=random_networks(d, rng, gain),
        planes=np.round(rng.laplace(0, spread, (5, d.plane_channels, size, size))).astype(np.int16),
        mask_model=rng.integers(1, 1 << 14, mask_contexts(d.offset_count)).astype(np.uint16),
        positions=positions,
        masks=masks,
        attributes=Attributes(
            np.round(rng.normal(0, spread, (anchors, d.features))).astype(np.int32),
            np.round(rng.normal(0, spread, (anchors, 6))).astype(np.int32),
            offsets,
            np.zeros((anchors, 3), np.uint8),
        ),
    )
    return with_steps(scene)


def without_chunks(scene: Scene, dropped: list[int]) -> Scene:
    """The scene without the anchors of some chunks."""
    keep = np.ones(scene.anchor_count, dtype=bool)
    for number in dropped:
        keep[number * scene.chunk_size : (number + 1) * scene.chunk_size] = False
    return take_anchors(scene, keep)


def with_steps(scene: Scene) -> Scene:
    """The scene with the step indices that its networks give."""
    return replace(scene, attributes=replace(scene.attributes, steps=codec.derive_steps(scene)))
