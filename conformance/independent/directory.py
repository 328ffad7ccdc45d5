"""Clauses 5.6, 6.6 and 12.1: the directory and the sections."""

import zlib
from dataclasses import dataclass

from .conventions import SECTION_LENGTH_MAX, padded
from .dimensions import weight_count
from .errors import require
from .header import Header
from .index import CHUNK_ENTRY_LENGTH, entries_start
from .syntax import check_padding

FRAME, WEIGHTS, PLANES, INDEX, DATA = b"FRAM", b"WGTS", b"PLNS", b"INDX", b"DATA"
CRITICAL_TYPES = (FRAME, WEIGHTS, PLANES, INDEX, DATA)
HIGHEST_MODES = {FRAME: 0, WEIGHTS: 1, PLANES: 0, INDEX: 1, DATA: 0}
LETTERS = frozenset(b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz")
FRAME_LENGTH = 88


@dataclass(frozen=True)
class Section:
    """A section of the file. offset: its first byte in the file. length: its bytes, without the padding behind it."""

    type: bytes
    mode: int
    offset: int
    length: int
    crc: int

    @property
    def end(self) -> int:
        """The first byte after it and its padding."""
        return self.offset + padded(self.length)


# SPEC 12.1
def is_critical(kind: bytes) -> bool:
    """Whether sections of a type are critical: its first letter is a capital."""
    return kind[:1].isupper()


# SPEC [R6.6-1] to [R6.6-4]
def _check_types(header: Header) -> None:
    for entry in header.entries:
        require(LETTERS.issuperset(entry.type), "directory.type", entry.at)
    critical = [entry for entry in header.entries if is_critical(entry.type)]
    for entry in critical:
        require(entry.type in CRITICAL_TYPES, "directory.unknown_critical", entry.at)
    present = {FRAME: header.framed, PLANES: header["plane_channels"] > 0}
    wanted = [kind for kind in CRITICAL_TYPES if present.get(kind, True)]
    for n, entry in enumerate(critical):
        require(wanted[n : n + 1] == [entry.type], "directory.order", entry.at)
    require(len(critical) == len(wanted), "directory.order", header.offsets["section_count"])
    for entry in critical:
        require(entry.mode <= HIGHEST_MODES[entry.type], "directory.mode", entry.at + 4)


# SPEC [R6.6-5], 10.1, 13.1: lengths are checked before what they size is read
def read_directory(header: Header) -> list[Section]:
    """Check the directory, and return the sections in file order."""
    _check_types(header)
    sections, at = [], header.end
    for entry in header.entries:
        right = entry.length <= SECTION_LENGTH_MAX
        if entry.type == FRAME:
            right = entry.length == FRAME_LENGTH
        elif entry.type == WEIGHTS and entry.mode == 0:
            right = entry.length == padded(2 + header.carm_inputs) + 4 * weight_count(header)
        elif entry.type == INDEX:
            chunks = CHUNK_ENTRY_LENGTH * header["chunk_count"]
            right = entry.length == entries_start(header, entry.mode) + chunks
        require(right, "directory.length", entry.at + 8)
        sections.append(Section(entry.type, entry.mode, at, entry.length, entry.crc))
        at = sections[-1].end
    return sections


# SPEC [R6.6-6] to [R6.6-8], 12.1: nothing else is checked of an ancillary section
def check_section(data: bytes, section: Section) -> None:
    """Check that a section other than DATA lies within the file, its CRC-32, and the padding behind it."""
    after = section.offset + section.length
    require(section.end <= len(data), "section.truncated", len(data))
    require(zlib.crc32(memoryview(data)[section.offset : after]) == section.crc, "section.crc", section.offset)
    check_padding(data, after, "section.padding")
