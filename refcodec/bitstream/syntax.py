"""Clause 5: one construct schema for each syntax table.

SYNTAX holds the tables of SPEC.md, and a test compares the two. The schemas are built from SYNTAX. They omit payloads
such as weights and words, which the modules of their clauses read as arrays.
"""

import io
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import construct as cs

from .errors import BitstreamError
from .source import Piece

# SPEC 5: for each struct its rows (field, type). A type is a name of _SCALARS, the name of a struct, padding, bytes[n],
# or T[n], where n is a number or an earlier field of the same struct. A schema ends before a row with any other length:
# this row and the later rows are read as arrays.
SYNTAX: dict[str, list[tuple[str, str]]] = {
    # SPEC 5.1
    "Prologue": [
        ("signature", "bytes[8]"),
        ("major", "u16"),
        ("minor", "u16"),
        ("header_length", "u32"),
        ("prologue_crc", "u32"),
    ],
    # SPEC 5.2
    "Header": [
        ("profile", "u8"),
        ("level", "u8"),
        ("section_count", "u16"),
        ("anchor_count", "u32"),
        ("chunk_count", "u32"),
        ("chunk_size", "u32"),
        ("plane_lanes_log2", "u8"),
        ("mask_lanes_log2", "u8"),
        ("attribute_lanes_log2", "u8"),
        ("reserved", "u8"),
        ("base_step", "f32[3]"),
        ("position_grid", "PositionGrid"),
        ("render_info", "RenderInfo"),
        ("dimensions", "Dimensions"),
        ("directory", "DirectoryEntry[section_count]"),
        ("header_crc", "u32"),
    ],
    # SPEC 5.3
    "Dimensions": [
        ("offset_count", "u8"),
        ("plane_channels", "u8"),
        ("frequency_count", "u8"),
        ("slice_count", "u8"),
        ("hyper_layers", "u8"),
        ("sarm_layers", "u8"),
        ("carm_layers", "u8"),
        ("view_inputs", "u8"),
        ("colour_outputs", "u8"),
        ("reserved", "u8"),
        ("plane_size", "u16"),
        ("render_width", "u16"),
        ("hyper_width", "u16[hyper_layers]"),
        ("sarm_width", "u16[sarm_layers]"),
        ("carm_width", "u16[carm_layers]"),
        ("slice_width", "u8[slice_count]"),
        ("padding", "padding"),
    ],
    # SPEC 5.4
    "PositionGrid": [("origin", "i64[3]"), ("scale_mantissa", "u16"), ("scale_exponent", "i8"), ("reserved", "u8")],
    # SPEC 5.5
    "RenderInfo": [
        ("background", "u8[3]"),
        ("up_axis", "u8"),
        ("near_plane", "f32"),
        ("distance_unit", "f32"),
        ("alpha_max", "f32"),
        ("low_pass", "f32"),
        ("colour_primaries", "u8"),
        ("transfer_characteristics", "u8"),
        ("render_model", "u8"),
        ("reserved", "u8"),
    ],
    # SPEC 5.6
    "DirectoryEntry": [("type", "bytes[4]"), ("mode", "u8"), ("reserved", "u8[3]"), ("length", "u64"), ("crc", "u32")],
    # SPEC 5.7
    "Frame": [
        ("matrix", "i32[9]"),
        ("translation", "i64[3]"),
        ("shift", "u8[3]"),
        ("reserved", "u8"),
        ("low", "i32[3]"),
        ("high", "i32[3]"),
    ],
    # SPEC 5.8: the values follow
    "WeightScales": [
        ("plane_shift", "u8"),
        ("carm_input_count", "u8"),
        ("carm_shift", "u8[carm_input_count]"),
        ("padding", "padding"),
    ],
    # SPEC 5.9: one for each layer, in mode 1 of the weights. The values of a raw layer follow it
    "LayerModel": [
        ("form", "u8"),
        ("exponent_scale", "u8"),
        ("exponent", "i16"),
        ("weight_scale", "u8"),
        ("bias_scale", "u8"),
        ("reserved", "u8[2]"),
    ],
    # SPEC 5.10: the substreams follow
    "PlaneTable": [("length", "u32[5]")],
    # SPEC 5.11
    "MaskModel": [("frequency", "u16[K (K + 1) / 2]"), ("padding", "padding")],
    # SPEC 5.12
    "PositionModel": [("cell_shift", "u8"), ("reserved", "u8[3]"), ("frequency", "u16[288]")],
    # SPEC 5.13
    "ChunkEntry": [
        ("length", "u32"),
        ("crc", "u32"),
        ("anchor_count", "u32"),
        ("kept_count", "u32"),
        ("low", "f16[3]"),
        ("high", "f16[3]"),
    ],
    # SPEC 5.14: positions, masks and attributes follow
    "Chunk": [
        ("position_length", "u32"),
        ("mask_length", "u32"),
        ("attribute_length", "u32"),
        ("position_form", "u8"),
        ("reserved", "u8[3]"),
    ],
    # SPEC 5.15
    "Substream": [
        ("symbol_crc", "u32"),
        ("word_count", "u32"),
        ("state", "u32[lanes]"),
        ("word", "u16[word_count]"),
        ("raw", "bytes to the substream's end"),
    ],
    # SPEC 5.16: the entries follow
    "Metadata": [("count", "u16"), ("reserved", "u16")],
    # SPEC 5.16.1
    "Entry": [
        ("key_length", "u16"),
        ("value_length", "u16"),
        ("key", "bytes[key_length]"),
        ("value", "bytes[value_length]"),
        ("padding", "padding"),
    ],
    # SPEC 5.17: the cameras follow
    "Cameras": [("count", "u16"), ("reserved", "u16")],
    # SPEC 5.17.1: a later minor version may add fields, which `length` counts
    "Camera": [
        ("length", "u32"),
        ("width", "u32"),
        ("height", "u32"),
        ("focal", "f32[2]"),
        ("principal_point", "f32[2]"),
        ("rotation", "f32[4]"),
        ("translation", "f32[3]"),
        ("name_length", "u32"),
        ("name", "bytes[name_length]"),
        ("padding", "padding"),
    ],
}
_SCALARS = {
    "u8": cs.Int8ul,
    "u16": cs.Int16ul,
    "u32": cs.Int32ul,
    "i8": cs.Int8sl,
    "i16": cs.Int16sl,
    "i32": cs.Int32sl,
    "i64": cs.Int64sl,
    "u64": cs.Int64ul,
    "f16": cs.Float16l,
    "f32": cs.Float32l,
}
_INTEGERS = {
    kind: (-(1 << int(kind[1:]) - 1), (1 << int(kind[1:]) - 1) - 1) if kind[0] == "i" else (0, (1 << int(kind[1:])) - 1)
    for kind in _SCALARS
    if kind[0] != "f"
}


@dataclass(frozen=True)
class Element:
    """A parsed syntax element.

    path: its name, such as header.base_step[0].
    kind: its type in SYNTAX.
    start, end: its byte range, from the start of the parsed stream.
    value: the parsed value.
    """

    path: str
    kind: str
    start: int
    end: int
    value: Any


class _Recorded(cs.Subconstruct):
    """A construct that records each parsed element.

    It uses two parameters of parse_stream. `elements` is the list that receives the elements. `at` is the stack of the
    paths around the current one. If `at` is None, nothing is recorded.
    """

    element: str
    kind: str
    indexed: bool

    def __init__(self, subcon: cs.Construct, name: str, kind: str, indexed: bool = False) -> None:
        super().__init__(subcon)
        self.element, self.kind, self.indexed = name, kind, indexed

    def _parse(self, stream: Any, context: Any, path: str) -> Any:
        at = context._params.at
        if at is None:
            return self.subcon._parsereport(stream, context, path)
        step = f"[{context._index}]" if self.indexed else ("." if at and at[-1] else "") + self.element
        at.append((at[-1] if at else "") + step)
        start = stream.tell()
        value = self.subcon._parsereport(stream, context, path)
        where = at.pop()
        # Padding can be empty.
        if stream.tell() > start and not isinstance(value, cs.Container | cs.ListContainer):
            context._params.elements.append(Element(where, self.kind, start, stream.tell(), value))
        return value


class _Padding(cs.Construct):
    """SPEC 5: the fewest zero bytes that make the length read or written so far a multiple of four."""

    def _parse(self, stream: Any, context: Any, path: str) -> bytes:
        return bytes(cs.stream_read(stream, -stream.tell() % 4, path))

    def _build(self, obj: Any, stream: Any, context: Any, path: str) -> bytes:
        stream.write(bytes(-stream.tell() % 4))
        return b""


def _subcon(kind: str) -> cs.Construct:
    if kind == "padding":
        # A struct that is built need not state it.
        return cs.Default(_Padding(), b"")
    array = re.fullmatch(r"(\w+)\[(\w+)\]", kind)
    if array is None:
        return _SCALARS[kind] if kind in _SCALARS else _struct(kind)
    item, count = array.groups()
    length = int(count) if count.isdigit() else cs.this[count]
    if item == "bytes":
        return cs.Bytes(length)
    return cs.Array(length, _Recorded(_subcon(item), "", item, indexed=True))


def _fields(name: str) -> list[tuple[str, str]]:
    """Returns the rows of a struct that are in its schema."""
    rows: list[tuple[str, str]] = []
    for field, kind in SYNTAX[name]:
        length = re.fullmatch(r"\w+\[(.+)\]", kind)
        known = kind in _SCALARS or kind in SYNTAX or kind == "padding"
        if not known and not (length and (length[1].isdigit() or length[1] in dict(rows))):
            break
        rows.append((field, kind))
    return rows


def _struct(name: str) -> cs.Struct:
    return cs.Struct(*(field / _Recorded(_subcon(kind), field, kind) for field, kind in _fields(name)))


@cache
def schema(name: str) -> cs.Struct:
    """Returns the schema of a struct of SYNTAX. It is built at its first use, to start programs fast."""
    return _struct(name)


def parse(name: str, data: bytes, start: int = 0) -> tuple[cs.Container, int]:
    """Parses one struct of SYNTAX from data[start:]. Returns it and the number of bytes read.

    Raises construct.ConstructError if the data end too early.
    """
    stream = io.BytesIO(data)
    stream.seek(start)
    value = schema(name).parse_stream(stream, at=None, elements=None)
    return value, stream.tell() - start


def parse_elements(name: str, data: bytes, start: int = 0, path: str = "") -> list[Element]:
    """Returns the elements of one struct of SYNTAX in file order. Their offsets count from the start of data.

    path: the name of the struct, the prefix of the elements' paths. Raises construct.ConstructError if the data end
    too early.
    """
    stream = io.BytesIO(data)
    stream.seek(start)
    elements: list[Element] = []
    schema(name).parse_stream(stream, at=[path] if path else [""], elements=elements)
    return elements


def build(name: str, value: dict[str, Any]) -> bytes:
    """Returns the bytes of one struct of SYNTAX. Raises ValueError, naming the field, for a value outside its type."""
    try:
        return schema(name).build(value, at=None, elements=None)
    except cs.ConstructError as error:
        # construct says "(building) -> render_info -> up_axis".
        steps = (error.path or "").split(" -> ")[1:]
        kind = name
        for step in steps:
            kind = dict(SYNTAX[kind])[step].partition("[")[0]
        allowed = f" from {_INTEGERS[kind][0]} to {_INTEGERS[kind][1]}" if kind in _INTEGERS else ""
        path = ".".join([name.lower(), *steps])
        raise ValueError(f"{path} is no {kind}{allowed} (SPEC.md chapter 5)") from None


def size_of(name: str) -> int:
    """Returns the size in bytes of a struct of SYNTAX. Raises construct.SizeofError if it depends on a field."""
    return int(schema(name).sizeof(at=None, elements=None))


class Struct:
    """A parsed struct with the places of its elements, for the offsets of errors.

    fields: the values by name. size: the number of bytes read.
    """

    fields: Any
    size: int

    def __init__(self, name: str, piece: Piece, at: int, path: str) -> None:
        """Parses the struct from byte `at` of a piece. Raises construct.ConstructError if the piece ends too early.

        path: the name of the struct in paths.
        """
        self.fields, self.size = parse(name, piece.data, at)
        self._piece, self._where = piece, (name, piece.data, at, path)

    def error(self, name: str, field: str, found: object, allowed: object) -> BitstreamError:
        """Returns the error `name` of a field, with the offset of its first byte (SPEC 10.3).

        found, allowed: as in BitstreamError.
        """
        path = f"{self._where[3]}.{field}"
        for element in parse_elements(*self._where):
            if element.path == path or element.path.startswith((path + "[", path + ".")):
                return self._piece.error(name, element.start, path, found, allowed)
        raise AssertionError(path)

    def require_within(self, name: str, field: str, value: float, low: float, high: float) -> None:
        """Raises the error `name` unless low <= value <= high. NaN is outside every range."""
        if not low <= value <= high:
            raise self.error(name, field, value, f"{low} to {high}")

    def require_finite(self, name: str, field: str, values: Sequence[float]) -> None:
        """Raises the error `name` unless all values are finite."""
        if not all(math.isfinite(v) for v in values):
            raise self.error(name, field, ", ".join(map(str, values)), "finite numbers")
