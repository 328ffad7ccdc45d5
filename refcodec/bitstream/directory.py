"""Clauses 5.6, 6.6 and 12.1: the directory."""

from __future__ import annotations

import zlib
from collections.abc import Mapping
from dataclasses import dataclass

from . import syntax
from .chunks import POSITION_BYTES, table_bytes
from .dimensions import Dimensions, weight_count
from .errors import BitstreamError

# SPEC 6.6: the critical sections in file order. Bit 7 of a type is set if the section is critical.
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
# SPEC 5.10: the sections in which each chunk has a part.
CHUNKED = (POSITIONS, MASKS, ATTRIBUTES)
# SPEC 6.6: the highest mode of each section that has another mode than 0.
MODES = {WEIGHTS: 1, POSITIONS: 1}


@dataclass(frozen=True)
class Section:
    """SPEC 5.6: a section of a file. data[start:end] are its bytes."""

    type: int
    mode: int
    start: int
    end: int

    @property
    def name(self) -> str:
        """The name of the section in paths."""
        return SECTIONS.get(self.type, f"extension_{self.type:02x}")


def section_lengths(d: Dimensions, anchors: int, chunks: int, modes: Mapping[int, int]) -> dict[int, int]:
    """SPEC [R6.6-5]: returns the lengths in bytes that the header implies, by type.

    Sections whose length is free are left out. modes: by type.
    """
    lengths = {
        FRAME: syntax.size_of("Frame"),
        CHUNK_TABLE: table_bytes(d.offset_count, modes[POSITIONS], chunks),
    }
    if not modes[WEIGHTS]:
        lengths[WEIGHTS] = 2 + d.carm_inputs + 4 * weight_count(d)
    if not modes[POSITIONS]:
        lengths[POSITIONS] = POSITION_BYTES * anchors
    return lengths


def parse_directory(
    header: syntax.Struct, dimensions: Dimensions, chunks: int, data: bytes, start: int, keep_going: bool
) -> dict[int, Section]:
    """SPEC 6.6: checks the directory and returns the sections by type. Raises BitstreamError 301 to 307.

    Each requirement is checked over all entries before the next requirement (SPEC 10.1, step 3). Lengths are checked
    before anything of that length is read (SPEC 13.1). The contents of ancillary sections are not read (SPEC 12.1).

    header: the parsed header. chunks: the number of chunks. start: where the header ends. keep_going: the file may end
    behind the start of the positions, and the CRC-32s of the chunked sections are left to the checks of the chunks.
    """
    entries = header.fields.directory
    # SPEC [R6.6-1]
    for i, e in enumerate(entries):
        if e.type & CRITICAL and e.type not in SECTIONS:
            name = "directory.unknown_critical"
            raise header.error(name, f"directory[{i}].type", f"{e.type:02x}", "a type of 6.6")
    # SPEC [R6.6-2]: the critical sections come first. The types of the ancillary ones behind them ascend.
    wanted = list(SECTIONS)
    for i, e in enumerate(entries):
        before = 0 if i <= len(wanted) else entries[i - 1].type
        if not (e.type == wanted[i] if i < len(wanted) else before < e.type < CRITICAL):
            allowed = f"{wanted[i]:02x}" if i < len(wanted) else f"{before + 1:02x} to 7f"
            raise header.error("directory.order", f"directory[{i}].type", f"{e.type:02x}", allowed)
    if len(entries) < len(wanted):
        raise header.error("directory.order", "section_count", len(entries), f"at least {len(wanted)}")
    # SPEC [R6.6-3]
    for i, e in enumerate(entries):
        if e.type in SECTIONS and e.mode > MODES.get(e.type, 0):
            allowed = "0 or 1" if e.type in MODES else "0"
            raise header.error("directory.mode", f"directory[{i}].mode", e.mode, f"of {SECTIONS[e.type]} {allowed}")
    # SPEC [R6.6-4]
    end = start
    for i, e in enumerate(entries):
        if e.offset != end:
            raise header.error("directory.offset", f"directory[{i}].offset", e.offset, end)
        end = e.offset + e.length
    # SPEC [R6.6-5]
    modes = {e.type: e.mode for e in entries}
    lengths = section_lengths(dimensions, header.fields.anchor_count, chunks, modes)
    for i, e in enumerate(entries):
        implied = lengths.get(e.type, e.length)
        if e.length != implied:
            raise header.error("directory.length", f"directory[{i}].length", e.length, implied)
    sections = {e.type: Section(e.type, e.mode, e.offset, e.offset + e.length) for e in entries}
    # SPEC [R6.6-6]
    cut = len(data) < end and keep_going and sections[POSITIONS].start <= len(data)
    if len(data) != end and not cut:
        raise BitstreamError("directory.file_length", min(len(data), end), "file", f"{len(data)} bytes", end)
    # SPEC [R6.6-7]
    for e in entries:
        section = sections[e.type]
        if keep_going and (e.type in CHUNKED or section.end > len(data)):
            continue
        crc = zlib.crc32(memoryview(data)[section.start : section.end])
        if crc != e.crc:
            raise BitstreamError("section.crc", e.offset, section.name, f"0x{e.crc:08x}", f"0x{crc:08x}")
    return sections
