"""Every byte of a file, with its syntax element.

Damaged files are shown as far as they parse. No bytes make a function here raise, and no function here judges a file.
Headers are read without checks. So every count from a header is limited by the bytes that are there.
"""

from __future__ import annotations

import io
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import construct as cs
import numpy as np
from numpy.typing import NDArray

from ..bitstream import syntax
from ..bitstream.chunks import CHUNK_ENTRY_BYTES, PARTS, entries_start
from ..bitstream.dimensions import Dimensions, layers_of, mask_contexts
from ..bitstream.directory import SECTIONS
from ..bitstream.header import PROLOGUE_BYTES, VERSION, dimensions_of
from ..bitstream.planes import PLANE_NAMES
from ..bitstream.positions import PACKED

# No struct of SYNTAX is longer than the largest header.
_STRUCT_BYTES_MAX = 1 << 16


@dataclass(frozen=True)
class Row:
    """A syntax element in a file.

    start, end: data[start:end] are its bytes. path: its name. kind: its type. value: None for a payload.
    """

    start: int
    end: int
    path: str
    kind: str
    value: Any = None


@dataclass(frozen=True)
class Outline:
    """What the header says of a file, as far as it parses. Nothing is checked.

    header: the fields, or None if the header is not whole.
    header_end: where the header ends, or where the file does.
    dimensions: None if they cannot be read.
    sections: (type, start, end) in file order, cut to the file.
    """

    header: Any
    header_end: int
    dimensions: Dimensions | None
    sections: list[tuple[int, int, int]]

    def mode(self, name: str) -> int:
        """Returns the mode of a section by its name, or 0 if the file does not have the section."""
        return max((entry.mode for entry in self.header.directory if SECTIONS.get(entry.type) == name), default=0)

    @property
    def position_mode(self) -> int:
        """The mode of the positions."""
        return self.mode("positions")

    @property
    def entries_start(self) -> int:
        """The bytes of the chunk table before its entries (SPEC 5.10)."""
        return entries_start(self.header.dimensions.offset_count, self.position_mode)


def parse_elements(name: str, data: bytes, start: int, end: int, path: str) -> tuple[list[Row], Any]:
    """Returns the elements of one struct in data[start:end], as far as the bytes go, and the struct if it is whole."""
    stream = io.BytesIO(data[start : min(end, start + _STRUCT_BYTES_MAX)])
    found: list[syntax.Element] = []
    try:
        value = syntax.SCHEMAS[name].parse_stream(stream, at=[path], elements=found)
    except cs.ConstructError:
        value = None
    return [Row(start + e.start, start + e.end, e.path, e.kind, e.value) for e in found], value


def outline_of(data: bytes) -> Outline:
    """Returns the outline of a file. Without a whole header of this version it has no sections."""
    _, prologue = parse_elements("Prologue", data, 0, PROLOGUE_BYTES, "prologue")
    if prologue is None or prologue.version != VERSION:
        return Outline(None, min(len(data), PROLOGUE_BYTES), None, [])
    end = min(len(data), PROLOGUE_BYTES + prologue.header_length)
    _, header = parse_elements("Header", data, PROLOGUE_BYTES, end, "header")
    if header is None:
        return Outline(None, end, None, [])
    sections, at = [], end
    for entry in header.directory:
        stop = min(len(data), at + entry.length)
        sections.append((entry.type, at, stop))
        at = stop
    dimensions = dimensions_of(header.dimensions) if header.dimensions.slice_width else None
    return Outline(header, end, dimensions, sections)


def rows(data: bytes) -> Iterator[Row]:
    """Yields the elements of a file in file order. They cover every byte, whatever the bytes are."""
    outline = outline_of(data)
    at = 0
    for row in rows_of(data, outline):
        yield row
        at = row.end
    if at < len(data):
        yield Row(at, len(data), "bytes that no element uses", "bytes")


def rows_of(data: bytes, outline: Outline) -> Iterator[Row]:
    """Yields the elements of the prologue, the header and the sections of an outline."""
    yield from parse_elements("Prologue", data, 0, PROLOGUE_BYTES, "prologue")[0]
    if outline.header_end > PROLOGUE_BYTES:
        header = parse_elements("Header", data, PROLOGUE_BYTES, outline.header_end, "header")[0]
        yield from header
        used = header[-1].end if header else PROLOGUE_BYTES
        yield from _payload(used, outline.header_end, outline.header_end, "header, bytes that no field uses", "bytes")
    for kind, start, end in outline.sections:
        used = start
        for row in section_rows(data, outline, kind, start, end):
            yield row
            used = row.end
        name = SECTIONS.get(kind, f"extension_{kind:02x}")
        yield from _payload(used, end, end, name if used == start else f"{name}, bytes that no element uses", "bytes")


def _payload(start: int, stop: int, end: int, path: str, kind: str) -> Iterator[Row]:
    """Yields one row for data[start:stop], cut at `end`, or none if it is empty."""
    stop = min(stop, end)
    if start < stop:
        yield Row(start, stop, path, kind)


def section_rows(data: bytes, outline: Outline, kind: int, start: int, end: int) -> Iterator[Row]:
    """Yields the elements of a section in data[start:end]. kind: its type."""
    h = outline.header
    name = SECTIONS.get(kind)
    if name == "frame":
        yield from parse_elements("Frame", data, start, end, "frame")[0]
    elif name == "weights":
        yield from _weight_rows(data, outline, start, end)
    elif name == "planes":
        found, table = parse_elements("PlaneTable", data, start, end, "planes")
        yield from found
        at = found[-1].end if found else start
        for plane, length in zip(PLANE_NAMES, table.length if table else [], strict=False):
            yield from _substream_rows(data, at, min(end, at + length), 1 << h.plane_lanes_log2, f"planes.{plane}")
            at = min(end, at + length)
    elif name == "chunk_table":
        contexts = mask_contexts(h.dimensions.offset_count)
        for i in range(min(contexts, (end - start) // 2)):
            at = start + 2 * i
            yield Row(at, at + 2, f"chunk_table.mask_model[{i}]", "u16", int.from_bytes(data[at : at + 2], "little"))
        if outline.position_mode:
            yield from parse_elements("PositionModel", data, start + 2 * contexts, end, "chunk_table.position_model")[0]
        for number, at in enumerate(
            range(start + outline.entries_start, end - CHUNK_ENTRY_BYTES + 1, CHUNK_ENTRY_BYTES)
        ):
            yield from parse_elements("ChunkEntry", data, at, at + CHUNK_ENTRY_BYTES, f"chunk_table.entry[{number}]")[0]
    elif name in ("positions", "masks", "attributes"):
        yield from _chunk_rows(data, outline, name, start, end)
    else:
        yield from _payload(start, end, end, f"extension_{kind:02x}", "bytes")


def _weight_rows(data: bytes, outline: Outline, start: int, end: int) -> Iterator[Row]:
    found, scales = parse_elements("WeightScales", data, start, end, "weights")
    yield from found
    if scales is None or outline.dimensions is None:
        return
    at, mode = found[-1].end, outline.mode("weights")
    for name, out, fan_in in layers_of(outline.dimensions):
        if mode:
            found, model = parse_elements("LayerModel", data, at, end, f"weights.{name}")
            yield from found
            at = found[-1].end if found else at
            if model is None or model.form:
                continue
        for part, count, shape in (("weight", out * fan_in, f"{out},{fan_in}"), ("bias", out, f"{out}")):
            yield from _payload(at, at + 4 * count, end, f"weights.{name}.{part}", f"f32[{shape}]")
            at = min(end, at + 4 * count)
    if mode:
        yield from _substream_rows(data, at, end, 1 << outline.header.attribute_lanes_log2, "weights")


def _substream_rows(data: bytes, start: int, end: int, lanes: int, path: str) -> Iterator[Row]:
    """Yields the elements of a substream (SPEC 5.14). What is cut off is left out."""
    found, head = parse_elements("SubstreamHead", data, start, end, path)
    yield from found
    if head is None:
        at = found[-1].end if found else start
        yield from _payload(at, end, end, path, "bytes")
        return
    at = found[-1].end
    words_at = min(end, at + 4 * lanes)
    raw_at = min(end, words_at + 2 * head.word_count)
    yield from _payload(at, words_at, end, f"{path}.state", f"u32[{lanes}]")
    yield from _payload(words_at, raw_at, end, f"{path}.word", f"u16[{head.word_count}]")
    yield from _payload(raw_at, end, end, f"{path}.raw", f"u8[{end - raw_at}]")


def read_chunk_table(data: bytes, outline: Outline) -> NDArray[np.uint32]:
    """Returns the entries of the chunk table that are there, uint32 [chunks, 6], with the fields of SPEC 5.10.

    The array is a view of the file: a file may claim many chunks.
    """
    for kind, start, end in outline.sections:
        if SECTIONS.get(kind) == "chunk_table":
            at = start + outline.entries_start
            count = max(0, (end - at) // CHUNK_ENTRY_BYTES)
            return np.frombuffer(data, "<u4", 6 * count, min(at, end)).reshape(-1, 6)
    return np.zeros((0, 6), np.uint32)


def chunk_anchors(header: Any, number: int) -> int:
    """Returns how many anchors a chunk has. header: the parsed struct. number: that of the chunk."""
    return int(min(header.chunk_size, max(0, header.anchor_count - number * header.chunk_size)))


def _chunk_rows(data: bytes, outline: Outline, name: str, start: int, end: int) -> Iterator[Row]:
    h = outline.header
    column = PARTS.index(name)
    at = start
    for number, length in enumerate(read_chunk_table(data, outline)[:, 2 * column]):
        if at == end:
            return
        stop, path = min(end, at + int(length)), f"{name}[chunk {number}]"
        if name == "positions" and outline.position_mode and at < stop:
            yield Row(at, at + 1, f"{path}.form", "u8", data[at])
            at += 1
        if name == "positions" and not (outline.position_mode and data[at - 1] == PACKED):
            kind = f"f16[{chunk_anchors(h, number)},3]"
            yield from _payload(at, stop, end, path, kind)
        else:
            lanes = 1 << (h.attribute_lanes_log2 if name == "attributes" else h.mask_lanes_log2)
            yield from _substream_rows(data, at, stop, lanes, path)
        at = stop
