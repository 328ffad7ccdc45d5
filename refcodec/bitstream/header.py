"""Clauses 5.1 to 5.5 and 6.1 to 6.5: the prologue and the header."""

import zlib
from dataclasses import dataclass, fields, replace
from typing import Any

import construct as cs
import numpy as np

from . import syntax
from .dimensions import Dimensions, dimension_fields, dimensions_of, work
from .directory import DATA, Section, parse_directory
from .errors import BitstreamError
from .limits import MAIN, PROFILES, TINY, dimension_fault, minimal_level
from .source import Piece, Source, padded

# SPEC 6.1. The major version stands here, and `python -m spec` writes it wherever else it is stated.
SIGNATURE = b"\x89C3GS\r\n\x1a"
MAJOR, MINOR = 0, 0
PROLOGUE_BYTES = syntax.size_of("Prologue")
HEADER_LENGTH_MIN, HEADER_LENGTH_MAX = 4, 65532
CRC_BYTES = 4
# SPEC 6.2
LANES_LOG2_MAX = 8
BASE_STEP_MIN, BASE_STEP_MAX = 2.0**-60, 2.0**60
# SPEC 6.4
ORIGIN_BOUND = 1 << 62
SCALE_EXPONENT_MAX = 60
# SPEC [R6.5-1]: a limit near 1 would show the background through opaque Gaussians, where blending stops (14.5).
ALPHA_LIMIT = 0x3F7D70A4
ALPHA_MOST = float(np.uint32(ALPHA_LIMIT).view(np.float32))


@dataclass(frozen=True)
class Lanes:
    """SPEC 6.2: the base-2 logarithms of the numbers of lanes of plane, mask and attribute substreams."""

    plane: int = 3
    mask: int = 3
    attribute: int = 5


@dataclass(frozen=True)
class PositionGrid:
    """SPEC 6.4: P represents the world position (origin + scale_mantissa * P) * 2^(scale_exponent - 24)."""

    origin: tuple[int, int, int] = (0, 0, 0)
    scale_mantissa: int = 1
    scale_exponent: int = 0


@dataclass(frozen=True)
class RenderInfo:
    """SPEC 5.5 and 6.5: the parameters of a scene for renderers.

    background: red, green and blue, 0 to 255.
    up_axis: 0 to 5 if +x, -x, +y, -y, +z or -z points up.
    near_plane, distance_unit: world units.
    low_pass: square pixels.
    colour_primaries, transfer_characteristics: code points of ITU-T H.273. 1 and 13 are BT.709 and sRGB.
    render_model: how the scene is drawn. 0: view-dependent (14.3), 1: static (9.4, 14.6).
    """

    background: tuple[int, int, int] = (0, 0, 0)
    up_axis: int = 3
    near_plane: float = float(np.float32(0.2))
    distance_unit: float = 1.0
    alpha_max: float = ALPHA_MOST
    low_pass: float = float(np.float32(0.3))
    colour_primaries: int = 1
    transfer_characteristics: int = 13
    render_model: int = 0


def render_fields(render: RenderInfo) -> dict[str, Any]:
    """SPEC 5.5: returns the fields of the struct, by name."""
    return {**vars(render), "reserved": 0}


@dataclass(frozen=True, kw_only=True)
class Header:
    """SPEC 6.2: the values of a header.

    minor: the minor version of the file.
    chunk_count: C. chunk_size: the most anchors of a chunk.
    later: the bytes of fields that a later minor version added.
    sections: in file order, or empty if the directory has not been read yet.
    """

    minor: int
    profile: int
    level: int
    anchor_count: int
    chunk_count: int
    chunk_size: int
    lanes: Lanes
    base_step: tuple[float, float, float]
    grid: PositionGrid
    render: RenderInfo
    dimensions: Dimensions
    later: bytes = b""
    sections: tuple[Section, ...] = ()

    def section(self, kind: bytes) -> Section:
        """Returns the critical section of a type. Raises KeyError if the file has none."""
        return {section.type: section for section in self.sections}[kind]


# --- prologue ---------------------------------------------------------------------------------------------------------


def parse_prologue(data: bytes) -> tuple[int, int]:
    """SPEC 5.1 and 6.1: checks the prologue and returns minor and header_length. Raises BitstreamError 101 to 105.

    data: the first 20 bytes of the file, or all bytes of a shorter file.
    """
    # SPEC [R6.1-1]
    if len(data) < PROLOGUE_BYTES:
        content = f"{len(data)} bytes"
        raise BitstreamError("prologue.truncated", len(data), "prologue", content, f"at least {PROLOGUE_BYTES}")
    prologue = syntax.Struct("Prologue", Piece(data[:PROLOGUE_BYTES], 0), 0, "prologue")
    p = prologue.fields
    # SPEC [R6.1-2]
    if p.signature != SIGNATURE:
        hint = " (changed in transfer, as text or by 7-bit mail?)" if p.signature[1:4] == SIGNATURE[1:4] else ""
        content = p.signature.hex(" ") + hint
        raise prologue.error("prologue.signature", "signature", content, SIGNATURE.hex(" "))
    # SPEC [R6.1-3]: the CRC-32 comes before the version, because damage could have changed the version.
    crc = zlib.crc32(data[: PROLOGUE_BYTES - CRC_BYTES])
    if p.prologue_crc != crc:
        raise prologue.error("prologue.crc", "prologue_crc", f"0x{p.prologue_crc:08x}", f"0x{crc:08x}")
    # SPEC [R6.1-4]: later minor versions are read (12.3).
    if p.major != MAJOR:
        raise prologue.error("prologue.version", "major", p.major, MAJOR)
    # SPEC [R6.1-5]
    length = int(p.header_length)
    if not HEADER_LENGTH_MIN <= length <= HEADER_LENGTH_MAX or length % 4:
        allowed = f"a multiple of 4 from {HEADER_LENGTH_MIN} to {HEADER_LENGTH_MAX}"
        raise prologue.error("prologue.header_length", "header_length", length, allowed)
    return int(p.minor), length


def restamped(data: bytes, major: int = MAJOR) -> bytes:
    """SPEC 5.1: returns a file with another major version and the CRC-32 of its prologue. Nothing else changes."""
    start = data[: len(SIGNATURE)] + major.to_bytes(2, "little") + data[10 : PROLOGUE_BYTES - CRC_BYTES]
    return start + zlib.crc32(start).to_bytes(CRC_BYTES, "little") + data[PROLOGUE_BYTES:]


# --- header -----------------------------------------------------------------------------------------------------------


def read_header(source: Source) -> Header:
    """SPEC 10.1, PROLOGUE to DIRECTORY: reads and checks the prologue, the header and the directory.

    Raises BitstreamError 101 to 305.
    """
    prologue = source.read(0, PROLOGUE_BYTES)
    minor, header_length = parse_prologue(prologue)
    header, struct = parse_header(prologue + source.read(PROLOGUE_BYTES, header_length), minor, header_length)
    sections = parse_directory(struct, header.dimensions, PROLOGUE_BYTES + header_length)
    return replace(header, sections=sections)


def parse_header(data: bytes, minor: int, header_length: int) -> tuple[Header, syntax.Struct]:
    """SPEC 5.2 to 5.5 and 6.2 to 6.5: checks the header, and returns its values and its struct.

    data: the file up to the end of the header, or a shorter file. minor, header_length: from the prologue.

    The values omit the directory. The struct has its entries, of which only the reserved fields are checked.
    Raises BitstreamError 201 to 217, in the order of SPEC 10.1.
    """
    end = PROLOGUE_BYTES + header_length
    # SPEC [R6.2-1]
    if len(data) < end:
        raise BitstreamError("header.truncated", len(data), "header", f"{len(data)} bytes", f"at least {end}")
    # SPEC [R6.2-2]
    stored = int.from_bytes(data[end - CRC_BYTES : end], "little")
    crc = zlib.crc32(data[PROLOGUE_BYTES : end - CRC_BYTES])
    if stored != crc:
        raise BitstreamError("header.crc", end - CRC_BYTES, "header.header_crc", f"0x{stored:08x}", f"0x{crc:08x}")
    # SPEC [R6.2-3]
    try:
        header = syntax.Struct("Header", Piece(data[:end], 0), PROLOGUE_BYTES, "header")
    except cs.ConstructError:
        allowed = f"what {header_length} bytes hold"
        raise BitstreamError("header.syntax", end, "header", "more fields", allowed) from None
    # The CRC-32 is the last field. Unused bytes lie before it.
    known = PROLOGUE_BYTES + header.size - CRC_BYTES
    if header.size != header_length and minor <= MINOR:
        allowed = f"the {header.size} that its fields take"
        raise BitstreamError("header.syntax", known, "header", f"{header_length} bytes", allowed)
    return _checked(header, minor, data[known : end - CRC_BYTES]), header


def _checked(header: syntax.Struct, minor: int, later: bytes) -> Header:
    """SPEC 10.1: checks padding and reserved fields ([R6.2-4], [R6.2-5]), then the other fields (FIELDS)."""
    h = header.fields
    # SPEC [R6.2-4]
    if any(h.dimensions.padding):
        raise header.error("header.padding", "dimensions.padding", h.dimensions.padding.hex(" "), "zeros")
    # SPEC [R6.2-5]
    for field, value in (
        ("reserved", h.reserved),
        ("position_grid.reserved", h.position_grid.reserved),
        ("render_info.reserved", h.render_info.reserved),
        ("dimensions.reserved", h.dimensions.reserved),
        *((f"directory[{i}].reserved", list(entry.reserved)) for i, entry in enumerate(h.directory)),
    ):
        if any(value) if isinstance(value, list) else value:
            raise header.error("header.reserved", field, value, 0)
    dimensions = _checked_limits(header)
    # SPEC [R6.2-6]
    for field in ("plane_lanes_log2", "mask_lanes_log2", "attribute_lanes_log2"):
        header.require_within("header.lanes", field, h[field], 0, LANES_LOG2_MAX)
    # SPEC [R6.2-7]
    for i, step in enumerate(h.base_step):
        header.require_within("header.base_step", f"base_step[{i}]", step, BASE_STEP_MIN, BASE_STEP_MAX)
    grid, render = _checked_grid(header), _checked_render(header)
    # SPEC [R11.2-3]
    needed, level = work(dimensions, h.anchor_count), PROFILES[h.profile].levels[h.level]
    if needed > level.work:
        raise header.error("header.work", "anchor_count", f"work of {needed}", f"at most {level.work}")
    # SPEC [R6.2-8]
    least = -(-h.anchor_count // h.chunk_size)
    header.require_within("header.chunk_count", "chunk_count", h.chunk_count, least, h.anchor_count)
    return Header(
        minor=minor,
        profile=h.profile,
        level=h.level,
        anchor_count=h.anchor_count,
        chunk_count=h.chunk_count,
        chunk_size=h.chunk_size,
        lanes=Lanes(h.plane_lanes_log2, h.mask_lanes_log2, h.attribute_lanes_log2),
        base_step=tuple(h.base_step),
        grid=grid,
        render=render,
        dimensions=dimensions,
        later=later,
    )


def _checked_limits(header: syntax.Struct) -> Dimensions:
    """SPEC 11.1 and 11.2: checks profile, level, dimensions and the counts that these limit."""
    h = header.fields
    # SPEC [R11.1-1]
    if h.profile not in PROFILES:
        raise header.error("header.profile", "profile", h.profile, f"{TINY} (Tiny) or {MAIN} (Main)")
    profile = PROFILES[h.profile]
    # SPEC [R11.2-1]
    if h.level not in profile.levels:
        known = " or ".join(map(str, sorted(profile.levels)))
        raise header.error("header.level", "level", h.level, f"in {profile.name} {known}")
    level = profile.levels[h.level]
    # SPEC [R11.1-2]: the bounds of the profile come before the bound of the level.
    dimensions = dimensions_of(h.dimensions)
    fault = dimension_fault(profile, dimensions, h.render_info.render_model)
    if fault:
        raise header.error("header.dimension", f"dimensions.{fault[0]}", *fault[1:])
    if dimensions.plane_size > level.plane_size:
        allowed = f"at level {h.level} at most {level.plane_size}"
        raise header.error("header.dimension", "dimensions.plane_size", dimensions.plane_size, allowed)
    # SPEC [R11.2-2]
    header.require_within("header.anchor_count", "anchor_count", h.anchor_count, 0, level.anchors)
    # SPEC [R11.2-4]: a file whose work exceeds all levels has the error of its work.
    lowest = minimal_level(profile, h.anchor_count, dimensions)
    if lowest is not None and lowest < h.level:
        raise header.error("header.level_not_minimal", "level", h.level, lowest)
    # SPEC [R11.1-3]
    header.require_within("header.chunk_size", "chunk_size", h.chunk_size, *profile.chunk_size)
    return dimensions


def _checked_grid(header: syntax.Struct) -> PositionGrid:
    """SPEC [R6.4-1]: checks the position grid."""
    name, g = "header.position_grid", header.fields.position_grid
    for i, origin in enumerate(g.origin):
        header.require_within(name, f"position_grid.origin[{i}]", origin, 1 - ORIGIN_BOUND, ORIGIN_BOUND - 1)
    header.require_within(name, "position_grid.scale_mantissa", g.scale_mantissa, 1, 65535)
    exponent = "position_grid.scale_exponent"
    header.require_within(name, exponent, g.scale_exponent, -SCALE_EXPONENT_MAX, SCALE_EXPONENT_MAX)
    return PositionGrid(tuple(g.origin), g.scale_mantissa, g.scale_exponent)


def _checked_render(header: syntax.Struct) -> RenderInfo:
    """SPEC [R6.5-1]: checks the render information in the order of the requirement."""
    name, r = "header.render_info", header.fields.render_info

    def field(own: str) -> str:
        return f"render_info.{own}"

    header.require_within(name, field("up_axis"), r.up_axis, 0, 5)
    for scalar in ("near_plane", "distance_unit", "alpha_max", "low_pass"):
        header.require_finite(name, field(scalar), [r[scalar]])
    for scalar in ("near_plane", "distance_unit"):
        if r[scalar] <= 0:
            raise header.error(name, field(scalar), r[scalar], "more than 0")
    if not 0 < r.alpha_max <= ALPHA_MOST:
        raise header.error(name, field("alpha_max"), r.alpha_max, "more than 0 and at most 0.99")
    if r.low_pass < 0:
        raise header.error(name, field("low_pass"), r.low_pass, "at least 0")
    return RenderInfo(**{own.name: r[own.name] for own in fields(RenderInfo)} | {"background": tuple(r.background)})


# --- writing ----------------------------------------------------------------------------------------------------------


def emit_file(header: Header, sections: list[tuple[bytes, int, bytes]]) -> bytes:
    """SPEC 5.1 to 5.6: returns the file of a header and of sections (type, mode, bytes) in file order.

    The directory is built from the sections. header.sections is ignored.
    """
    values: dict[str, Any] = {
        "profile": header.profile,
        "level": header.level,
        "section_count": len(sections),
        "anchor_count": header.anchor_count,
        "chunk_count": header.chunk_count,
        "chunk_size": header.chunk_size,
        "plane_lanes_log2": header.lanes.plane,
        "mask_lanes_log2": header.lanes.mask,
        "attribute_lanes_log2": header.lanes.attribute,
        "reserved": 0,
        "base_step": header.base_step,
        "position_grid": {**vars(header.grid), "reserved": 0},
        "render_info": render_fields(header.render),
        "dimensions": dimension_fields(header.dimensions),
        # SPEC 5.6: the chunks of DATA have CRC-32s of their own.
        "directory": [
            {
                "type": kind,
                "mode": mode,
                "reserved": [0, 0, 0],
                "length": len(content),
                "crc": 0 if kind == DATA else zlib.crc32(content),
            }
            for kind, mode, content in sections
        ],
        "header_crc": 0,
    }
    bare = syntax.build("Header", values)[:-CRC_BYTES] + header.later
    prologue = syntax.build(
        "Prologue",
        {
            "signature": SIGNATURE,
            "major": MAJOR,
            "minor": header.minor,
            "header_length": len(bare) + CRC_BYTES,
            "prologue_crc": 0,
        },
    )[:-CRC_BYTES]
    parts = [part for whole in (prologue, bare) for part in (whole, zlib.crc32(whole).to_bytes(CRC_BYTES, "little"))]
    return b"".join([*parts, *(padded(content) for _, _, content in sections)])
