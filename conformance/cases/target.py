"""A valid file, where its elements and substreams are, and how bytes are put in their place."""

from __future__ import annotations

import copy
import struct
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from refcodec.bitstream import codec, directory, syntax
from refcodec.bitstream.dimensions import layers_of
from refcodec.bitstream.header import PROLOGUE_BYTES, SIGNATURE
from refcodec.bitstream.planes import PLANE_NAMES
from refcodec.inspect.elements import Row, rows

from .checksums import Depth, layout, repair, resized

# SPEC 5: the types of elements as formats of struct.
FORMATS = {"u8": "<B", "u16": "<H", "u32": "<I", "i8": "<b", "i16": "<h", "i32": "<i", "i64": "<q", "f32": "<f"}


@dataclass(frozen=True)
class Substream:
    """A substream of a file (SPEC 5.14).

    path: as in errors: "planes.r1", "masks[chunk 0]", "weights". section: its type. data[start:end] are its bytes.
    lanes, words: how many. length_at: where a u32 says its length, or of weights and positions a length that holds it.
    """

    path: str
    section: int
    start: int
    end: int
    lanes: int
    words: int
    length_at: int

    @property
    def words_at(self) -> int:
        """Where its words begin: behind the head and the states."""
        return self.start + syntax.size_of("SubstreamHead") + 4 * self.lanes

    @property
    def raw_at(self) -> int:
        """Where its raw bytes begin."""
        return self.words_at + 2 * self.words

    def state_at(self, lane: int) -> int:
        """Where a lane's initial state is; -1 is the last lane's."""
        return range(self.start + syntax.size_of("SubstreamHead"), self.words_at, 4)[lane]


class Target:
    """A valid file, and where its elements are. Only its container need be valid."""

    def __init__(self, data: bytes) -> None:
        self.data = data
        self.header = codec.parse_container(data)
        self.sections = self.header.sections
        self.fields, self.header_end = layout(data)

    @cached_property
    def elements(self) -> dict[str, Row]:
        """All elements by path, as `refcodec inspect --hex` prints them."""
        return {row.path: row for row in rows(self.data)}

    def element(self, path: str) -> Row:
        """An element by its path; `header.` may be left out. Raises KeyError."""
        return self.elements.get(path) or self.elements[f"header.{path}"]

    def at(self, path: str) -> int:
        """Offset of an element."""
        return self.element(path).start

    def value(self, path: str) -> Any:
        """The value of an element."""
        return self.element(path).value

    def start(self, kind: int) -> int:
        """Offset of a section."""
        return self.sections[kind].start

    def content(self, kind: int) -> bytes:
        """Bytes of a section."""
        return self.data[self.sections[kind].start : self.sections[kind].end]

    def part(self, kind: int, chunk: int) -> tuple[int, int]:
        """Where a chunk's part of a section begins and ends."""
        name = directory.SECTIONS[kind].removesuffix("s")
        lengths = [self.value(f"chunk_table.entry[{n}].{name}_length") for n in range(chunk + 1)]
        end = self.start(kind) + sum(lengths)
        return end - lengths[-1], end

    @property
    def layers(self) -> list[str]:
        """The names of all layers in file order: "hyper.0", "carm.1.0"."""
        return [name for name, _, _ in layers_of(self.header.dimensions)]

    def layer_at(self, layer: str) -> int:
        """Where a layer begins: its model in mode 1, else its weights."""
        path = f"weights.{layer}.form"
        return self.at(path if path in self.elements else f"weights.{layer}.weight")

    def weight_at(self, layer: str, row: int, column: int | None) -> int:
        """Where a raw layer has a weight, or the bias of a row if column is None."""
        if column is None:
            return self.at(f"weights.{layer}.bias") + 4 * row
        fan_in = next(fan_in for name, _, fan_in in layers_of(self.header.dimensions) if name == layer)
        return self.at(f"weights.{layer}.weight") + 4 * (row * fan_in + column)

    @cached_property
    def substreams(self) -> dict[str, Substream]:
        """All substreams by path."""
        lanes = self.header.lanes
        columns = {
            directory.PLANES_SECTION: ([f"planes.{name}" for name in PLANE_NAMES], lanes.plane),
            directory.WEIGHTS: (["weights"], lanes.attribute),
        }
        chunks = range(len(self.header.chunks))
        for kind, log2 in zip(directory.CHUNKED, (lanes.mask, lanes.mask, lanes.attribute), strict=True):
            columns[kind] = ([f"{directory.SECTIONS[kind]}[chunk {n}]" for n in chunks], log2)
        found = {}
        for kind, (paths, log2) in columns.items():
            for number, path in enumerate(paths):
                head = self.elements.get(f"{path}.symbol_crc")
                # Raw weights and raw chunks are no substreams.
                if head is not None:
                    length_at, end = self._length_of(kind, number, head.start)
                    words = self.value(f"{path}.word_count")
                    found[path] = Substream(path, kind, head.start, end, 1 << log2, words, length_at)
        return found

    def _length_of(self, kind: int, number: int, start: int) -> tuple[int, int]:
        """Where a substream's length is, and where the substream ends."""
        if kind == directory.WEIGHTS:
            return self.at("directory[1].length"), self.sections[kind].end
        if kind == directory.PLANES_SECTION:
            length = self.element(f"planes.length[{number}]")
            return length.start, start + length.value
        name = directory.SECTIONS[kind].removesuffix("s")
        return self.at(f"chunk_table.entry[{number}].{name}_length"), self.part(kind, number)[1]

    def pack(self, values: dict[str, Any]) -> dict[int, bytes]:
        """Elements with other values, as bytes by their offset."""
        found = {path: self.element(path) for path in values}
        return {e.start: struct.pack(FORMATS[e.kind], values[path]) for path, e in found.items()}

    def with_values(self, values: dict[str, Any], depth: Depth = Depth.CHUNKS) -> bytes:
        """The file with other values of elements, and its checksums right down to a depth."""
        out = bytearray(self.data)
        for at, value in self.pack(values).items():
            out[at : at + len(value)] = value
        return repair(bytes(out), depth)

    def put(self, at: int, value: bytes) -> bytes:
        """The file with other bytes at an offset, checksums as they were."""
        return self.data[:at] + value + self.data[at + len(value) :]

    def flip(self, at: int, bits: int) -> dict[int, bytes]:
        """A byte with some bits turned, by its offset."""
        return {at: bytes([self.data[at] ^ bits])}

    def with_header(self, change: Callable[[Any], None]) -> bytes:
        """The file with changed fields in its header; header_length and the sections' places are right."""
        fields = copy.deepcopy(self.fields)
        change(fields)
        end = PROLOGUE_BYTES + len(syntax.build("Header", fields))
        for entry in fields.directory:
            entry.offset += end - self.header_end
        head = {"signature": SIGNATURE, "version": 0, "header_length": end - PROLOGUE_BYTES, "prologue_crc": 0}
        whole = syntax.build("Prologue", head) + syntax.build("Header", fields) + self.data[self.header_end :]
        return repair(whole)

    def with_substream(self, path: str, content: bytes) -> bytes:
        """The file with other bytes as one substream, lengths and checksums right."""
        s = self.substreams[path]
        section = self.sections[s.section]
        whole = self.data[section.start : s.start] + content + self.data[s.end : section.end]
        return resized(self.data, s.section, whole, s.length_at)

    def with_positions(self, chunk: int, content: bytes) -> bytes:
        """The file with other bytes as one chunk's positions, lengths and checksums right."""
        start, end = self.part(directory.POSITIONS, chunk)
        section = self.sections[directory.POSITIONS]
        whole = self.data[section.start : start] + content + self.data[end : section.end]
        return resized(self.data, directory.POSITIONS, whole, self.at(f"chunk_table.entry[{chunk}].position_length"))
