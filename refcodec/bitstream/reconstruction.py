"""Clause 9: the reconstruction of float32 values from integers, each rounded once, and the digests."""

import hashlib
import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby
from operator import itemgetter
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
from .splat import COLUMNS, HARMONICS, SPLAT_ANCHORS, Rendering, derive_rendering, splat
from .tables import STEP_SHIFT, step_table

# SPEC 9.3: the first hashed bytes of the digests of a scene, of one whose header has bytes of a later version, and of a
# chunk; and the parts of the reconstruction.
DIGEST_MAGIC, LATER_MAGIC = b"C3GSREC1", b"C3GSREC2"
CHUNK_MAGIC = b"C3GSCHK1"
PARTS = ("positions", "masks", "planes", "features", "scalings", "offsets", "weights")
SPLAT = "splat"
# Anchors of a piece of a part that is hashed or written.
PIECE_ANCHORS = 4096


def part_names(render_model: int) -> tuple[str, ...]:
    """SPEC 9.3: returns the names of the reconstruction parts of a scene, in their order."""
    return (*PARTS, SPLAT) if render_model == STATIC else PARTS


def anchor_parts(render_model: int) -> tuple[str, ...]:
    """SPEC 9.3: returns the names of the parts that have anchors, in their order."""
    return tuple(name for name in part_names(render_model) if name not in ("planes", "weights"))


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
    return Reconstruction(world_positions(scene), *(attribute_values(scene, i) for i in range(len(KINDS))))


def attribute_values(scene: Scene, i: int) -> F32:
    """SPEC 9.2: returns the values of a kind of KINDS, float32 [N, ...]. Raises as reconstruct."""
    a = scene.attributes
    return dequantise(getattr(a, KINDS[i]), a.steps[:, i], scene.base_step[i], kernel())


def _little(values: NDArray[Any], kind: str) -> bytes | memoryview:
    """Returns the bytes of an array, without a copy where it has them."""
    return np.ascontiguousarray(values, kind).reshape(-1).view(np.uint8).data


def pieces(scene: Scene) -> Iterator[tuple[str, bytes | memoryview]]:
    """SPEC 9.3: yields the name and the bytes of each part of the canonical reconstruction, in order and in pieces.

    Only a piece is held.
    """
    for name in part_names(scene.render.render_model):
        if name == "planes":
            yield name, _little(scene.planes, "<i2")
        elif name == "weights":
            yield name, weight_part(scene)
        else:
            yield from ((name, piece) for piece in anchor_pieces(scene, name))


def anchor_pieces(scene: Scene, name: str, rendering: Rendering | None = None) -> Iterator[bytes | memoryview]:
    """SPEC 9.3: yields the bytes of a part that has anchors, in pieces. rendering: as for gaussians."""
    if name == SPLAT and rendering is None:
        rendering = derive_rendering(scene.networks)
    for first in range(0, scene.anchor_count, PIECE_ANCHORS):
        some = take_anchors(scene, slice(first, first + PIECE_ANCHORS))
        if name == "masks":
            yield _little(some.masks, "u1")
        elif name == SPLAT:
            yield _little(gaussians(some, rendering), "<f4")
        elif name == "positions":
            yield _little(world_positions(some), "<f4")
        else:
            yield _little(attribute_values(some, KINDS.index(name)), "<f4")


def canonical_parts(scene: Scene) -> Iterator[tuple[str, bytes]]:
    """SPEC 9.3: yields the name and the bytes of each part of the canonical reconstruction."""
    for name, own in groupby(pieces(scene), key=itemgetter(0)):
        yield name, b"".join(piece for _, piece in own)


def gaussians(scene: Scene, rendering: Rendering | None = None) -> F32:
    """SPEC 9.4: returns the Gaussians of a static scene, float32 [kept offsets, 11 + colour_outputs], see splat.py.

    rendering: the result of derive_rendering, if known.
    """
    drawn = np.empty((np.count_nonzero(scene.masks), HARMONICS.start + scene.dimensions.colour_outputs), np.float32)
    splat_to(scene, [drawn[:, own] for own in COLUMNS], rendering)
    return drawn


def splat_to(scene: Scene, to: Sequence[F32], rendering: Rendering | None = None) -> None:
    """SPEC 9.4: sets the Gaussians of a static scene. With the kernel, no values of anchors are kept.

    to: float32 [kept offsets, n] for each of COLUMNS: arrays, or columns of one. rendering: as for gaussians.
    """
    networks, used = derive_rendering(scene.networks) if rendering is None else rendering, kernel()
    rows = range(0, scene.anchor_count, SPLAT_ANCHORS)
    parts = (take_anchors(scene, slice(first, first + SPLAT_ANCHORS)) for first in rows)
    if used is not None:
        layers = [(each.weight, each.bias, each.exponent) for name in RENDERING for each in networks[name].layers]
        blocks = ([world_positions(some), some.masks, *vars(some.attributes).values()] for some in parts)
        return splats(used, layers, blocks, to, np.stack([*map(step_values, scene.base_step)]))
    first = 0
    for some in parts:
        r = reconstruct(some)
        drawn = splat(networks, r.positions, r.features, r.scalings, r.offsets, some.masks)
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
    later = hashlib.sha256(scene.later).digest() if scene.later else b""
    magic = LATER_MAGIC if later else DIGEST_MAGIC
    return magic + struct.pack("<I", count) + render + dimensions + later


def digested(scene: Scene) -> bytes:
    """SPEC 9.3: returns the hashed bytes of a scene's digest: its head, and the parts' digests."""
    own = {name: hashlib.sha256() for name in part_names(scene.render.render_model)}
    for name, piece in pieces(scene):
        own[name].update(piece)
    return canonical_head(scene) + b"".join(part.digest() for part in own.values())


def digest(scene: Scene) -> tuple[str, dict[str, str]]:
    """SPEC 9.3: returns the digest of a scene, and the digest of each part by name, in hexadecimal."""
    data = digested(scene)
    head = len(canonical_head(scene))
    names = part_names(scene.render.render_model)
    parts = {name: data[head + 32 * i : head + 32 * i + 32].hex() for i, name in enumerate(names)}
    return hashlib.sha256(data).hexdigest(), parts


def chunk_digest(scene: Scene) -> str:
    """SPEC 9.3: returns the digest of a chunk, in hexadecimal. scene: with only the chunk's anchors."""
    d = scene.dimensions
    whole = hashlib.sha256(CHUNK_MAGIC + struct.pack("<3I", scene.anchor_count, d.offset_count, d.features))
    for name in anchor_parts(scene.render.render_model):
        for piece in anchor_pieces(scene, name):
            whole.update(piece)
    return whole.hexdigest()


class StreamDigest:
    """SPEC 9.3: computes the digest of a scene in one pass over its chunks, in the memory of one chunk."""

    def __init__(self) -> None:
        self._count = 0
        self._parts = {name: hashlib.sha256() for name in (*PARTS, SPLAT)}
        self._rendering: Rendering | None = None

    def add(self, scene: Scene) -> None:
        """Adds a chunk. scene: with only the chunk's anchors."""
        # All chunks have the same networks. Small chunks are decoded faster than these are derived.
        if scene.render.render_model == STATIC and self._rendering is None:
            self._rendering = derive_rendering(scene.networks)
        self._count += scene.anchor_count
        for name in anchor_parts(scene.render.render_model):
            for piece in anchor_pieces(scene, name, self._rendering):
                self._parts[name].update(piece)

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
