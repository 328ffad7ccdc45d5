"""Makes vectors/tiny-example.c3gs, the file that SPEC.md Annex D explains. Simple formulas give all its numbers."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from refcodec.bitstream import codec
from refcodec.bitstream.attributes import Attributes
from refcodec.bitstream.cameras import CAMERAS, NamedCamera, emit_cameras
from refcodec.bitstream.dimensions import Dimensions
from refcodec.bitstream.frame import Frame
from refcodec.bitstream.header import Lanes, PositionGrid, RenderInfo
from refcodec.bitstream.limits import TINY
from refcodec.bitstream.metadata import METADATA, emit_metadata
from refcodec.bitstream.scene import Ancillary, Scene

from .made import ROOT, Made

TARGET = ROOT / "vectors" / "tiny-example.c3gs"
DIMENSIONS = Dimensions(2, (2, 3), 1, 2, 4, (4,), (3,), (3,), 2)
ANCHORS = 5


def pattern(count: int, period: int) -> np.ndarray:
    """Returns `count` small integers of both signs, int64: 0, 1, -1, 2, -2 and so on, with a period."""
    n = np.arange(count) % period
    return np.where(n % 2, (n + 1) // 2, -(n // 2))


def example() -> Scene:
    """Returns the scene. It has five anchors in two chunks.

    One third of the offsets is masked. One large feature needs an escape. The first section is metadata, and the last
    one a camera.
    """
    networks = {}
    for number, (name, shapes) in enumerate(DIMENSIONS.network_shapes().items()):
        layers = []
        for out, fan_in in shapes:
            weight = (pattern(out * fan_in, 7 + number) / 4).astype(np.float32).reshape(out, fan_in)
            layers.append((weight, (8 * pattern(out, 5 + number)).astype(np.float32)))
        networks[name] = layers
    # The step indices lie near the middle of the table.
    networks["hyper"][-1][1][-3:] += 32
    count = ANCHORS * 2
    masks = (np.arange(count) % 3 != 2).reshape(ANCHORS, 2)
    offsets = pattern(3 * count, 9).reshape(ANCHORS, 2, 3).astype(np.int32)
    offsets[~masks] = 0
    features = pattern(5 * ANCHORS, 11).reshape(ANCHORS, 5).astype(np.int32)
    features[3, 4] = 1000
    unit = 1 << 16
    scene = Scene(
        profile=TINY,
        dimensions=DIMENSIONS,
        chunk_size=3,
        lanes=Lanes(0, 0, 1),
        base_step=(1.0, 0.03125, 0.25),
        grid=PositionGrid((0, 0, 1 << 24), 3 << 14, -17),
        render=RenderInfo(),
        frame=Frame(
            np.diag([1 << 16, 1 << 17, 1 << 18]),
            np.array([0, -(1 << 38), 0]),
            np.array([25, 25, 25]),
            np.full(3, -2 * unit),
            np.full(3, 2 * unit),
        ),
        plane_shift=4,
        carm_shift=np.zeros(2, np.uint8),
        networks=networks,
        planes=pattern(5 * 16, 13).reshape(5, 1, 4, 4).astype(np.int16),
        mask_model=np.array([10000, 8192, 11000], np.uint16),
        positions=(pattern(3 * ANCHORS, 10) / 2 + 0.25).astype(np.float16).reshape(ANCHORS, 3),
        masks=masks,
        attributes=Attributes(
            features,
            pattern(6 * ANCHORS, 6).reshape(ANCHORS, 6).astype(np.int32),
            offsets,
            np.zeros((ANCHORS, 3), np.uint8),
        ),
        ancillary=(
            Ancillary(METADATA, 0, emit_metadata({"title": "Worked example", "licence": "CC0-1.0"}), 0),
            Ancillary(CAMERAS, 0, emit_cameras([NamedCamera()]), 5),
        ),
    )
    return replace(scene, attributes=replace(scene.attributes, steps=codec.derive_steps(scene)))


def made() -> Iterator[Made]:
    """Yields the file."""
    yield Made(TARGET, codec.emit(example()))
