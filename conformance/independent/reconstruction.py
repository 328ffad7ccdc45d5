"""Clause 9: reconstruction, to values, the canonical reconstruction and its digest."""

import hashlib
import struct
from collections.abc import Sequence
from typing import TYPE_CHECKING

from .conventions import STEP_SHIFT, f32_bits
from .header import Header
from .tables import load_tables

if TYPE_CHECKING:
    from .scene import Scene


# SPEC 9.1
def world_bits(header: Header, position: Sequence[int]) -> list[int]:
    """Return the world position of an anchor, as the bits of three f32. position: P of each axis."""
    scale, exponent = header["scale_mantissa"], header["scale_exponent"] - 24
    return [f32_bits(origin + scale * p, exponent) for origin, p in zip(header["origin"], position)]


# SPEC 9.2, STEP_VALUE
def step_values(base_step: float) -> list[float]:
    """Return the steps of a kind at all step indices, each rounded once to an f32."""
    # A product has 16 + 24 bits, which a binary64 holds. So the only rounding is that of pack.
    exact = [entry * base_step / (1 << STEP_SHIFT) for entry in load_tables().step]
    return list(struct.unpack(f"<{len(exact)}f", struct.pack(f"<{len(exact)}f", *exact)))


# SPEC 9.2, VALUE
def pack_values(symbols: Sequence[int], step: float) -> bytes:
    """Return the values of symbols as f32, each rounded once."""
    # A product has 23 + 24 bits, which a binary64 holds. So the only rounding is that of pack, ties to even.
    return struct.pack(f"<{len(symbols)}f", *[y * step for y in symbols])


# SPEC 9.3
def canonical_parts(scene: "Scene") -> dict[str, bytes]:
    """Return the parts of the canonical reconstruction by name, in their order."""
    header = scene.header
    f = header.features
    names = ("positions", "masks", "planes", "features", "scalings", "offsets")
    parts = {name: bytearray() for name in names}
    for plane in scene.planes:
        for channel in plane:
            for row in channel:
                parts["planes"] += struct.pack(f"<{len(row)}h", *row)
    steps = [step_values(base_step) for base_step in header["base_step"]]
    kinds = (("features", 0, f), ("scalings", f, f + 6), ("offsets", f + 6, header.channels))
    for chunk in scene.chunks:
        for position, mask, symbols, own in zip(chunk.positions, chunk.masks, chunk.symbols, chunk.steps):
            parts["positions"] += struct.pack("<3I", *world_bits(header, position))
            parts["masks"] += bytes(mask)
            for (name, first, end), table, step in zip(kinds, steps, own):
                parts[name] += pack_values(symbols[first:end], table[step])
    return {**{name: bytes(part) for name, part in parts.items()}, "weights": scene.weights.raw}


# SPEC 9.3
def digested(scene: "Scene", parts: dict[str, bytes]) -> bytes:
    """Return the bytes that the digest of the scene is of. parts: what canonical_parts returns."""
    header = scene.header
    counts = (header["anchor_count"], header["offset_count"], header.features)
    head = struct.pack("<8s5I", b"C3GSREC1", *counts, header["plane_channels"], header["plane_size"])
    return head + b"".join(hashlib.sha256(part).digest() for part in parts.values())


# SPEC 9.3
def digests(scene: "Scene") -> dict[str, str]:
    """Return the digest of the scene, as `whole`, and that of each part, by name."""
    parts = canonical_parts(scene)
    out = {"whole": hashlib.sha256(digested(scene, parts)).hexdigest()}
    out.update((name, hashlib.sha256(part).hexdigest()) for name, part in parts.items())
    return out


# SPEC 9.3
def digest(scene: "Scene") -> str:
    """Return the digest of the scene."""
    return digests(scene)["whole"]
