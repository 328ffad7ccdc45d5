"""Repairs lengths and checksums of changed files, wherever they can be found."""

import zlib
from enum import IntEnum

import construct

from refcodec.bitstream import codec, directory, syntax
from refcodec.bitstream.header import PROLOGUE_BYTES
from refcodec.bitstream.index import ENTRY_BYTES as INDEX_ENTRY_BYTES
from refcodec.bitstream.index import entries_start
from refcodec.bitstream.source import pad4

# SPEC 5.6: bytes of an entry of the directory.
ENTRY_BYTES = syntax.size_of("DirectoryEntry")


class Depth(IntEnum):
    """The depth of repair: checksums of this depth and of all outer ones are repaired."""

    NOTHING = 0
    PROLOGUE = 1
    HEADER = 2
    SECTIONS = 3
    CHUNKS = 4


def layout(data: bytes) -> tuple[construct.Container, int]:
    """Returns the fields of a file's header, and its end with the CRC-32. Checksums are not compared.

    In a file of a later minor version the header can be longer (SPEC 12.3).

    Raises construct.ConstructError if the header does not parse.
    """
    fields, size = syntax.parse("Header", data, PROLOGUE_BYTES)
    return fields, PROLOGUE_BYTES + size


def repair(data: bytes, depth: Depth = Depth.CHUNKS) -> bytes:
    """Returns the file with repaired CRC-32s down to a depth. data: at least a prologue."""
    out = bytearray(data)
    end = PROLOGUE_BYTES + int.from_bytes(data[12:16], "little")
    if depth >= Depth.SECTIONS:
        _repair_sections(out, end, depth)
    if depth >= Depth.HEADER and end <= len(out):
        out[end - 4 : end] = _crc(out[PROLOGUE_BYTES : end - 4])
    if depth >= Depth.PROLOGUE:
        out[16:20] = _crc(out[:16])
    return bytes(out)


def lengthened(data: bytes, kind: bytes, length: int) -> tuple[bytes, int]:
    """Returns the bytes of a file before a section with a changed length, and the resulting length of the file.

    kind: the type of the section. For DATA the last chunk changes, also in the index. Any bytes may follow. The
    CRC-32s of the header and of the returned bytes are right.
    """
    fields, end = layout(data)
    number = [entry.type for entry in fields.directory].index(kind)
    entry = end - 4 - ENTRY_BYTES * (fields.section_count - number)
    out = bytearray(data[: end + sum(pad4(e.length) for e in fields.directory[:number])])
    out[entry + 8 : entry + 16] = length.to_bytes(8, "little")
    rest = sum(pad4(e.length) for e in fields.directory[number + 1 :])
    if kind == directory.DATA:
        at = len(out) - INDEX_ENTRY_BYTES
        last = int.from_bytes(out[at : at + 4], "little")
        out[at : at + 4] = (last + length - fields.directory[number].length).to_bytes(4, "little")
    return repair(bytes(out), Depth.SECTIONS), len(out) + pad4(length) + rest


def _crc(data: bytearray) -> bytes:
    return zlib.crc32(data).to_bytes(4, "little")


def _repair_sections(out: bytearray, end: int, depth: Depth) -> None:
    """Repairs the CRC-32s of the chunks, then those of the sections."""
    try:
        fields, found_end = layout(bytes(out[:end]))
    except construct.ConstructError:
        return
    places, at = [], end
    for e in fields.directory:
        places.append((e.type, e.mode, at, at + e.length))
        at += pad4(e.length)
    if depth >= Depth.CHUNKS:
        _repair_chunks(out, fields, places)
    entry = found_end - 4 - ENTRY_BYTES * fields.section_count
    for kind, _, first, last in places:
        if kind != directory.DATA:
            out[entry + 16 : entry + 20] = _crc(out[first:last])
        entry += ENTRY_BYTES


def _repair_chunks(out: bytearray, fields: construct.Container, places: list[tuple[bytes, int, int, int]]) -> None:
    """Repairs the CRC-32s of the chunks, if the index and the chunks exist."""
    span = {kind: (mode, first, last) for kind, mode, first, last in places}
    if not {directory.INDEX, directory.DATA} <= span.keys():
        return
    mode, first, last = span[directory.INDEX]
    at = span[directory.DATA][1]
    first += entries_start(fields.dimensions.offset_count, min(mode, 1))
    for entry in range(first, min(last, len(out)) - INDEX_ENTRY_BYTES + 1, INDEX_ENTRY_BYTES):
        length = int.from_bytes(out[entry : entry + 4], "little")
        out[entry + 4 : entry + 8] = _crc(out[at : at + length])
        at += length


def resized(data: bytes, kind: bytes, content: bytes) -> bytes:
    """Returns a valid file with other content in one critical section, and a right directory and checksums.

    kind: the section's type.
    """
    header = codec.parse_container(data)
    old = header.section(kind)
    padded = content + bytes(pad4(len(content)) - len(content))
    out = bytearray(data[: old.start] + padded + data[old.end :])
    entry = layout(data)[1] - 4 - ENTRY_BYTES * (len(header.sections) - old.number)
    out[entry + 8 : entry + 16] = len(content).to_bytes(8, "little")
    return repair(bytes(out))
