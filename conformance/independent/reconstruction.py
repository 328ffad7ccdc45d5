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


# SPEC 9.2
def value_bits(symbols: Sequence[int], step_index: int, base_step: float) -> list[int]:
    """Return the values of an anchor's symbols of one kind, as the bits of f32."""
    numerator, denominator = base_step.as_integer_ratio()
    unit = load_tables().step[step_index] * numerator
    exponent = 1 - denominator.bit_length() - STEP_SHIFT
    return [f32_bits(y * unit, exponent) for y in symbols]


# SPEC 9.3
def canonical_parts(scene: "Scene") -> dict[str, bytes]:
    """Return the parts of the canonical reconstruction by name, in their order, with the head."""
    header = scene.header
    f = header.features
    dimensions = (header[name] for name in ("plane_channels", "plane_size"))
    head = struct.pack("<8s5I", b"C3GSREC0", header["anchor_count"], header["offset_count"], f, *dimensions)
    names = ("positions", "masks", "planes", "features", "scalings", "offsets")
    parts = {name: bytearray() for name in names}
    for plane in scene.planes:
        for channel in plane:
            for row in channel:
                parts["planes"] += struct.pack(f"<{len(row)}h", *row)
    kinds = (("features", 0, f), ("scalings", f, f + 6), ("offsets", f + 6, header.channels))
    for chunk in scene.chunks:
        for position, mask, symbols, steps in zip(chunk.positions, chunk.masks, chunk.symbols, chunk.steps):
            parts["positions"] += struct.pack("<3I", *world_bits(header, position))
            parts["masks"] += bytes(mask)
            for (name, first, end), step, base_step in zip(kinds, steps, header["base_step"]):
                parts[name] += struct.pack(f"<{end - first}I", *value_bits(symbols[first:end], step, base_step))
    return {"head": head, **{name: bytes(part) for name, part in parts.items()}, "weights": scene.weights.raw}


# SPEC 9.3
def digests(scene: "Scene") -> dict[str, str]:
    """Return the digest of the scene, as `whole`, and that of each part but the head, by name."""
    parts = canonical_parts(scene)
    out = {"whole": hashlib.sha256(b"".join(parts.values())).hexdigest()}
    out.update((name, hashlib.sha256(part).hexdigest()) for name, part in parts.items() if name != "head")
    return out


# SPEC 9.3
def digest(scene: "Scene") -> str:
    """Return the digest of the scene."""
    return digests(scene)["whole"]
