"""Chapters 5, 6, 11 and 12: prologue, header, directory and chunk table."""

import math
import struct
import zlib
from dataclasses import dataclass
from typing import Any

from .errors import C3GSError, require
from .operators import (
    BASE_STEP_MAX,
    BASE_STEP_MIN,
    CELL_INDEX,
    HEADER_LENGTH_MAX,
    HEADER_LENGTH_MIN,
    LANES_LOG2_MAX,
    ORIGIN_BOUND,
    POSITION_MODELS,
    PRECISION,
    SCALE_EXPONENT_MAX,
)

SIGNATURE = bytes.fromhex("894333470D0A1A0A")
PROLOGUE_LENGTH = 20
CRITICAL_TYPES = range(0x81, 0x88)
FRAME, WEIGHTS, PLANES, CHUNK_TABLE, POSITIONS, MASKS, ATTRIBUTES = range(7)
FRAME_LENGTH = 88
CHUNK_ENTRY_LENGTH = 24
POSITION_MODEL_LENGTH = 577
ENTRY_NAMES = ("type", "mode", "reserved", "offset", "length", "crc")

# SPEC 11.1: dimension -> bounds of Tiny and of Main; a list's bounds are those of each item
PROFILE_BOUNDS: dict[str, tuple[tuple[int, int], tuple[int, int]]] = {
    "offset_count": ((1, 10), (10, 10)),
    "slice_count": ((1, 4), (4, 4)),
    "slice_width": ((1, 16), (5, 20)),
    "plane_channels": ((1, 8), (8, 8)),
    "frequency_count": ((1, 10), (10, 10)),
    "plane_size": ((2, 32), (2, 256)),
    "hyper_layers": ((1, 2), (1, 1)),
    "hyper_width": ((1, 64), (16, 128)),
    "sarm_layers": ((1, 2), (2, 2)),
    "sarm_width": ((1, 16), (16, 16)),
    "carm_layers": ((0, 2), (1, 1)),
    "carm_width": ((1, 64), (16, 128)),
    "render_width": ((1, 64), (50, 50)),
}
CHUNK_SIZE_BOUNDS = ((1, 65536), (256, 65536))
MAIN = 1
MAIN_SLICES = [5, 10, 15, 20]

# SPEC 11.2: for each profile, level -> (largest anchor_count, largest plane_size)
LEVELS: tuple[dict[int, tuple[int, int]], ...] = (
    {0: (4096, 32)},
    {1: (131072, 128), 2: (1048576, 256), 3: (16777216, 256)},
)


@dataclass(frozen=True)
class Section:
    """One entry of the directory."""

    type: int
    offset: int
    length: int


class Header:
    """The values of the header's fields by name, and where each field starts in the file."""

    def __init__(self, data: bytes, start: int, end: int) -> None:
        self._data, self._at, self._end = data, start, end
        self.values: dict[str, Any] = {}
        self.offsets: dict[str, int] = {}

    def __getitem__(self, name: str) -> Any:
        return self.values[name]

    # SPEC 5, [R6.2-3]
    def read(self, name: str, code: str, count: int | None = None) -> Any:
        """Take the next field: one item of a struct code, or a list of count items."""
        layout = f"<{1 if count is None else count}{code}"
        size = struct.calcsize(layout)
        require(self._at + size <= self._end - 4, "header.syntax", self._end)
        items = struct.unpack_from(layout, self._data, self._at)
        self.offsets[name] = self._at
        self.values[name] = items[0] if count is None else list(items)
        self._at += size
        return self.values[name]

    # SPEC [R6.2-3]
    def finish(self) -> None:
        """Check that nothing lies between the last field and the CRC-32."""
        require(self._at == self._end - 4, "header.syntax", self._at)

    @property
    def end(self) -> int:
        """The first byte after the header."""
        return self._end

    @property
    def features(self) -> int:
        """F of 6.3."""
        return sum(self["slice_width"])

    @property
    def channels(self) -> int:
        """D of 6.3."""
        return self.features + 6 + 3 * self["offset_count"]

    # SPEC 5.6
    @property
    def weight_mode(self) -> int:
        """The mode of the weights, of a right directory."""
        mode: int = self[f"mode.{WEIGHTS}"]
        return mode

    # SPEC 5.6
    @property
    def position_mode(self) -> int:
        """The mode of the positions, of a right directory."""
        mode: int = self[f"mode.{POSITIONS}"]
        return mode

    @property
    def carm_inputs(self) -> int:
        """F less the width of the last slice (5.8)."""
        return self.features - self["slice_width"][-1]

    # SPEC 6.10
    @property
    def chunk_count(self) -> int:
        """C."""
        return -(-self["anchor_count"] // self["chunk_size"])

    # SPEC 6.10
    def chunk_anchors(self, chunk: int) -> int:
        """How many anchors a chunk holds."""
        return min(self["chunk_size"], self["anchor_count"] - chunk * self["chunk_size"])


# SPEC 6.1, 10.1 step 1
def read_prologue(data: bytes) -> int:
    """Check the prologue; the header's length."""
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


# SPEC 11.1, 11.2, 10.1 step 2
def _check_profile(header: Header) -> None:
    at = header.offsets
    profile, level, anchors, size = (header[name] for name in ("profile", "level", "anchor_count", "plane_size"))
    require(profile < len(LEVELS), "header.profile", at["profile"])
    levels = LEVELS[profile]
    require(level in levels, "header.level", at["level"])
    for name, bounds in PROFILE_BOUNDS.items():
        low, high = bounds[profile]
        items = header[name] if isinstance(header[name], list) else [header[name]]
        for n, item in enumerate(items):
            require(low <= item <= high, "header.dimension", at[name] + n)
    require((header["carm_layers"] == 0) == (header["slice_count"] == 1), "header.dimension", at["carm_layers"])
    require(profile != MAIN or header["slice_width"] == MAIN_SLICES, "header.dimension", at["slice_width"])
    most_anchors, largest_plane = levels[level]
    require(size <= largest_plane, "header.dimension", at["plane_size"])
    require(anchors <= most_anchors, "header.anchor_count", at["anchor_count"])
    lower = any(number < level and anchors <= limit[0] and size <= limit[1] for number, limit in levels.items())
    require(not lower, "header.level_not_minimal", at["level"])
    low, high = CHUNK_SIZE_BOUNDS[profile]
    require(low <= header["chunk_size"] <= high, "header.chunk_size", at["chunk_size"])


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
    """Parse and check the header."""
    end = PROLOGUE_LENGTH + header_length
    require(len(data) >= end, "header.truncated", len(data))
    require(zlib.crc32(data[PROLOGUE_LENGTH : end - 4]) == struct.unpack_from("<I", data, end - 4)[0], "header.crc", end - 4)
    header = Header(data, PROLOGUE_LENGTH, end)
    _read_fields(header)
    at = header.offsets
    for name in ("reserved_0", "reserved_1", "grid_reserved", *(f"reserved.{n}" for n in range(header["section_count"]))):
        require(header[name] == 0, "header.reserved", at[name])
    _check_profile(header)
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


# SPEC [R6.6-2], 12.1
def _check_order(header: Header) -> None:
    previous = 0
    for n in range(header["section_count"]):
        kind = header[f"type.{n}"]
        right = kind == CRITICAL_TYPES[n] if n < len(CRITICAL_TYPES) else previous < kind < 0x80
        require(right, "directory.order", header.offsets[f"type.{n}"])
        previous = kind if n >= len(CRITICAL_TYPES) else 0
    require(header["section_count"] >= len(CRITICAL_TYPES), "directory.order", header.offsets["section_count"])


# SPEC 6.6, 10.1 step 3; 13.1: every length is checked before what it sizes is read; 12.1: ancillary sections are skipped
def read_directory(data: bytes, header: Header, weight_count: int) -> list[Section]:
    """Check the directory and the CRC-32s of the sections; weight_count is W."""
    at = header.offsets
    entries = range(header["section_count"])
    for n in entries:
        kind = header[f"type.{n}"]
        require(kind < 0x80 or kind in CRITICAL_TYPES, "directory.unknown_critical", at[f"type.{n}"])
    _check_order(header)
    for n in range(len(CRITICAL_TYPES)):
        require(header[f"mode.{n}"] <= (n in {WEIGHTS, POSITIONS}), "directory.mode", at[f"mode.{n}"])
    end = header.end
    for n in entries:
        require(header[f"offset.{n}"] == end, "directory.offset", at[f"offset.{n}"])
        end += header[f"length.{n}"]
    offsets, mode = header["offset_count"], header.position_mode
    implied = {
        FRAME: FRAME_LENGTH,
        CHUNK_TABLE: offsets * (offsets + 1) + POSITION_MODEL_LENGTH * mode + CHUNK_ENTRY_LENGTH * header.chunk_count,
    }
    if header.weight_mode == 0:
        implied[WEIGHTS] = 2 + header.carm_inputs + 4 * weight_count
    if mode == 0:
        implied[POSITIONS] = 6 * header["anchor_count"]
    for n, length in sorted(implied.items()):
        require(header[f"length.{n}"] == length, "directory.length", at[f"length.{n}"])
    require(end == len(data), "directory.file_length", min(end, len(data)))
    sections = [Section(header[f"type.{n}"], header[f"offset.{n}"], header[f"length.{n}"]) for n in entries]
    for n, section in enumerate(sections):
        crc = zlib.crc32(memoryview(data)[section.offset : section.offset + section.length])
        require(crc == header[f"crc.{n}"], "section.crc", section.offset)
    return sections


@dataclass(frozen=True)
class Part:
    """A chunk's part of a section."""

    offset: int
    length: int
    crc: int

    # SPEC [R6.10-3]
    def check(self, data: bytes) -> None:
        """Check the CRC-32 of the part."""
        if zlib.crc32(memoryview(data)[self.offset : self.offset + self.length]) != self.crc:
            raise C3GSError("chunks.crc", self.offset)


@dataclass(frozen=True)
class PositionModel:
    """What packed positions are coded with: the frequencies of each model."""

    cell_shift: int
    frequencies: list[list[int]]


# SPEC 5.15, [R6.10-4]
def _read_position_model(data: bytes, at: int) -> PositionModel:
    require(data[at] <= CELL_INDEX, "chunks.position_model", at)
    frequencies = []
    for n in range(POSITION_MODELS):
        model = list(struct.unpack_from("<16H", data, at + 1 + 32 * n))
        # a first half without children is never followed by a second one without
        least = [0 if n % 6 == 1 else 1] + [1] * 15
        right = sum(model) == 1 << PRECISION and all(map(int.__ge__, model, least)) and (n % 6 != 1 or model[0] == 0)
        require(right, "chunks.position_model", at + 1 + 32 * n)
        frequencies.append(model)
    return PositionModel(data[at], frequencies)


ChunkTable = tuple[list[int], PositionModel | None, list[tuple[Part, ...]]]


# SPEC 5.10, 6.10, 10.1 step 6
def read_chunk_table(data: bytes, header: Header, sections: list[Section]) -> ChunkTable:
    """The mask model, the model of positions if there is one, and for each chunk its parts of the positions, masks and attributes."""
    table = sections[CHUNK_TABLE].offset
    count = header["offset_count"] * (header["offset_count"] + 1) // 2
    mask_model = list(struct.unpack_from(f"<{count}H", data, table))
    for n, frequency in enumerate(mask_model):
        require(1 <= frequency < 1 << PRECISION, "chunks.mask_model", table + 2 * n)
    entries_at = table + 2 * count
    position_model = None
    if header.position_mode:
        position_model = _read_position_model(data, entries_at)
        entries_at += POSITION_MODEL_LENGTH
    starts = [sections[n].offset for n in (POSITIONS, MASKS, ATTRIBUTES)]
    ends = list(starts)
    chunks = []
    for c in range(header.chunk_count):
        at = entries_at + CHUNK_ENTRY_LENGTH * c
        numbers = struct.unpack_from("<6I", data, at)
        anchors = header.chunk_anchors(c)
        require(16 * numbers[0] >= anchors if header.position_mode else numbers[0] == 6 * anchors, "chunks.length", at)
        chunks.append(tuple(Part(ends[n], numbers[2 * n], numbers[2 * n + 1]) for n in range(3)))
        ends = [end + length for end, length in zip(ends, numbers[::2])]
    for n, end in zip((POSITIONS, MASKS, ATTRIBUTES), ends):
        require(end == sections[n].offset + sections[n].length, "chunks.length", sections[n].offset)
    return mask_model, position_model, chunks
