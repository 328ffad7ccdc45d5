"""Clause 9: the reconstruction of float32 values from integers, each rounded once, and the digests."""

from __future__ import annotations

import hashlib
import struct
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..native.library import Kernel, kernel
from ..native.scene import splats, values
from . import syntax
from .attributes import KINDS
from .batches import GROUP_ANCHORS
from .conventions import F32, f32_parts, round_to_f32
from .dimensions import RENDERING, STATIC, dimension_fields
from .header import render_fields
from .positions import position_integers
from .scene import Scene, take_anchors
from .splat import COLUMNS, HARMONICS, Rendering, derive_rendering, splat
from .tables import STEP_SHIFT, step_table

# SPEC 9.3: the first hashed bytes of the digests of a scene and of a chunk, and the parts of the reconstruction.
DIGEST_MAGIC = b"C3GSREC1"
CHUNK_MAGIC = b"C3GSCHK1"
PARTS = ("positions", "masks", "planes", "features", "scalings", "offsets", "weights")
SPLAT = "splat"
# Anchors whose Gaussians are computed at once, by all threads.
SPLAT_ANCHORS = 16384


def part_names(render_model: int) -> tuple[str, ...]:
    """SPEC 9.3: returns the names of the reconstruction parts of a scene, in their order."""
    return (*PARTS, SPLAT) if render_model == STATIC else PARTS


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
    grid, origin = scene.grid, np.array(scene.grid.origin, dtype=np.int64)
    positions = np.empty(scene.positions.shape, np.float32)
    # Blocks bound the memory for the integers.
    for first in range(0, len(positions), GROUP_ANCHORS):
        rows = slice(first, first + GROUP_ANCHORS)
        integers = origin + grid.scale_mantissa * position_integers(scene.positions[rows])
        positions[rows] = round_to_f32(integers, grid.scale_exponent - 24)
    return positions


def step_values(base_step: float) -> F32:
    """SPEC 9.2, STEP_VALUE: returns the steps of a kind at all step indices, float32 [64], each rounded once.

    base_step: a float32 value.
    """
    mantissa, exponent = f32_parts(base_step)
    return round_to_f32(step_table() * mantissa, exponent - STEP_SHIFT)


def dequantise(
    symbols: NDArray[np.int32], steps: NDArray[np.uint8], base_step: float, used: Kernel | None = None
) -> F32:
    """SPEC 9.2, VALUE: returns symbol * step, one float32 product each, float32 [n, ...].

    symbols: int32 [n, ...]. steps: uint8 [n], the step index of each anchor. base_step: a float32 value. used: the
    kernel, or None for NumPy.
    """
    table = step_values(base_step)
    if used is not None:
        return values(used, symbols, steps, table)
    step = table[steps].reshape(-1, *[1] * (symbols.ndim - 1))
    # A float32 holds each symbol exactly.
    return symbols.astype(np.float32) * step


def reconstruct(scene: Scene) -> Reconstruction:
    """SPEC 9.1 and 9.2: returns the float32 values of a scene. Raises UsageError as refcodec.native.library says."""
    a, used = scene.attributes, kernel()
    attributes = [dequantise(getattr(a, kind), a.steps[:, i], scene.base_step[i], used) for i, kind in enumerate(KINDS)]
    return Reconstruction(world_positions(scene), *attributes)


def _little(values: NDArray[Any], kind: str) -> bytes:
    return values.astype(kind).tobytes()


def canonical_parts(scene: Scene) -> Iterator[tuple[str, bytes]]:
    """SPEC 9.3: yields the name and the bytes of each part of the canonical reconstruction."""
    anchors = anchor_parts(scene, reconstruct(scene))
    for name in part_names(scene.render.render_model):
        if name == "planes":
            yield name, _little(scene.planes, "<i2")
        elif name == "weights":
            yield name, weight_part(scene)
        else:
            yield name, anchors[name]


def anchor_parts(scene: Scene, r: Reconstruction, rendering: Rendering | None = None) -> dict[str, bytes]:
    """SPEC 9.3: returns the bytes of a scene's anchors in each part that has anchors, by name.

    r: their values. rendering: as for gaussians.
    """
    parts = {
        "positions": _little(r.positions, "<f4"),
        "masks": _little(scene.masks, "u1"),
        **{kind: _little(getattr(r, kind), "<f4") for kind in KINDS},
    }
    if scene.render.render_model == STATIC:
        parts[SPLAT] = _little(gaussians(scene, r, rendering), "<f4")
    return parts


def gaussians(scene: Scene, r: Reconstruction | None = None, rendering: Rendering | None = None) -> F32:
    """SPEC 9.4: returns the Gaussians of a static scene, float32 [kept offsets, 11 + colour_outputs], see splat.py.

    r: the values of the scene, if known. rendering: the result of derive_rendering, if known.
    """
    drawn = np.empty((np.count_nonzero(scene.masks), HARMONICS.start + scene.dimensions.colour_outputs), np.float32)
    splat_to(scene, [drawn[:, own] for own in COLUMNS], r, rendering)
    return drawn


def splat_to(
    scene: Scene, to: Sequence[F32], r: Reconstruction | None = None, rendering: Rendering | None = None
) -> None:
    """SPEC 9.4: sets the Gaussians of a static scene. With the kernel, no values of anchors are kept.

    to: float32 [kept offsets, n] for each of COLUMNS: arrays, or columns of one. The rest is as for gaussians.
    """
    networks, used = derive_rendering(scene.networks) if rendering is None else rendering, kernel()
    if used is None and r is None:
        r = reconstruct(scene)

    def blocks() -> Iterator[list[NDArray[Any]]]:
        for first in range(0, scene.anchor_count, SPLAT_ANCHORS):
            rows = slice(first, first + SPLAT_ANCHORS)
            if r is None:
                some = take_anchors(scene, rows)
                yield [world_positions(some), some.masks, *vars(some.attributes).values()]
            else:
                positions, *others = (values[rows] for values in vars(r).values())
                yield [positions, scene.masks[rows], *others]

    if used is not None:
        layers = [(each.weight, each.bias, each.exponent) for name in RENDERING for each in networks[name].layers]
        return splats(used, layers, blocks(), to, None if r else np.stack([*map(step_values, scene.base_step)]))
    first = 0
    for positions, masks, features, scalings, offsets in blocks():
        drawn = splat(networks, positions, features, scalings, offsets, masks)
        for array, own in zip(to, COLUMNS, strict=True):
            array[first : first + len(drawn)] = drawn[:, own]
        first += len(drawn)
    return None


def weight_part(scene: Scene) -> bytes:
    """SPEC 9.3: returns the bytes of the part weights."""
    values = [value for layers in scene.networks.values() for layer in layers for value in layer]
    return b"".join(_little(value, "<f4") for value in values)


def canonical_head(scene: Scene, anchors: int | None = None) -> bytes:
    """SPEC 9.3: returns the hashed bytes of the scene's digest before the digests of the parts.

    anchors: N, or None if the scene has all anchors of the file.
    """
    count = scene.anchor_count if anchors is None else anchors
    render = syntax.build("RenderInfo", render_fields(scene.render))
    dimensions = syntax.build("Dimensions", dimension_fields(scene.dimensions))
    return DIGEST_MAGIC + struct.pack("<I", count) + render + dimensions


def digested(scene: Scene, parts: Iterable[tuple[str, bytes]] | None = None) -> bytes:
    """SPEC 9.3: returns the hashed bytes of a scene's digest: its head, and the parts' digests.

    parts: the result of canonical_parts, if known.
    """
    every = canonical_parts(scene) if parts is None else parts
    return canonical_head(scene) + b"".join(hashlib.sha256(data).digest() for _, data in every)


def digest(scene: Scene) -> tuple[str, dict[str, str]]:
    """SPEC 9.3: returns the digest of a scene, and the digest of each part by name, in hexadecimal."""
    data = digested(scene)
    head = len(canonical_head(scene))
    names = part_names(scene.render.render_model)
    parts = {name: data[head + 32 * i : head + 32 * i + 32].hex() for i, name in enumerate(names)}
    return hashlib.sha256(data).hexdigest(), parts


def chunk_digest(scene: Scene, parts: Mapping[str, bytes] | None = None) -> str:
    """SPEC 9.3: returns the digest of a chunk, in hexadecimal.

    scene: with only the chunk's anchors. parts: the result of anchor_parts or of StreamDigest.add, if known.
    """
    d = scene.dimensions
    whole = hashlib.sha256(CHUNK_MAGIC + struct.pack("<3I", scene.anchor_count, d.offset_count, d.features))
    for part in (anchor_parts(scene, reconstruct(scene)) if parts is None else parts).values():
        whole.update(part)
    return whole.hexdigest()


class StreamDigest:
    """SPEC 9.3: computes the digest of a scene in one pass over its chunks, in the memory of one chunk."""

    def __init__(self) -> None:
        self._count = 0
        self._parts = {name: hashlib.sha256() for name in (*PARTS, SPLAT)}
        self._rendering: Rendering | None = None

    def add(self, scene: Scene, values: Reconstruction | None = None) -> dict[str, bytes]:
        """Adds a chunk, and returns its parts (anchor_parts).

        scene: with only the chunk's anchors. values: the chunk's values, if known.
        """
        # All chunks have the same networks. Small chunks are decoded faster than these are derived.
        if scene.render.render_model == STATIC and self._rendering is None:
            self._rendering = derive_rendering(scene.networks)
        self._count += scene.anchor_count
        parts = anchor_parts(scene, values or reconstruct(scene), self._rendering)
        for name, data in parts.items():
            self._parts[name].update(data)
        return parts

    def finish(self, scene: Scene) -> str:
        """Returns the digest, in hexadecimal. scene: with the planes and weights; its anchors are not read."""
        return self.finish_parts(scene)[0]

    def finish_parts(self, scene: Scene) -> tuple[str, dict[str, str]]:
        """Returns the digest and the digest of each part, as `digest` does. scene: as for `finish`."""
        self._parts["planes"].update(_little(scene.planes, "<i2"))
        self._parts["weights"].update(weight_part(scene))
        head = canonical_head(scene, self._count)
        parts = {name: self._parts[name] for name in part_names(scene.render.render_model)}
        whole = hashlib.sha256(head + b"".join(part.digest() for part in parts.values())).hexdigest()
        return whole, {name: part.hexdigest() for name, part in parts.items()}
