"""Container (SPEC.md 5.1 to 5.6, 6.1 to 6.6): prologue, header and directory, in the order of checks of SPEC 10.1."""

from __future__ import annotations

import math
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import construct as cs

from . import syntax
from .errors import BitstreamError
from .limits import MAIN, PROFILES, TINY, dimension_fault, minimal_level
from .masks import context_count
from .scene import Dimensions, Lanes, PositionGrid, RenderInfo, Scene

# SPEC 6.1
SIGNATURE = b"\x89C3G\r\n\x1a\n"
VERSION = 0
PROLOGUE_BYTES = 20
HEADER_LENGTH_MIN, HEADER_LENGTH_MAX = 4, 65535
# SPEC 6.2
LANES_LOG2_MAX = 8
BASE_STEP_MIN, BASE_STEP_MAX = 2.0**-60, 2.0**60
# SPEC 6.4
ORIGIN_BOUND = 1 << 62
SCALE_EXPONENT_MAX = 60
# SPEC 6.6: the sections, in file order; bit 7 of a type says that it is critical.
CRITICAL = 0x80
SECTIONS = {
    0x81: "frame",
    0x82: "weights",
    0x83: "planes",
    0x84: "chunk_table",
    0x85: "positions",
    0x86: "masks",
    0x87: "attributes",
}
FRAME, WEIGHTS, PLANES_SECTION, CHUNK_TABLE, POSITIONS, MASKS, ATTRIBUTES = SECTIONS
CHUNKED = (POSITIONS, MASKS, ATTRIBUTES)
# SPEC 6.6: the highest mode of each section that has more than mode 0.
MODES = {WEIGHTS: 1, POSITIONS: 1}
# SPEC 5.10, 5.11: bytes of a chunk's entry, of an anchor's position.
CHUNK_ENTRY_BYTES = 24
POSITION_BYTES = 6
# SPEC 6.10: most anchors for each byte of a chunk's positions in mode 1.
ANCHORS_OF_A_BYTE = 16


@dataclass(frozen=True)
class Section:
    """One directory entry: type, mode and where the section lies in the file."""

    type: int
    mode: int
    start: int
    end: int

    @property
    def name(self) -> str:
        return SECTIONS.get(self.type, f"extension_{self.type:02x}")


@dataclass(frozen=True)
class Header:
    """The header in the scene's terms (SPEC 6.2), and the sections by type."""

    profile: int
    level: int
    anchor_count: int
    chunk_size: int
    lanes: Lanes
    dimensions: Dimensions
    base_step: tuple[float, float, float]
    grid: PositionGrid
    render: RenderInfo
    sections: dict[int, Section]

    @property
    def chunks(self) -> list[range]:
        """SPEC 6.10: the anchors of each chunk."""
        return chunk_ranges(self.anchor_count, self.chunk_size)


def chunk_ranges(anchor_count: int, chunk_size: int) -> list[range]:
    """SPEC 6.10: ceil(N / chunk_size) chunks; the last one may be shorter."""
    return [range(a, min(a + chunk_size, anchor_count)) for a in range(0, anchor_count, chunk_size)]


def weight_count(dimensions: Dimensions) -> int:
    """SPEC 5.8: fp32 values in the weights section."""
    return sum(out * (fan_in + 1) for layers in dimensions.network_shapes().values() for out, fan_in in layers)


def parse_prologue(data: bytes) -> int:
    """SPEC 5.1 and 6.1. Returns header_length. Raises BitstreamError 101 to 105."""
    if len(data) < PROLOGUE_BYTES:
        raise BitstreamError("prologue.truncated", len(data), "prologue", f"{len(data)} bytes", f"at least {PROLOGUE_BYTES}")
    p, _ = syntax.parse("Prologue", data[:PROLOGUE_BYTES])
    if p.signature != SIGNATURE:
        raise BitstreamError("prologue.signature", 0, "prologue.signature", _signature_text(p.signature), SIGNATURE.hex(" "))
    crc = zlib.crc32(data[: PROLOGUE_BYTES - 4])
    if p.prologue_crc != crc:
        raise BitstreamError("prologue.crc", 16, "prologue.prologue_crc", f"0x{p.prologue_crc:08x}", f"0x{crc:08x}")
    if p.version != VERSION:
        raise BitstreamError("prologue.version", 8, "prologue.version", p.version, VERSION)
    if not HEADER_LENGTH_MIN <= p.header_length <= HEADER_LENGTH_MAX:
        allowed = f"{HEADER_LENGTH_MIN} to {HEADER_LENGTH_MAX}"
        raise BitstreamError("prologue.header_length", 12, "prologue.header_length", p.header_length, allowed)
    return int(p.header_length)


def _signature_text(found: bytes) -> str:
    hint = " (changed in transfer, as text or by 7-bit mail?)" if found[1:4] == SIGNATURE[1:4] else ""
    return found.hex(" ") + hint


class _HeaderCheck:
    """Raises with the offset of a header field."""

    def __init__(self, data: bytes) -> None:
        self.data = data

    def fail(self, name: str, field: str, found: object, allowed: object) -> BitstreamError:
        path = f"header.{field}"
        for element in syntax.parse_elements("Header", self.data, PROLOGUE_BYTES, "header"):
            if element.path == path or element.path.startswith((path + "[", path + ".")):
                return BitstreamError(name, element.start, path, found, allowed)
        raise AssertionError(path)

    def finite(self, name: str, field: str, values: Sequence[float]) -> None:
        if not all(math.isfinite(v) for v in values):
            raise self.fail(name, field, ", ".join(map(str, values)), "finite numbers")

    def within(self, name: str, field: str, value: float, low: float, high: float) -> None:
        if not low <= value <= high:
            raise self.fail(name, field, value, f"{low} to {high}")


def parse_container(data: bytes, keep_going: bool = False) -> Header:
    """SPEC 10.1, stages 1 to 3: prologue, header, directory and the sections' CRC-32s.

    keep_going: a file cut within its chunked sections, and damage inside them, is left to the chunks' own checks.
    """
    header_length = parse_prologue(data)
    end = PROLOGUE_BYTES + header_length
    if len(data) < end:
        raise BitstreamError("header.truncated", len(data), "header", f"{len(data)} bytes", f"at least {end}")
    stored = int.from_bytes(data[end - 4 : end], "little")
    crc = zlib.crc32(data[PROLOGUE_BYTES : end - 4])
    if stored != crc:
        raise BitstreamError("header.crc", end - 4, "header.header_crc", f"0x{stored:08x}", f"0x{crc:08x}")
    try:
        h, size = syntax.parse("Header", data[:end], PROLOGUE_BYTES)
    except cs.ConstructError:
        raise BitstreamError("header.syntax", end, "header", "more fields", f"what {header_length} bytes hold") from None
    if size != header_length:
        # SPEC 6.2: the CRC-32 is at the header's end, so what no field uses is before it.
        raise BitstreamError(
            "header.syntax", PROLOGUE_BYTES + size - 4, "header", f"{header_length} bytes", f"the {size} that its fields take"
        )
    header = _check_header(h, _HeaderCheck(data[:end]))
    _check_directory(h, header, _HeaderCheck(data[:end]), data, end, keep_going)
    return header


def dimensions_of(d: Any) -> Dimensions:
    """SPEC 5.3, as parsed, in the scene's terms; not checked."""
    return Dimensions(
        d.offset_count,
        tuple(d.slice_width),
        d.plane_channels,
        d.frequency_count,
        d.plane_size,
        tuple(d.hyper_width),
        tuple(d.sarm_width),
        tuple(d.carm_width),
        d.render_width,
    )


def _check_header(h: Any, check: _HeaderCheck) -> Header:
    """SPEC 10.1, stage 2: the header's rules in the order of their codes."""
    entries = [(f"directory[{i}].reserved", e.reserved) for i, e in enumerate(h.directory)]
    for field, value in [
        ("reserved_0", h.reserved_0),
        ("reserved_1", h.reserved_1),
        ("position_grid.reserved", h.position_grid.reserved),
        *entries,
    ]:
        if value:
            raise check.fail("header.reserved", field, value, 0)
    if h.profile not in PROFILES:
        raise check.fail("header.profile", "profile", h.profile, f"{TINY} (Tiny) or {MAIN} (Main)")
    profile = PROFILES[h.profile]
    if h.level not in profile.levels:
        known = " or ".join(map(str, sorted(profile.levels)))
        raise check.fail("header.level", "level", h.level, f"in {profile.name} {known}")
    dimensions = dimensions_of(h.dimensions)
    fault = dimension_fault(profile, dimensions)
    if fault:
        raise check.fail("header.dimension", f"dimensions.{fault[0]}", *fault[1:])
    level = profile.levels[h.level]
    if dimensions.plane_size > level.plane_size:
        allowed = f"at level {h.level} at most {level.plane_size}"
        raise check.fail("header.dimension", "dimensions.plane_size", dimensions.plane_size, allowed)
    check.within("header.anchor_count", "anchor_count", h.anchor_count, 0, level.anchors)
    lowest = minimal_level(profile, h.anchor_count, dimensions.plane_size)
    if lowest != h.level:
        raise check.fail("header.level_not_minimal", "level", h.level, lowest)
    check.within("header.chunk_size", "chunk_size", h.chunk_size, *profile.chunk_size)
    for lanes_field in ("plane_lanes_log2", "mask_lanes_log2", "attribute_lanes_log2"):
        check.within("header.lanes", lanes_field, h[lanes_field], 0, LANES_LOG2_MAX)
    for i, step in enumerate(h.base_step):
        check.within("header.base_step", f"base_step[{i}]", step, BASE_STEP_MIN, BASE_STEP_MAX)
    return Header(
        h.profile,
        h.level,
        h.anchor_count,
        h.chunk_size,
        Lanes(h.plane_lanes_log2, h.mask_lanes_log2, h.attribute_lanes_log2),
        dimensions,
        tuple(h.base_step),
        _check_grid(h.position_grid, check),
        _check_render(h.render_info, check),
        {e.type: Section(e.type, e.mode, e.offset, e.offset + e.length) for e in h.directory},
    )


def _check_grid(g: Any, check: _HeaderCheck) -> PositionGrid:
    """SPEC 6.4."""
    name = "header.position_grid"
    for i, origin in enumerate(g.origin):
        check.within(name, f"position_grid.origin[{i}]", origin, 1 - ORIGIN_BOUND, ORIGIN_BOUND - 1)
    check.within(name, "position_grid.scale_mantissa", g.scale_mantissa, 1, 65535)
    check.within(name, "position_grid.scale_exponent", g.scale_exponent, -SCALE_EXPONENT_MAX, SCALE_EXPONENT_MAX)
    return PositionGrid(tuple(g.origin), g.scale_mantissa, g.scale_exponent)


def _check_render(r: Any, check: _HeaderCheck) -> RenderInfo:
    """SPEC 6.5."""
    name, field = "header.render_info", "render_info."
    check.within(name, field + "up_axis", r.up_axis, 0, 5)
    for scalar in ("near_plane", "distance_unit", "alpha_max", "low_pass"):
        check.finite(name, field + scalar, [r[scalar]])
    for scalar in ("near_plane", "distance_unit"):
        if r[scalar] <= 0:
            raise check.fail(name, field + scalar, r[scalar], "more than 0")
    if not 0 < r.alpha_max <= 1:
        raise check.fail(name, field + "alpha_max", r.alpha_max, "more than 0 and at most 1")
    if r.low_pass < 0:
        raise check.fail(name, field + "low_pass", r.low_pass, "at least 0")
    check.within(name, field + "camera_width", r.camera_width, 1, 65535)
    check.within(name, field + "camera_height", r.camera_height, 1, 65535)
    for vector in ("camera_focal", "camera_rotation", "camera_translation"):
        check.finite(name, field + vector, r[vector])
    if min(r.camera_focal) <= 0:
        raise check.fail(name, field + "camera_focal", list(r.camera_focal), "more than 0")
    if not any(r.camera_rotation):
        raise check.fail(name, field + "camera_rotation", list(r.camera_rotation), "a quaternion that is not zero")
    return RenderInfo(
        tuple(r.background),
        r.up_axis,
        r.near_plane,
        r.distance_unit,
        r.alpha_max,
        r.low_pass,
        r.camera_width,
        r.camera_height,
        tuple(r.camera_focal),
        tuple(r.camera_rotation),
        tuple(r.camera_translation),
    )


def section_lengths(header: Header) -> dict[int, int]:
    """SPEC 6.6: the lengths that the header implies."""
    d = header.dimensions
    chunks = -(-header.anchor_count // header.chunk_size)
    lengths = {
        FRAME: syntax.SCHEMAS["Frame"].sizeof(at=None),
        CHUNK_TABLE: entries_start(d.offset_count, header.sections[POSITIONS].mode) + CHUNK_ENTRY_BYTES * chunks,
    }
    if not header.sections[WEIGHTS].mode:
        lengths[WEIGHTS] = 2 + d.carm_inputs + 4 * weight_count(d)
    if not header.sections[POSITIONS].mode:
        lengths[POSITIONS] = POSITION_BYTES * header.anchor_count
    return lengths


def entries_start(offset_count: int, position_mode: int) -> int:
    """SPEC 5.10: bytes of the chunk table before its entries."""
    model = syntax.SCHEMAS["PositionModel"].sizeof(at=None) if position_mode else 0
    return int(2 * context_count(offset_count) + model)


def _check_directory(h: Any, header: Header, check: _HeaderCheck, data: bytes, start: int, keep_going: bool) -> None:
    """SPEC 10.1, stage 3: the directory's rules in the order of their codes, each over the entries in order.

    Lengths are checked before anything that they size is read (SPEC 13.1); ancillary sections are skipped (SPEC 12.1).
    """
    entries = h.directory
    for i, e in enumerate(entries):
        if e.type & CRITICAL and e.type not in SECTIONS:
            raise check.fail("directory.unknown_critical", f"directory[{i}].type", f"{e.type:02x}", "a type of 6.6")
    wanted = list(SECTIONS)
    for i, e in enumerate(entries):
        # SPEC 6.6: the seven critical sections first, then ancillary ones, types ascending from 01.
        before = 0 if i <= len(wanted) else entries[i - 1].type
        if not (e.type == wanted[i] if i < len(wanted) else before < e.type < CRITICAL):
            allowed = f"{wanted[i]:02x}" if i < len(wanted) else f"{before + 1:02x} to 7f"
            raise check.fail("directory.order", f"directory[{i}].type", f"{e.type:02x}", allowed)
    if len(entries) < len(wanted):
        raise check.fail("directory.order", "section_count", len(entries), f"at least {len(wanted)}")
    for i, e in enumerate(entries):
        if e.type in SECTIONS and e.mode > MODES.get(e.type, 0):
            allowed = "0 or 1" if e.type in MODES else "0"
            raise check.fail("directory.mode", f"directory[{i}].mode", e.mode, f"of {SECTIONS[e.type]} {allowed}")
    end = start
    for i, e in enumerate(entries):
        if e.offset != end:
            raise check.fail("directory.offset", f"directory[{i}].offset", e.offset, end)
        end = e.offset + e.length
    lengths = section_lengths(header)
    for i, e in enumerate(entries):
        implied = lengths.get(e.type, e.length)
        if e.length != implied:
            raise check.fail("directory.length", f"directory[{i}].length", e.length, implied)
    cut = len(data) < end and keep_going and header.sections[POSITIONS].start <= len(data)
    if len(data) != end and not cut:
        raise BitstreamError("directory.file_length", min(len(data), end), "file", f"{len(data)} bytes", end)
    for e in entries:
        if keep_going and (e.type in CHUNKED or e.offset + e.length > len(data)):
            continue
        crc = zlib.crc32(memoryview(data)[e.offset : e.offset + e.length])
        if crc != e.crc:
            raise BitstreamError("section.crc", e.offset, header.sections[e.type].name, f"0x{e.crc:08x}", f"0x{crc:08x}")


def emit_container(scene: Scene, sections: list[tuple[int, int, bytes]]) -> bytes:
    """The file: prologue, header and sections (type, mode, bytes) in file order (SPEC 5.1 to 5.6)."""
    d = scene.dimensions
    level = minimal_level(PROFILES[scene.profile], scene.anchor_count, d.plane_size)
    r = scene.render
    fields = {
        "profile": scene.profile,
        "level": 0 if level is None else level,
        "section_count": len(sections),
        "reserved_0": 0,
        "anchor_count": scene.anchor_count,
        "chunk_size": scene.chunk_size,
        "plane_lanes_log2": scene.lanes.plane,
        "mask_lanes_log2": scene.lanes.mask,
        "attribute_lanes_log2": scene.lanes.attribute,
        "reserved_1": 0,
        "dimensions": {
            "offset_count": d.offset_count,
            "slice_count": len(d.slices),
            "slice_width": d.slices,
            "plane_channels": d.plane_channels,
            "frequency_count": d.frequency_count,
            "plane_size": d.plane_size,
            "hyper_layers": len(d.hyper_width),
            "hyper_width": d.hyper_width,
            "sarm_layers": len(d.sarm_width),
            "sarm_width": d.sarm_width,
            "carm_layers": len(d.carm_width),
            "carm_width": d.carm_width,
            "render_width": d.render_width,
        },
        "base_step": scene.base_step,
        "position_grid": {**vars(scene.grid), "reserved": 0},
        "render_info": vars(r),
        "directory": [],
        "header_crc": 0,
    }
    entry_bytes = syntax.SCHEMAS["DirectoryEntry"].sizeof(at=None)
    bare = len(syntax.build("Header", {**fields, "section_count": 0}))
    header_length = bare + entry_bytes * len(sections)
    at = PROLOGUE_BYTES + header_length
    directory = []
    for kind, mode, content in sections:
        entry = {"type": kind, "mode": mode, "reserved": 0, "offset": at, "length": len(content), "crc": zlib.crc32(content)}
        directory.append(entry)
        at += len(content)
    header = syntax.build("Header", {**fields, "directory": directory})[:-4]
    prologue = syntax.build("Prologue", {"signature": SIGNATURE, "version": VERSION, "header_length": header_length, "prologue_crc": 0})[
        :-4
    ]
    parts = [prologue, zlib.crc32(prologue).to_bytes(4, "little"), header, zlib.crc32(header).to_bytes(4, "little")]
    return b"".join([*parts, *(content for _, _, content in sections)])
