"""Clauses 5.1 to 5.5 and 6.1 to 6.5: the prologue and the header."""

import math
import struct
import zlib
from typing import NamedTuple

from .conventions import (
    BASE_STEP_MAX,
    BASE_STEP_MIN,
    HEADER_LENGTH_MAX,
    HEADER_LENGTH_MIN,
    LANES_LOG2_MAX,
    MAJOR,
    MINOR,
    ORIGIN_BOUND,
    SCALE_EXPONENT_MAX,
)
from .dimensions import Dimensions
from .errors import require
from .limits import check_profile, check_work

SIGNATURE = b"\x89C3GS\r\n\x1a"
PROLOGUE_LENGTH = 20
LANE_FIELDS = ("plane_lanes_log2", "mask_lanes_log2", "attribute_lanes_log2")


class Entry(NamedTuple):
    """An entry of the directory. at: its first byte in the file."""

    at: int
    type: bytes
    mode: int
    reserved: bytes
    length: int
    crc: int


class Header(Dimensions):
    """The values of the header's fields by name, and the entries of the directory."""

    entries: list[Entry]


# SPEC 6.1, 10.1
def read_prologue(data: bytes) -> tuple[int, int]:
    """Check the prologue, and return minor and header_length."""
    require(len(data) >= PROLOGUE_LENGTH, "prologue.truncated", len(data))
    signature, major, minor, header_length, crc = struct.unpack_from("<8s2H2I", data)
    require(signature == SIGNATURE, "prologue.signature", 0)
    require(crc == zlib.crc32(data[:16]), "prologue.crc", 16)
    require(major == MAJOR, "prologue.version", 8)
    right = HEADER_LENGTH_MIN <= header_length <= HEADER_LENGTH_MAX and header_length & 3 == 0
    require(right, "prologue.header_length", 12)
    return minor, header_length


# SPEC 5.2 to 5.6, [R6.2-3] to [R6.2-5]
def _read_fields(header: Header, minor: int) -> None:
    header.read("profile", "B")
    header.read("level", "B")
    header.read("section_count", "H")
    for name in ("anchor_count", "chunk_count", "chunk_size"):
        header.read(name, "I")
    for name in (*LANE_FIELDS, "reserved"):
        header.read(name, "B")
    header.read("base_step", "f", 3)
    header.read("origin", "q", 3)
    header.read("scale_mantissa", "H")
    header.read("scale_exponent", "b")
    header.read("grid_reserved", "B")
    header.read("background", "B", 3)
    header.read("up_axis", "B")
    for name in ("near_plane", "distance_unit", "alpha_max", "low_pass"):
        header.read(name, "f")
    for name in ("offset_count", "plane_channels", "frequency_count", "render_width"):
        header.read(name, "B")
    header.read("plane_size", "H")
    counts = [header.read(name, "B") for name in ("slice_count", "hyper_layers", "sarm_layers", "carm_layers")]
    for network, count in zip(("slice", "hyper", "sarm", "carm"), counts):
        header.read(f"{network}_width", "B", count)
    padding_at, zero = header.read_padding()
    header.entries = []
    for _ in range(header["section_count"]):
        at, items = header.take("<4sB3sQI")
        header.entries.append(Entry(at, *items))
    header.finish(later=minor > MINOR)
    require(zero, "header.padding", padding_at)
    for name in ("reserved", "grid_reserved"):
        require(header[name] == 0, "header.reserved", header.offsets[name])
    for entry in header.entries:
        require(not any(entry.reserved), "header.reserved", entry.at + 5)


# SPEC 6.5
def _check_render_info(header: Header) -> None:
    at = header.offsets
    name = "header.render_info"
    require(header["up_axis"] <= 5, name, at["up_axis"])
    for field in ("near_plane", "distance_unit", "alpha_max", "low_pass"):
        require(math.isfinite(header[field]), name, at[field])
    for field in ("near_plane", "distance_unit"):
        require(header[field] > 0, name, at[field])
    require(0 < header["alpha_max"] <= 1, name, at["alpha_max"])
    require(header["low_pass"] >= 0, name, at["low_pass"])


# SPEC 6.2 to 6.5, 10.1
def read_header(data: bytes) -> Header:
    """Read the prologue and the header, check them, and return the header. The directory is checked later."""
    minor, header_length = read_prologue(data)
    end = PROLOGUE_LENGTH + header_length
    require(len(data) >= end, "header.truncated", len(data))
    (stored,) = struct.unpack_from("<I", data, end - 4)
    require(zlib.crc32(data[PROLOGUE_LENGTH : end - 4]) == stored, "header.crc", end - 4)
    header = Header(data, PROLOGUE_LENGTH, end)
    _read_fields(header, minor)
    at = header.offsets
    level = check_profile(header)
    for name in LANE_FIELDS:
        require(header[name] <= LANES_LOG2_MAX, "header.lanes", at[name])
    for n, step in enumerate(header["base_step"]):
        require(BASE_STEP_MIN <= step <= BASE_STEP_MAX, "header.base_step", at["base_step"] + 4 * n)
    for n, origin in enumerate(header["origin"]):
        require(abs(origin) < ORIGIN_BOUND, "header.position_grid", at["origin"] + 8 * n)
    require(header["scale_mantissa"] >= 1, "header.position_grid", at["scale_mantissa"])
    require(abs(header["scale_exponent"]) <= SCALE_EXPONENT_MAX, "header.position_grid", at["scale_exponent"])
    _check_render_info(header)
    check_work(header, level)
    fewest = -(-header["anchor_count"] // header["chunk_size"])
    right = fewest <= header["chunk_count"] <= header["anchor_count"]
    require(right, "header.chunk_count", at["chunk_count"])
    return header
