"""Every byte of a file, with its syntax element.

Damaged files are shown as far as they parse. No input makes a function here raise, and no function validates a file.
Headers are read without checks, thus every count from a header is limited by the available bytes.
"""

import io
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import construct as cs
import numpy as np
from numpy.typing import NDArray

from ..bitstream import ancillary, syntax
from ..bitstream.chunks import PARTS
from ..bitstream.dimensions import Dimensions, layers_of, mask_contexts
from ..bitstream.directory import DATA, FRAME, INDEX, PLANES_SECTION, WEIGHTS, section_name
from ..bitstream.header import MAJOR, PROLOGUE_BYTES, dimensions_of
from ..bitstream.index import ENTRY, ENTRY_BYTES, entries_start
from ..bitstream.planes import PLANE_NAMES
from ..bitstream.positions import PACKED
from ..bitstream.source import FileBytes, pad4
from ..bitstream.syntax import Element

# A file: its bytes, or an object that reads slices of them.
Bytes = bytes | FileBytes
# No struct of SYNTAX is longer than the largest header.
_STRUCT_BYTES_MAX = 1 << 16


@dataclass(frozen=True)
class SectionPlace:
    """The place of a section, cut to the file.

    name: that in paths. end: without the padding. stop: the start of the next section.
    """

    type: bytes
    mode: int
    name: str
    start: int
    end: int
    stop: int


@dataclass(frozen=True)
class Outline:
    """The fields of the header, as far as it parses. Nothing is checked.

    header: the fields, or None if the header is incomplete.
    header_end: the end of the header or of the file.
    dimensions: None if they cannot be read.
    sections: in file order.
    stated_end: where the last section ends by the directory, or the header's end without one.
    """

    header: Any
    header_end: int
    dimensions: Dimensions | None
    sections: list[SectionPlace]
    stated_end: int

    def place(self, kind: bytes) -> SectionPlace | None:
        """Returns the first section of a type, or None."""
        return next((place for place in self.sections if place.type == kind), None)

    @property
    def index_mode(self) -> int:
        """The mode of the index, or 0 if the file has none."""
        place = self.place(INDEX)
        return place.mode if place else 0

    @property
    def render_model(self) -> int | None:
        """The render model (SPEC 6.5), or None without a header."""
        return self.header.render_info.render_model if self.header else None

    @property
    def entries_start(self) -> int:
        """The bytes of the index before its entries (SPEC 5.11)."""
        return entries_start(self.header.dimensions.offset_count, self.index_mode)


def parse_elements(name: str, data: Bytes, start: int, end: int, path: str) -> tuple[list[Element], Any]:
    """Returns the elements of one struct in data[start:end], as far as the bytes go, and the struct if complete."""
    stream = io.BytesIO(data[start : min(end, start + _STRUCT_BYTES_MAX)])
    elements: list[Element] = []
    try:
        value = syntax.schema(name).parse_stream(stream, at=[path], elements=elements)
    except cs.ConstructError:
        value = None
    return [Element(e.path, e.kind, start + e.start, start + e.end, e.value) for e in elements], value


def outline_of(data: Bytes) -> Outline:
    """Returns the outline of a file. Without a complete header of this major version it has no sections."""
    _, prologue = parse_elements("Prologue", data, 0, PROLOGUE_BYTES, "prologue")
    if prologue is None or prologue.major != MAJOR:
        return Outline(None, min(len(data), PROLOGUE_BYTES), None, [], PROLOGUE_BYTES)
    end = min(len(data), PROLOGUE_BYTES + prologue.header_length)
    _, header = parse_elements("Header", data, PROLOGUE_BYTES, end, "header")
    if header is None:
        return Outline(None, end, None, [], end)
    sections, at = [], end
    for number, entry in enumerate(header.directory):
        name = section_name(entry.type, number)
        last, stop = at + entry.length, at + pad4(entry.length)
        sections.append(
            SectionPlace(entry.type, entry.mode, name, *(min(len(data), place) for place in (at, last, stop)))
        )
        at = stop
    dimensions = dimensions_of(header.dimensions) if header.dimensions.slice_width else None
    return Outline(header, end, dimensions, sections, at)


def rows(data: Bytes) -> Iterator[Element]:
    """Yields the elements of a file in file order. They cover every byte of any input."""
    outline = outline_of(data)
    at = 0
    for row in rows_of(data, outline):
        yield row
        at = row.end
    if at < len(data):
        yield Element("file, unused", "bytes", at, len(data), None)


def rows_of(data: Bytes, outline: Outline) -> Iterator[Element]:
    """Yields the elements of the prologue, the header and the sections of an outline."""
    yield from parse_elements("Prologue", data, 0, PROLOGUE_BYTES, "prologue")[0]
    if outline.header_end > PROLOGUE_BYTES:
        header = parse_elements("Header", data, PROLOGUE_BYTES, outline.header_end, "header")[0]
        yield from header
        used = header[-1].end if header else PROLOGUE_BYTES
        yield from _payload(used, outline.header_end, outline.header_end, "header, unused", "bytes")
    for place in outline.sections:
        used = place.start
        for row in section_rows(data, outline, place):
            yield row
            used = row.end
        yield from _payload(used, place.end, place.end, f"{place.name}, unused", "bytes")
        yield from _payload(place.end, place.stop, place.stop, f"{place.name}, padding", "padding")


def _payload(start: int, stop: int, end: int, path: str, kind: str) -> Iterator[Element]:
    """Yields one element without a value, for data[start:stop] cut at `end`, or none if it is empty."""
    stop = min(stop, end)
    if start < stop:
        yield Element(path, kind, start, stop, None)


def section_rows(data: Bytes, outline: Outline, place: SectionPlace) -> Iterator[Element]:
    """Yields the elements of a section, without the padding after it."""
    h, start, end = outline.header, place.start, place.end
    if place.type == FRAME:
        yield from parse_elements("Frame", data, start, end, "frame")[0]
    elif place.type == WEIGHTS:
        yield from _weight_rows(data, outline, place)
    elif place.type == PLANES_SECTION:
        table_rows, table = parse_elements("PlaneTable", data, start, end, "planes")
        yield from table_rows
        at = table_rows[-1].end if table_rows else start
        for plane, length in zip(PLANE_NAMES, table.length if table else [], strict=False):
            path = f"planes.{plane}"
            yield from _substream_rows(data, at, min(end, at + length), 1 << h.plane_lanes_log2, path)
            yield from _payload(min(end, at + length), at + pad4(length), end, f"{path}, padding", "padding")
            at = min(end, at + pad4(length))
    elif place.type == INDEX:
        contexts = mask_contexts(h.dimensions.offset_count)
        for i in range(min(contexts, (end - start) // 2)):
            at = start + 2 * i
            value = int.from_bytes(data[at : at + 2], "little")
            yield Element(f"index.mask_model.frequency[{i}]", "u16", at, at + 2, value)
        first = start + pad4(2 * contexts)
        yield from _payload(min(end, start + 2 * contexts), first, end, "index.mask_model.padding", "padding")
        if outline.index_mode:
            yield from parse_elements("PositionModel", data, min(first, end), end, "index.position_model")[0]
        for number, at in enumerate(range(start + outline.entries_start, end - ENTRY_BYTES + 1, ENTRY_BYTES)):
            yield from parse_elements("ChunkEntry", data, at, at + ENTRY_BYTES, f"index.entry[{number}]")[0]
    elif place.type == DATA:
        yield from _chunk_rows(data, outline, place)
    elif place.type in ancillary.TYPES and not place.mode:
        yield from _list_rows(data, place)
    else:
        yield from _payload(start, end, end, place.name, "bytes")


def _list_rows(data: Bytes, place: SectionPlace) -> Iterator[Element]:
    """Yields the elements of an ancillary section of a known type."""
    entry = ancillary.TYPES[place.type]
    item_rows, fields = parse_elements(entry.head, data, place.start, place.end, place.name)
    yield from item_rows
    at = item_rows[-1].end if item_rows else place.start
    for number in range(fields.count if fields else 0):
        item_rows, whole = parse_elements(entry.items, data, at, place.end, f"{place.name}.{entry.item}[{number}]")
        if whole is None:
            return
        yield from item_rows
        at = item_rows[-1].end


def _weight_rows(data: Bytes, outline: Outline, place: SectionPlace) -> Iterator[Element]:
    field_rows, scales = parse_elements("WeightScales", data, place.start, place.end, "weights")
    yield from field_rows
    if scales is None or outline.dimensions is None:
        return
    at, mode, end = field_rows[-1].end, place.mode, place.end
    for name, out, fan_in in layers_of(outline.dimensions):
        if mode:
            field_rows, model = parse_elements("LayerModel", data, at, end, f"weights.{name}")
            yield from field_rows
            at = field_rows[-1].end if field_rows else at
            if model is None or model.form:
                continue
        for part, count, shape in (("weight", out * fan_in, f"{out},{fan_in}"), ("bias", out, f"{out}")):
            yield from _payload(at, at + 4 * count, end, f"weights.{name}.{part}", f"f32[{shape}]")
            at = min(end, at + 4 * count)
    if mode:
        yield from _substream_rows(data, at, end, 1 << outline.header.attribute_lanes_log2, "weights")


def _substream_rows(data: Bytes, start: int, end: int, lanes: int, path: str) -> Iterator[Element]:
    """Yields the elements of a substream (SPEC 5.15). Missing bytes are omitted."""
    head_rows, head = parse_elements("Substream", data, start, end, path)
    yield from head_rows
    if head is None:
        at = head_rows[-1].end if head_rows else start
        yield from _payload(at, end, end, f"{path}, cut off", "bytes")
        return
    at = head_rows[-1].end
    words_at = min(end, at + 4 * lanes)
    raw_at = min(end, words_at + 2 * head.word_count)
    yield from _payload(at, words_at, end, f"{path}.state", f"u32[{lanes}]")
    yield from _payload(words_at, raw_at, end, f"{path}.word", f"u16[{head.word_count}]")
    yield from _payload(raw_at, end, end, f"{path}.raw", f"u8[{end - raw_at}]")


def read_index(data: Bytes, outline: Outline) -> NDArray[np.void]:
    """Returns the complete entries of the index, with the fields of SPEC 5.13."""
    place = outline.place(INDEX)
    if place is None:
        return np.zeros(0, ENTRY)
    at = place.start + outline.entries_start
    count = max(0, (place.end - at) // ENTRY_BYTES)
    return np.frombuffer(data[at : at + count * ENTRY_BYTES], ENTRY)


def _chunk_rows(data: Bytes, outline: Outline, place: SectionPlace) -> Iterator[Element]:
    h, at = outline.header, place.start
    for number, entry in enumerate(read_index(data, outline)):
        if at == place.end:
            return
        end = min(place.end, at + int(entry["length"]))
        head_rows, head = parse_elements("Chunk", data, at, end, f"chunk[{number}]")
        yield from head_rows
        used = head_rows[-1].end if head_rows else at
        for part in PARTS if head else ():
            path, length = f"{part}[chunk {number}]", head[f"{part.removesuffix('s')}_length"]
            stop = min(end, used + length)
            if part == "positions" and head.position_form != PACKED:
                yield from _payload(used, stop, end, path, f"f16[{entry['anchor_count']},3]")
            else:
                lanes = 1 << (h.attribute_lanes_log2 if part == "attributes" else h.mask_lanes_log2)
                yield from _substream_rows(data, used, stop, lanes, path)
            yield from _payload(stop, used + pad4(length), end, f"{path}, padding", "padding")
            used = min(end, used + pad4(length))
        yield from _payload(used, end, end, f"chunk[{number}], unused", "bytes")
        at = end
