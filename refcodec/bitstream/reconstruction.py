"""Clause 9: reconstruction, from integers to float32 values that are rounded once, and the digest."""

from __future__ import annotations

import hashlib
import struct
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .attributes import KINDS
from .conventions import F32, f32_parts, round_to_f32
from .positions import position_integers
from .scene import Scene
from .tables import STEP_SHIFT, tables

# SPEC 9.3: the first bytes of the canonical reconstruction, and its parts behind the head.
DIGEST_MAGIC = b"C3GSREC0"
PARTS = ("positions", "masks", "planes", "features", "scalings", "offsets", "weights")


@dataclass(frozen=True, eq=False)
class Reconstruction:
    """The float32 values of a scene.

    positions: [N, 3], world units.
    features: [N, F].
    scalings: [N, 6], natural logarithms of world units.
    offsets: [N, K, 3], in units of exp(scalings[:, :3]), +0 where masked.
    """

    positions: F32
    features: F32
    scalings: F32
    offsets: F32


def world_positions(scene: Scene) -> F32:
    """SPEC 9.1, WORLD: returns the world positions of the anchors, float32 [N, 3]."""
    grid = scene.grid
    integers = np.array(grid.origin, dtype=np.int64) + grid.scale_mantissa * position_integers(scene.positions)
    return round_to_f32(integers, grid.scale_exponent - 24)


def dequantise(symbols: NDArray[np.int32], steps: NDArray[np.uint8], base_step: float) -> F32:
    """SPEC 9.2, VALUE: returns symbol * step, rounded once, float32 [n, ...].

    symbols: int32 [n, ...]. steps: uint8 [n], the step index of each anchor. base_step: a float32 value.
    """
    mantissa, exponent = f32_parts(base_step)
    step = tables().step[steps].reshape(-1, *[1] * (symbols.ndim - 1))
    return round_to_f32(symbols.astype(np.int64) * step * mantissa, exponent - STEP_SHIFT)


def reconstruct(scene: Scene) -> Reconstruction:
    """SPEC 9.1 and 9.2: returns the float32 values of a scene."""
    a = scene.attributes
    values = [dequantise(getattr(a, kind), a.steps[:, i], scene.base_step[i]) for i, kind in enumerate(KINDS)]
    return Reconstruction(world_positions(scene), *values)


def canonical_parts(scene: Scene) -> Iterator[tuple[str, bytes]]:
    """SPEC 9.3: yields the name and the bytes of each part of the canonical reconstruction behind the head."""
    r = reconstruct(scene)
    yield "positions", r.positions.astype("<f4").tobytes()
    yield "masks", scene.masks.astype(np.uint8).tobytes()
    yield "planes", scene.planes.astype("<i2").tobytes()
    for kind in KINDS:
        yield kind, getattr(r, kind).astype("<f4").tobytes()
    values = [value for layers in scene.networks.values() for layer in layers for value in layer]
    yield "weights", b"".join(v.astype("<f4").tobytes() for v in values)


def canonical_head(scene: Scene) -> bytes:
    """SPEC 9.3: returns the head of the canonical reconstruction."""
    d = scene.dimensions
    return DIGEST_MAGIC + struct.pack(
        "<5I", scene.anchor_count, d.offset_count, d.features, d.plane_channels, d.plane_size
    )


def digest(scene: Scene) -> tuple[str, dict[str, str]]:
    """SPEC 9.3: returns the SHA-256 of the whole, and that of each part but the head by name, in hexadecimal."""
    whole = hashlib.sha256(canonical_head(scene))
    parts = {}
    for name, data in canonical_parts(scene):
        whole.update(data)
        parts[name] = hashlib.sha256(data).hexdigest()
    return whole.hexdigest(), parts
