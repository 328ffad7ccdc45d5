"""A valid file with the places of its elements and substreams, which can be replaced."""

from __future__ import annotations

import copy
import struct
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from refcodec.bitstream import codec, directory, syntax
from refcodec.bitstream.chunks import PARTS
from refcodec.bitstream.dimensions import layers_of
from refcodec.bitstream.directory import Section
from refcodec.bitstream.header import PROLOGUE_BYTES, SIGNATURE
from refcodec.bitstream.index import CHUNK_HEAD_BYTES
from refcodec.bitstream.planes import PLANE_NAMES
from refcodec.bitstream.source import pad4
from refcodec.inspect.elements import Row, rows

from .checksums import Depth, layout, repair, resized

# SPEC 5: the types of elements as formats of struct.
FORMATS = {
    "u8": "<B",
    "u16": "<H",
    "u32": "<I",
    "u64": "<Q",
    "i8": "<b",
    "i16": "<h",
    "i32": "<i",
    "i64": "<q",
    "f16": "<e",
    "f32": "<f",
}


@dataclass(frozen=True)
class Substream:
    """A substream of a file (SPEC 5.15).

    path: as in errors: "planes.r1", "masks[chunk 0]", "weights". section: its type. data[start:end] are its bytes.
    lanes, words: their numbers. length_at: offset of a u32 with its length or, for weights and positions, of a length
    that includes it.
    """

    path: str
    section: bytes
    start: int
    end: int
    lanes: int
    words: int
    length_at: int

    @property
    def words_at(self) -> int:
        """The offset of its words, after the head and the states."""
        return self.start + syntax.size_of("Substream") + 4 * self.lanes

    @property
    def raw_at(self) -> int:
        """The offset of its raw bytes."""
        return self.words_at + 2 * self.words

    def state_at(self, lane: int) -> int:
        """Returns the offset of a lane's initial state; -1 is the last lane."""
        return range(self.start + syntax.size_of("Substream"), self.words_at, 4)[lane]


class Target:
    """A valid file and the places of its elements. Only its container must be valid."""

    def __init__(self, data: bytes) -> None:
        self.data = data
        self.header = codec.parse_container(data)
        self.sections = {s.type: s for s in self.header.sections if s.type in directory.SECTIONS}
        self.fields = layout(data)[0]
        self.header_end = PROLOGUE_BYTES + int.from_bytes(data[12:16], "little")

    @cached_property
    def elements(self) -> dict[str, Row]:
        """All elements by path, as in `refcodec inspect --hex`."""
        return {row.path: row for row in rows(self.data)}

    def has(self, path: str) -> bool:
        """Whether there is an element with a path."""
        return path in self.elements or f"header.{path}" in self.elements

    def element(self, path: str) -> Row:
        """Returns an element by its path; `header.` may be omitted. Raises KeyError."""
        return self.elements.get(path) or self.elements[f"header.{path}"]

    def at(self, path: str) -> int:
        """Returns the offset of an element."""
        return self.element(path).start

    def value(self, path: str) -> Any:
        """Returns the value of an element."""
        return self.element(path).value

    def section(self, kind: bytes) -> Section:
        """Returns the first section of a type."""
        return next(section for section in self.header.sections if section.type == kind)

    def start(self, kind: bytes) -> int:
        """Returns the offset of a critical section."""
        return self.sections[kind].start

    def content(self, kind: bytes) -> bytes:
        """Returns the bytes of a critical section."""
        section = self.sections[kind]
        return self.data[section.start : section.start + section.length]

    def chunk_at(self, chunk: int) -> int:
        """Returns the offset of a chunk."""
        lengths = (self.value(f"index.entry[{n}].length") for n in range(chunk))
        return self.start(directory.DATA) + sum(lengths)

    def part(self, name: str, chunk: int) -> tuple[int, int]:
        """Returns the range of a part of a chunk, without its padding. name: as in PARTS."""
        at = self.chunk_at(chunk) + CHUNK_HEAD_BYTES
        for part in PARTS:
            length = self.value(f"chunk[{chunk}].{part.removesuffix('s')}_length")
            if part == name:
                return at, at + length
            at += pad4(length)
        raise KeyError(name)

    @property
    def layers(self) -> list[str]:
        """The names of all layers in file order: "hyper.0", "carm.1.0"."""
        return [name for name, _, _ in layers_of(self.header.dimensions)]

    def layer_at(self, layer: str) -> int:
        """Returns the offset of a layer: its model in mode 1, else its weights."""
        path = f"weights.{layer}.form"
        return self.at(path if path in self.elements else f"weights.{layer}.weight")

    def weight_at(self, layer: str, row: int, column: int | None) -> int:
        """Returns the offset of a weight of a raw layer, or of the bias of a row if column is None."""
        if column is None:
            return self.at(f"weights.{layer}.bias") + 4 * row
        fan_in = next(fan_in for name, _, fan_in in layers_of(self.header.dimensions) if name == layer)
        return self.at(f"weights.{layer}.weight") + 4 * (row * fan_in + column)

    @cached_property
    def substreams(self) -> dict[str, Substream]:
        """All substreams by path."""
        lanes = self.header.lanes
        named = [("weights", directory.WEIGHTS, lanes.attribute)]
        named += [(f"planes.{name}", directory.PLANES_SECTION, lanes.plane) for name in PLANE_NAMES]
        named += [
            (f"{part}[chunk {n}]", directory.DATA, lanes.attribute if part == "attributes" else lanes.mask)
            for n in range(self.header.chunk_count)
            for part in PARTS
        ]
        found = {}
        for path, kind, log2 in named:
            head = self.elements.get(f"{path}.symbol_crc")
            # Raw weights and raw chunks are not substreams.
            if head is not None:
                length_at, end = self._length_of(path, kind, head.start)
                words = self.value(f"{path}.word_count")
                found[path] = Substream(path, kind, head.start, end, 1 << log2, words, length_at)
        return found

    def _length_of(self, path: str, kind: bytes, start: int) -> tuple[int, int]:
        """Returns the offset of a substream's length, and its end."""
        if kind == directory.WEIGHTS:
            section = self.sections[kind]
            return self.at(f"directory[{section.number}].length"), section.start + section.length
        if kind == directory.PLANES_SECTION:
            length = self.element(f"planes.length[{PLANE_NAMES.index(path.removeprefix('planes.'))}]")
            return length.start, start + length.value
        part, _, number = path.removesuffix("]").partition("[chunk ")
        return self.at(f"chunk[{number}].{part.removesuffix('s')}_length"), self.part(part, int(number))[1]

    def pack(self, values: dict[str, Any]) -> dict[int, bytes]:
        """Returns elements with other values, as bytes by offset. A value is a number or bytes."""
        return {self.at(path): self._packed(path, value) for path, value in values.items()}

    def _packed(self, path: str, value: Any) -> bytes:
        return value if isinstance(value, bytes) else struct.pack(FORMATS[self.element(path).kind], value)

    def with_values(self, values: dict[str, Any], depth: Depth = Depth.CHUNKS) -> bytes:
        """Returns the file with other values of elements, and right checksums down to a depth."""
        out = bytearray(self.data)
        for at, value in self.pack(values).items():
            out[at : at + len(value)] = value
        return repair(bytes(out), depth)

    def put(self, at: int, value: bytes) -> bytes:
        """Returns the file with other bytes at an offset, and unchanged checksums."""
        return self.data[:at] + value + self.data[at + len(value) :]

    def flip(self, at: int, bits: int) -> dict[int, bytes]:
        """Returns a byte with flipped bits, by its offset."""
        return {at: bytes([self.data[at] ^ bits])}

    def with_header(self, change: Callable[[Any], None]) -> bytes:
        """Returns the file with changed fields in its header, and a right header_length.

        Not for a file of a later minor version, whose header has more fields.
        """
        fields = copy.deepcopy(self.fields)
        change(fields)
        built = syntax.build("Header", fields)
        head = {"signature": SIGNATURE, "major": 0, "minor": 0, "header_length": len(built), "prologue_crc": 0}
        return repair(syntax.build("Prologue", head) + built + self.data[self.header_end :])

    def with_substream(self, path: str, content: bytes) -> bytes:
        """Returns the file with other bytes as one substream, and right lengths and checksums."""
        s = self.substreams[path]
        if s.section == directory.DATA:
            part, _, number = path.removesuffix("]").partition("[chunk ")
            return self.with_part(part, int(number), content)
        section = self.sections[s.section]
        if s.section == directory.WEIGHTS:
            return resized(self.data, s.section, self.data[section.start : s.start] + content)
        end = s.start + pad4(s.end - s.start)
        padded = content + bytes(pad4(len(content)) - len(content))
        whole = bytearray(self.data[section.start : s.start] + padded + self.data[end : section.start + section.length])
        at = s.length_at - section.start
        whole[at : at + 4] = len(content).to_bytes(4, "little")
        return resized(self.data, s.section, bytes(whole))

    def with_part(self, name: str, chunk: int, content: bytes) -> bytes:
        """Returns the file with other bytes as a chunk part, and right lengths and checksums. name: as in PARTS."""
        section, (start, end) = self.sections[directory.DATA], self.part(name, chunk)
        padded = content + bytes(pad4(len(content)) - len(content))
        out = bytearray(self.data)
        for at, length in (
            (self.at(f"chunk[{chunk}].{name.removesuffix('s')}_length"), len(content)),
            (
                self.at(f"index.entry[{chunk}].length"),
                self.value(f"index.entry[{chunk}].length") + len(padded) - pad4(end - start),
            ),
        ):
            out[at : at + 4] = length.to_bytes(4, "little")
        whole = out[section.start : start] + padded + out[start + pad4(end - start) : section.start + section.length]
        at = self.at(f"directory[{section.number}].length")
        out[at : at + 8] = len(whole).to_bytes(8, "little")
        return repair(bytes(out[: section.start]) + bytes(whole) + self.data[section.end :])
