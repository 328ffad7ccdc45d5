"""Clauses 5.1 to 5.5 and 6.1 to 6.5: the prologue and the header."""

import math
import struct
import zlib

from .conventions import (
    BASE_STEP_MAX,
    BASE_STEP_MIN,
    HEADER_LENGTH_MAX,
    HEADER_LENGTH_MIN,
    LANES_LOG2_MAX,
    ORIGIN_BOUND,
    SCALE_EXPONENT_MAX,
)
from .dimensions import Dimensions
from .errors import require
from .limits import check_profile

SIGNATURE = bytes.fromhex("894333470D0A1A0A")
PROLOGUE_LENGTH = 20
FRAME, WEIGHTS, PLANES, CHUNK_TABLE, POSITIONS, MASKS, ATTRIBUTES = range(7)
ENTRY_NAMES = ("type", "mode", "reserved", "offset", "length", "crc")


class Header(Dimensions):
    """The values of the header's fields by name, and what follows from them.

    The directory's modes can be asked for only after its check.
    """

    # SPEC 5.6
    @property
    def weight_mode(self) -> int:
        """The mode of the weights."""
        mode: int = self[f"mode.{WEIGHTS}"]
        return mode

    # SPEC 5.6
    @property
    def position_mode(self) -> int:
        """The mode of the positions."""
        mode: int = self[f"mode.{POSITIONS}"]
        return mode

    # SPEC 6.10
    @property
    def chunk_count(self) -> int:
        """C, the number of chunks."""
        return -(-self["anchor_count"] // self["chunk_size"])

    # SPEC 6.10
    def chunk_anchors(self, chunk: int) -> int:
        """Return how many anchors a chunk has."""
        return min(self["chunk_size"], self["anchor_count"] - chunk * self["chunk_size"])


# SPEC 6.1, 10.1 step 1
def read_prologue(data: bytes) -> int:
    """Check the prologue, and return header_length."""
    require(len(data) >= PROLOGUE_LENGTH, "prologue.truncated", len(data))
    signature, version, header_length, crc = struct.unpack_from("<8s3I", data)
    require(signature == SIGNATURE, "prologue.signature", 0)
    require(crc == zlib.crc32(data[:16]), "prologue.crc", 16)
    require(version == 0, "prologue.version", 8)
    require(HEADER_LENGTH_MIN <= header_length <= HEADER_LENGTH_MAX, "prologue.header_length", 12)
    return header_length


# SPEC 5.2 to 5.6
def _read_fields(header: Header) -> None:
    for name in ("profile", "level", "section_count", "reserved_0"):
        header.read(name, "B")
    header.read("anchor_count", "I")
    header.read("chunk_size", "I")
    for name in ("plane_lanes_log2", "mask_lanes_log2", "attribute_lanes_log2", "reserved_1", "offset_count"):
        header.read(name, "B")
    header.read("slice_width", "B", header.read("slice_count", "B"))
    header.read("plane_channels", "B")
    header.read("frequency_count", "B")
    header.read("plane_size", "H")
    for network in ("hyper", "sarm", "carm"):
        header.read(f"{network}_width", "B", header.read(f"{network}_layers", "B"))
    header.read("render_width", "B")
    header.read("base_step", "f", 3)
    header.read("origin", "q", 3)
    header.read("scale_mantissa", "H")
    header.read("scale_exponent", "b")
    header.read("grid_reserved", "B")
    header.read("background", "B", 3)
    header.read("up_axis", "B")
    for name in ("near_plane", "distance_unit", "alpha_max", "low_pass"):
        header.read(name, "f")
    header.read("camera_width", "H")
    header.read("camera_height", "H")
    header.read("camera_focal", "f", 2)
    header.read("camera_rotation", "f", 4)
    header.read("camera_translation", "f", 3)
    for n in range(header["section_count"]):
        for name, code in zip(ENTRY_NAMES, "BBHIII"):
            header.read(f"{name}.{n}", code)
    header.finish()


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
    for field in ("camera_width", "camera_height"):
        require(header[field] >= 1, name, at[field])
    for field in ("camera_focal", "camera_rotation", "camera_translation"):
        require(all(map(math.isfinite, header[field])), name, at[field])
    require(min(header["camera_focal"]) > 0, name, at["camera_focal"])
    require(any(header["camera_rotation"]), name, at["camera_rotation"])


# SPEC 6.2 to 6.5, 10.1 step 2
def read_header(data: bytes, header_length: int) -> Header:
    """Read the header, check it, and return it. The directory is checked later."""
    end = PROLOGUE_LENGTH + header_length
    require(len(data) >= end, "header.truncated", len(data))
    (stored,) = struct.unpack_from("<I", data, end - 4)
    require(zlib.crc32(data[PROLOGUE_LENGTH : end - 4]) == stored, "header.crc", end - 4)
    header = Header(data, PROLOGUE_LENGTH, end)
    _read_fields(header)
    at = header.offsets
    entries = [f"reserved.{n}" for n in range(header["section_count"])]
    for name in ("reserved_0", "reserved_1", "grid_reserved", *entries):
        require(header[name] == 0, "header.reserved", at[name])
    check_profile(header)
    for name in ("plane_lanes_log2", "mask_lanes_log2", "attribute_lanes_log2"):
        require(header[name] <= LANES_LOG2_MAX, "header.lanes", at[name])
    for n, step in enumerate(header["base_step"]):
        require(BASE_STEP_MIN <= step <= BASE_STEP_MAX, "header.base_step", at["base_step"] + 4 * n)
    for n, origin in enumerate(header["origin"]):
        require(abs(origin) < ORIGIN_BOUND, "header.position_grid", at["origin"] + 8 * n)
    require(header["scale_mantissa"] >= 1, "header.position_grid", at["scale_mantissa"])
    require(abs(header["scale_exponent"]) <= SCALE_EXPONENT_MAX, "header.position_grid", at["scale_exponent"])
    _check_render_info(header)
    return header
