"""Files with other bytes, whose lengths and checksums are made right again wherever they can be found."""

from __future__ import annotations

import zlib
from enum import IntEnum

import construct

from refcodec.bitstream import codec, directory, syntax
from refcodec.bitstream.chunks import CHUNK_ENTRY_BYTES, entries_start
from refcodec.bitstream.header import PROLOGUE_BYTES

# SPEC 5.6: bytes of an entry of the directory.
ENTRY_BYTES = syntax.size_of("DirectoryEntry")


class Depth(IntEnum):
    """How far in the checksums are made right: those of one depth, and all that lie further out."""

    NOTHING = 0
    PROLOGUE = 1
    HEADER = 2
    SECTIONS = 3
    CHUNKS = 4


def layout(data: bytes) -> tuple[construct.Container, int]:
    """The fields of a file's header, and where it ends. Checksums are not looked at.

    Raises construct.ConstructError if the header does not parse.
    """
    fields, size = syntax.parse("Header", data, PROLOGUE_BYTES)
    return fields, PROLOGUE_BYTES + size


def repair(data: bytes, depth: Depth = Depth.CHUNKS) -> bytes:
    """The file with its CRC-32s made right down to a depth. Any bytes of at least a prologue will do."""
    out = bytearray(data)
    end = PROLOGUE_BYTES + int.from_bytes(data[12:16], "little")
    if depth >= Depth.SECTIONS:
        _repair_sections(out, end, depth)
    if depth >= Depth.HEADER and end <= len(out):
        out[end - 4 : end] = _crc(out[PROLOGUE_BYTES : end - 4])
    if depth >= Depth.PROLOGUE:
        out[16:20] = _crc(out[:16])
    return bytes(out)


def _crc(data: bytearray) -> bytes:
    return zlib.crc32(data).to_bytes(4, "little")


def _repair_sections(out: bytearray, end: int, depth: Depth) -> None:
    """The CRC-32s of the sections, and before them those of the chunks' parts."""
    try:
        fields, found_end = layout(bytes(out[:end]))
    except construct.ConstructError:
        return
    if found_end != end:
        return
    if depth >= Depth.CHUNKS:
        _repair_chunks(out, fields, end)
    entry = end - 4 - ENTRY_BYTES * fields.section_count
    for e in fields.directory:
        out[entry + 12 : entry + 16] = _crc(out[e.offset : e.offset + e.length])
        entry += ENTRY_BYTES


def _repair_chunks(out: bytearray, fields: construct.Container, end: int) -> None:
    """The CRC-32s of the chunks' parts, if all sections are there and the chunk table does not lie in the header."""
    span = {e.type: (e.offset, e.offset + e.length) for e in fields.directory}
    if not set(directory.SECTIONS) <= span.keys() or span[directory.CHUNK_TABLE][0] < end:
        return
    mode = next(e.mode for e in fields.directory if e.type == directory.POSITIONS)
    first, table_end = span[directory.CHUNK_TABLE]
    first += entries_start(fields.dimensions.offset_count, min(mode, 1))
    at = [span[kind][0] for kind in directory.CHUNKED]
    for entry in range(first, min(table_end, len(out)), CHUNK_ENTRY_BYTES):
        for part in range(3):
            field = entry + 8 * part
            length = int.from_bytes(out[field : field + 4], "little")
            out[field + 4 : field + 8] = _crc(out[at[part] : at[part] + length])
            at[part] += length


def resized(data: bytes, kind: int, content: bytes, length_at: int | None = None) -> bytes:
    """A valid file with other bytes in one section, as many as there are: the directory and all checksums are right.

    kind: the section's type. length_at: where a u32 of the old file says a length that grows with the section's.
    """
    sections = codec.parse_container(data).sections
    old = sections[kind]
    change = len(content) - (old.end - old.start)
    out = bytearray(data[: old.start] + content + data[old.end :])
    entry = layout(data)[1] - 4 - ENTRY_BYTES * len(sections)
    # In the order of the directory: an empty section may begin where this one begins, and lie before or behind it.
    moved = 0
    for s in sections.values():
        out[entry + 4 : entry + 8] = (s.start + moved).to_bytes(4, "little")
        if s.type == kind:
            out[entry + 8 : entry + 12] = len(content).to_bytes(4, "little")
            moved = change
        entry += ENTRY_BYTES
    if length_at is not None:
        grown = int.from_bytes(data[length_at : length_at + 4], "little") + change
        out[length_at : length_at + 4] = grown.to_bytes(4, "little")
    return repair(bytes(out))
