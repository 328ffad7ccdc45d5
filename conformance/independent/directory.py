"""Clauses 5.6, 6.6 and 12.1: the directory."""

import zlib
from dataclasses import dataclass

from .chunks import CHUNK_ENTRY_LENGTH, entries_start
from .errors import require
from .header import CHUNK_TABLE, FRAME, POSITIONS, WEIGHTS, Header

CRITICAL_TYPES = range(0x81, 0x88)
FRAME_LENGTH = 88


@dataclass(frozen=True)
class Section:
    """A section of the file: its type, its first byte in the file, and its length in bytes."""

    type: int
    offset: int
    length: int


# SPEC [R6.6-2], 12.1
def _check_order(header: Header) -> None:
    previous = 0
    for n in range(header["section_count"]):
        kind = header[f"type.{n}"]
        right = kind == CRITICAL_TYPES[n] if n < len(CRITICAL_TYPES) else previous < kind < 0x80
        require(right, "directory.order", header.offsets[f"type.{n}"])
        previous = kind if n >= len(CRITICAL_TYPES) else 0
    require(header["section_count"] >= len(CRITICAL_TYPES), "directory.order", header.offsets["section_count"])


# SPEC 6.6, 10.1 step 3, 12.1, 13.1: lengths are checked before what they size is read, ancillary sections are skipped
def read_directory(data: bytes, header: Header, weight_count: int) -> list[Section]:
    """Check the directory and the CRC-32s of the sections, and return the sections. weight_count: W."""
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
    implied = {
        FRAME: FRAME_LENGTH,
        CHUNK_TABLE: entries_start(header) + CHUNK_ENTRY_LENGTH * header.chunk_count,
    }
    if header.weight_mode == 0:
        implied[WEIGHTS] = 2 + header.carm_inputs + 4 * weight_count
    if header.position_mode == 0:
        implied[POSITIONS] = 6 * header["anchor_count"]
    for n, length in sorted(implied.items()):
        require(header[f"length.{n}"] == length, "directory.length", at[f"length.{n}"])
    require(end == len(data), "directory.file_length", min(end, len(data)))
    sections = [Section(header[f"type.{n}"], header[f"offset.{n}"], header[f"length.{n}"]) for n in entries]
    for n, section in enumerate(sections):
        crc = zlib.crc32(memoryview(data)[section.offset : section.offset + section.length])
        require(crc == header[f"crc.{n}"], "section.crc", section.offset)
    return sections
