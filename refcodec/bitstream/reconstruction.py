"""Reconstruction (SPEC.md chapter 9): from integers to float32 values, each rounded once, and the digest."""

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

# SPEC 9.3
DIGEST_MAGIC = b"C3GSREC0"
PARTS = ("positions", "masks", "planes", "features", "scalings", "offsets", "weights")


@dataclass(frozen=True, eq=False)
class Reconstruction:
    """Float32 values of a scene, world units: positions [N, 3]; features [N, F]; scalings [N, 6] (natural logarithms);
    offsets [N, K, 3], +0 where masked."""

    positions: F32
    features: F32
    scalings: F32
    offsets: F32


def world_positions(scene: Scene) -> F32:
    """SPEC 9.1."""
    grid = scene.grid
    integers = np.array(grid.origin, dtype=np.int64) + grid.scale_mantissa * position_integers(scene.positions)
    return round_to_f32(integers, grid.scale_exponent - 24)


def dequantise(symbols: NDArray[np.int32], steps: NDArray[np.uint8], base_step: float) -> F32:
    """SPEC 9.2: symbol * step, rounded once. symbols [n, ...], steps [n]."""
    mantissa, exponent = f32_parts(base_step)
    step = tables().step[steps].reshape(-1, *[1] * (symbols.ndim - 1))
    return round_to_f32(symbols.astype(np.int64) * step * mantissa, exponent - STEP_SHIFT)


def reconstruct(scene: Scene) -> Reconstruction:
    """SPEC 9.1 and 9.2."""
    a = scene.attributes
    values = [dequantise(getattr(a, kind), a.steps[:, i], scene.base_step[i]) for i, kind in enumerate(KINDS)]
    return Reconstruction(world_positions(scene), *values)


def canonical_parts(scene: Scene) -> Iterator[tuple[str, bytes]]:
    """SPEC 9.3: the canonical reconstruction, part by part."""
    r = reconstruct(scene)
    yield "positions", r.positions.astype("<f4").tobytes()
    yield "masks", scene.masks.astype(np.uint8).tobytes()
    yield "planes", scene.planes.astype("<i2").tobytes()
    for kind in KINDS:
        yield kind, getattr(r, kind).astype("<f4").tobytes()
    values = [value for layers in scene.networks.values() for layer in layers for value in layer]
    yield "weights", b"".join(v.astype("<f4").tobytes() for v in values)


def canonical_head(scene: Scene) -> bytes:
    """SPEC 9.3: the part before the others."""
    d = scene.dimensions
    return DIGEST_MAGIC + struct.pack(
        "<5I", scene.anchor_count, d.offset_count, d.features, d.plane_channels, d.plane_size
    )


def digest(scene: Scene) -> tuple[str, dict[str, str]]:
    """SPEC 9.3: the SHA-256 of the whole and of each part but the head, in hexadecimal."""
    whole = hashlib.sha256(canonical_head(scene))
    parts = {}
    for name, data in canonical_parts(scene):
        whole.update(data)
        parts[name] = hashlib.sha256(data).hexdigest()
    return whole.hexdigest(), parts
