"""Where the elements of a file are, and files with other bytes there whose lengths and checksums are right again."""

from __future__ import annotations

import copy
import zlib
from collections.abc import Callable
from typing import Any

import construct

from refcodec.bitstream import codec, dimensions, directory, syntax, weights
from refcodec.bitstream.chunks import entries_start
from refcodec.bitstream.header import PROLOGUE_BYTES, SIGNATURE, Header
from refcodec.bitstream.positions import PACKED


def layout(data: bytes) -> tuple[Any, int]:
    """The header's fields and its end, checksums aside. For files whose header parses."""
    fields, size = syntax.parse("Header", data, PROLOGUE_BYTES)
    return fields, PROLOGUE_BYTES + size


def repair(data: bytes, chunks: bool = True) -> bytes:
    """The file with the CRC-32s of chunks, sections, header and prologue made right wherever they can be found."""
    out = bytearray(data)
    end = PROLOGUE_BYTES + int.from_bytes(data[12:16], "little")
    try:
        fields, found_end = layout(data[:end])
    except construct.ConstructError:
        found_end = -1
    if found_end == end:
        _repair_sections(out, fields, end, chunks)
    if end <= len(out):
        out[end - 4 : end] = zlib.crc32(out[PROLOGUE_BYTES : end - 4]).to_bytes(4, "little")
    out[16:20] = zlib.crc32(out[:16]).to_bytes(4, "little")
    return bytes(out)


def _repair_sections(out: bytearray, fields: construct.Container, end: int, chunks: bool) -> None:
    """The CRC-32s of the chunks' parts and of the sections."""
    span = {e.type: (e.offset, e.offset + e.length) for e in fields.directory}
    # A chunk table that a wrong offset puts into the header is left alone.
    if chunks and set(directory.SECTIONS) <= span.keys() and span[directory.CHUNK_TABLE][0] >= end:
        k = fields.dimensions.offset_count
        mode = next(e.mode for e in fields.directory if e.type == directory.POSITIONS)
        table = span[directory.CHUNK_TABLE][0] + entries_start(k, min(mode, 1))
        at = [span[t][0] for t in directory.CHUNKED]
        for entry in range(table, min(span[directory.CHUNK_TABLE][1], len(out)), 24):
            for part in range(3):
                length = int.from_bytes(out[entry + 8 * part : entry + 8 * part + 4], "little")
                out[entry + 8 * part + 4 : entry + 8 * part + 8] = zlib.crc32(
                    out[at[part] : at[part] + length]
                ).to_bytes(4, "little")
                at[part] += length
    entry_at = end - 4 - 16 * fields.section_count
    for i, e in enumerate(fields.directory):
        crc = zlib.crc32(out[e.offset : e.offset + e.length])
        out[entry_at + 16 * i + 12 : entry_at + 16 * i + 16] = crc.to_bytes(4, "little")


def resized(data: bytes, kind: int, content: bytes, length_at: int | None = None) -> bytes:
    """A valid file with one section's bytes replaced by more or fewer, directory and checksums made right; the u32 of the old file
    at `length_at`, if any, grows with them."""
    sections = codec.parse_container(data).sections
    old = sections[kind]
    change = len(content) - (old.end - old.start)
    out = bytearray(data[: old.start] + content + data[old.end :])
    _, end = layout(data)
    entry = end - 4 - 16 * len(sections)
    # In the order of the directory: an empty section may start where this one starts, and lie before or behind it.
    moved = 0
    for s in sections.values():
        out[entry + 4 : entry + 8] = (s.start + moved).to_bytes(4, "little")
        if s.type == kind:
            out[entry + 8 : entry + 12] = len(content).to_bytes(4, "little")
            moved = change
        entry += 16
    if length_at is not None:
        grown = int.from_bytes(data[length_at : length_at + 4], "little") + change
        out[length_at : length_at + 4] = grown.to_bytes(4, "little")
    return repair(bytes(out))


def substreams(data: bytes) -> list[tuple[int, int, int, int]]:
    """(section, start, length, where the file says the length; that of weights and positions is larger) of each substream."""
    header = codec.parse_container(data)
    sections = header.sections

    def u32(at: int) -> int:
        return int.from_bytes(data[at : at + 4], "little")

    start = sections[directory.PLANES_SECTION].start
    places = [(directory.PLANES_SECTION, start + 4 * i) for i in range(5)]
    table = sections[directory.CHUNK_TABLE].start
    table += entries_start(header.dimensions.offset_count, sections[directory.POSITIONS].mode)
    for column, kind in enumerate(directory.CHUNKED):
        places += [(kind, table + 24 * chunk + 8 * column) for chunk in range(len(header.chunks))]
    next_at = {kind: sections[kind].start for kind in directory.CHUNKED}
    next_at[directory.PLANES_SECTION] = start + 20
    found = []
    for kind, length_at in places:
        at, length = next_at[kind], u32(length_at)
        next_at[kind] += length
        if kind != directory.POSITIONS:
            found.append((kind, at, length, length_at))
        elif sections[kind].mode and data[at] == PACKED:
            found.append((kind, at + 1, length - 1, length_at))
    if sections[directory.WEIGHTS].mode:
        at, end = weight_stream(data, header), sections[directory.WEIGHTS].end
        elements = syntax.parse_elements("Header", data, PROLOGUE_BYTES, "")
        length_at = next(e.start for e in elements if e.path == "directory[1].length")
        found.append((directory.WEIGHTS, at, end - at, length_at))
    return found


def weight_stream(data: bytes, header: Header) -> int:
    """Where the substream of the weights begins, in mode 1."""
    at = header.sections[directory.WEIGHTS].start + 2 + header.dimensions.carm_inputs
    for _, out, fan_in in dimensions.layers_of(header.dimensions):
        at += syntax.SCHEMAS["LayerModel"].sizeof(at=None) + (0 if data[at] else 4 * out * (fan_in + 1))
    return at


class Target:
    """A valid file, and where its elements are."""

    def __init__(self, data: bytes) -> None:
        self.data = data
        self.header = codec.parse_container(data)
        self.sections = self.header.sections
        self.fields, self.header_end = layout(data)
        self.substreams = substreams(data)
        d = self.header.dimensions
        self.table = self.sections[directory.CHUNK_TABLE].start
        self.position_mode = self.sections[directory.POSITIONS].mode
        self.position_model = self.table + d.offset_count * (d.offset_count + 1)
        self.entries = self.table + entries_start(d.offset_count, self.position_mode)
        self.elements = {e.path: e.start for e in syntax.parse_elements("Header", data, PROLOGUE_BYTES, "")}
        frame = self.sections[directory.FRAME].start
        self.elements |= {e.path: e.start for e in syntax.parse_elements("Frame", data, frame, "frame")}

    def at(self, path: str) -> int:
        """Offset of an element of the header, or of the frame if the path begins so."""
        return self.elements[path]

    def start(self, kind: int) -> int:
        """Offset of a section."""
        return self.sections[kind].start

    def content(self, kind: int) -> bytes:
        """Bytes of a section."""
        return self.data[self.sections[kind].start : self.sections[kind].end]

    def put(self, at: int, value: bytes) -> bytes:
        """The file with some bytes changed, checksums as they were."""
        return self.data[:at] + value + self.data[at + len(value) :]

    def with_header(self, change: Callable[[Any], None]) -> bytes:
        """The file with its header's fields changed, header_length and the sections' places made right."""
        fields = copy.deepcopy(self.fields)
        change(fields)
        end = PROLOGUE_BYTES + len(syntax.build("Header", fields))
        for entry in fields.directory:
            entry.offset += end - self.header_end
        head = syntax.build("Prologue", {"signature": SIGNATURE, "version": 0, "header_length": 0, "prologue_crc": 0})
        head = head[:12] + (end - PROLOGUE_BYTES).to_bytes(4, "little") + head[16:]
        return repair(head + syntax.build("Header", fields) + self.data[self.header_end :])


def position_parts(t: Target) -> list[tuple[int, int, int]]:
    """(start, length, anchors) of each chunk's positions."""
    found, at = [], t.start(directory.POSITIONS)
    for number, chunk in enumerate(t.header.chunks):
        length = int.from_bytes(t.data[t.entries + 24 * number :][:4], "little")
        found.append((at, length, len(chunk)))
        at += length
    return found


def with_positions(t: Target, number: int, content: bytes) -> bytes:
    """The file with other bytes as one chunk's positions."""
    start, length, _ = position_parts(t)[number]
    section = t.sections[directory.POSITIONS]
    whole = t.data[section.start : start] + content + t.data[start + length : section.end]
    return resized(t.data, directory.POSITIONS, whole, t.entries + 24 * number)


def grid_layers(t: Target) -> dict[str, int]:
    """Where each layer's model is, the raw one's first."""
    start = t.start(directory.WEIGHTS)
    return weights.parse_weights(
        t.data, start, t.sections[directory.WEIGHTS].end, 1, t.header.dimensions, 1 << t.header.lanes.attribute
    ).starts


def lanes_of(t: Target, kind: int) -> int:
    lanes = t.header.lanes
    return 1 << {
        directory.PLANES_SECTION: lanes.plane,
        directory.POSITIONS: lanes.mask,
        directory.MASKS: lanes.mask,
    }.get(kind, lanes.attribute)


def with_stream(t: Target, stream: tuple[int, int, int, int], content: bytes) -> bytes:
    """The file with other bytes as one substream."""
    kind, start, length, length_at = stream
    section = t.sections[kind]
    return resized(
        t.data, kind, t.data[section.start : start] + content + t.data[start + length : section.end], length_at
    )
