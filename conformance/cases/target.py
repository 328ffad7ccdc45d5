"""A valid file with the places of its elements and substreams, which can be replaced."""

import copy
import struct
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from refcodec.bitstream import codec, directory, syntax
from refcodec.bitstream.dimensions import layers_of
from refcodec.bitstream.directory import Section
from refcodec.bitstream.header import MAJOR, PROLOGUE_BYTES, SIGNATURE
from refcodec.bitstream.planes import PLANE_NAMES
from refcodec.bitstream.source import pad4
from refcodec.bitstream.syntax import Element
from refcodec.inspect.elements import rows

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
    lanes, words: their numbers.
    """

    path: str
    section: bytes
    start: int
    end: int
    lanes: int
    words: int

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
    def elements(self) -> dict[str, Element]:
        """All elements by path, as in `refcodec inspect --hex`."""
        return {row.path: row for row in rows(self.data)}

    def has(self, path: str) -> bool:
        """Whether there is an element with a path."""
        return path in self.elements or f"header.{path}" in self.elements

    def element(self, path: str) -> Element:
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

    def span(self, path: str) -> tuple[int, int]:
        """Returns the range of a substream or of a chunk's raw part, without its padding."""
        names = (path, *(f"{path}.{part}" for part in ("symbol_crc", "word_count", "state", "word", "raw")))
        spans = [self.elements[name] for name in names if name in self.elements]
        return spans[0].start, spans[-1].end

    def part(self, name: str, chunk: int) -> tuple[int, int]:
        """Returns the range of a part of a chunk, without its padding. name: as in PARTS."""
        return self.span(f"{name}[chunk {chunk}]")

    def chunk_at(self, chunk: int) -> int:
        """Returns the offset of a chunk, or of the end of the last one."""
        lengths = (self.value(f"index.entry[{n}].length") for n in range(chunk))
        return self.start(directory.DATA) + sum(lengths)

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
        """All substreams by path. Raw weights and raw chunks are not substreams."""
        places = {}
        for path in (name.removesuffix(".symbol_crc") for name in self.elements if name.endswith(".symbol_crc")):
            (start, end), state = self.span(path), self.element(f"{path}.state")
            kind = next(kind for kind, section in self.sections.items() if section.start <= start < section.end)
            words = self.value(f"{path}.word_count")
            places[path] = Substream(path, kind, start, end, (state.end - state.start) // 4, words)
        return places

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
        head = {"signature": SIGNATURE, "major": MAJOR, "minor": 0, "header_length": len(built), "prologue_crc": 0}
        return repair(syntax.build("Prologue", head) + built + self.data[self.header_end :])

    def with_substream(self, path: str, content: bytes) -> bytes:
        """Returns the file with other bytes as one substream, and right lengths and checksums."""
        s = self.substreams[path]
        if s.section == directory.WEIGHTS:
            return resized(self.data, s.section, self.data[self.start(s.section) : s.start] + content)
        if s.section == directory.DATA:
            part, _, number = path.removesuffix("]").partition("[chunk ")
            return self.with_part(part, int(number), content)
        length = f"planes.length[{PLANE_NAMES.index(path.removeprefix('planes.'))}]"
        return self._with_range(s.section, s.start, s.end, content, {length: len(content)})

    def with_part(self, name: str, chunk: int, content: bytes) -> bytes:
        """Returns the file with other bytes as a chunk part, and right lengths and checksums. name: as in PARTS."""
        start, end = self.part(name, chunk)
        entry = f"index.entry[{chunk}].length"
        values = {
            f"chunk[{chunk}].{name.removesuffix('s')}_length": len(content),
            entry: self.value(entry) + pad4(len(content)) - pad4(end - start),
        }
        return self._with_range(directory.DATA, start, end, content, values)

    def _with_range(self, kind: bytes, start: int, end: int, content: bytes, values: dict[str, Any]) -> bytes:
        """Returns the file with other bytes in a range of a section, and other values. Both ranges are padded."""
        out, section = self.with_values(values, Depth.NOTHING), self.sections[kind]
        rest = out[start + pad4(end - start) : section.start + section.length]
        return resized(out, kind, out[section.start : start] + content + bytes(-len(content) % 4) + rest)
