"""PLY files whose elements have numbers only, as structured arrays, with bounded headers.

Point clouds and splats are such files. Rows of lists, as the faces of meshes have, are refused: each would be a Python
object.
"""

import io
import mmap
import os
import re
from collections.abc import Mapping, Sequence
from itertools import islice
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .present import BytesFile, mapped

# A header of Scaffold-GS has about a hundred properties of twenty bytes.
HEADER_MAX = 64 << 10
LINE_MAX = 1 << 10
PROPERTIES_MAX = 2048
NAME_MAX = 64
ELEMENTS_MAX = 16
COUNT_MAX = (1 << 32) - 1

# Each type by its old name, which is written, and by its new one.
_OLD = {"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4"} | {
    "double": "f8"
}
_NEW = {"int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4", "float32": "f4"}
_TYPES = {**_OLD, **_NEW, "float64": "f8"}
_NAMES = {kind: name for name, kind in _OLD.items()}
# NumPy's byte orders. Text has none.
_FORMATS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_COUNT = re.compile(r"[0-9]{1,10}")


class PlyError(ValueError):
    """A file that is not PLY within the bounds. The text states the problem, without the file's name."""


class MeshError(PlyError):
    """A file with lists, as meshes have them."""


class _Element(NamedTuple):
    """name: such as vertex. rows: their number. fields: name and type of each property, without byte order."""

    name: str
    rows: int
    fields: list[tuple[str, str]]

    def size(self, text: bool) -> int:
        """Returns the minimum bytes of its rows: numbers in binary, or a digit and a separator each in text."""
        return self.rows * sum(2 if text else np.dtype(kind).itemsize for _, kind in self.fields)


def check_ply_header(path: Path) -> tuple[int, int]:
    """Checks that a file begins with a short PLY header, and is long enough for the rows that the header states.

    Returns the largest number of rows of an element, and the number of properties of all elements. Raises PlyError,
    and OSError.
    """
    with path.open("rb") as file:
        _, elements = _header(file, os.fstat(file.fileno()).st_size)
    return max((e.rows for e in elements), default=0), sum(len(e.fields) for e in elements)


def property_names(path: Path) -> list[str]:
    """Returns the names of the properties of all elements, in file order. Raises PlyError, and OSError."""
    with path.open("rb") as file:
        lines = [line.split() for line in _header_lines(file)]
    return [words[-1] for words in lines if len(words) > 1 and words[0] == "property"]


def header_text(data: mmap.mmap | bytes) -> str:
    """Returns the lines of the header of the bytes of a file. Raises PlyError."""
    return "\n".join(_header_lines(io.BytesIO(data[: HEADER_MAX + LINE_MAX])))


def names_of(table: NDArray[Any]) -> tuple[str, ...]:
    """Returns the names of the columns of a structured array."""
    return table.dtype.names or ()


def read_ply(path: Path) -> dict[str, NDArray[Any]]:
    """Returns each element of a file as parse_ply. Binary rows are mapped, not read. Raises PlyError, and OSError."""
    return parse_ply(mapped(path))


def parse_ply(data: mmap.mmap | bytes) -> dict[str, NDArray[Any]]:
    """Returns each element of the bytes of a file as a structured array [rows], by its name. Raises PlyError.

    Binary rows are parts of these bytes.
    """
    tables: dict[str, NDArray[Any]] = {}
    file = io.BytesIO(data[: HEADER_MAX + LINE_MAX])
    order, elements = _header(file, len(data))
    place = file.tell()
    lines = io.TextIOWrapper(io.BufferedReader(BytesFile(data, place)), "ascii", "replace") if not order else None
    for name, count, fields in elements:
        try:
            kind = np.dtype([(field, order + letters) for field, letters in fields])
            if not count or not fields:
                tables[name] = np.empty(count, kind)
            elif lines is not None:
                tables[name] = np.loadtxt(islice(lines, count), kind, comments=None, ndmin=1)
            else:
                tables[name] = np.frombuffer(data, kind, count, place)
                place += count * kind.itemsize
        # NumPy reports duplicate names, and text that is not a number.
        except ValueError as error:
            raise PlyError(f"its element {name}: {error}") from None
        if len(tables[name]) != count:
            raise PlyError(f"its element {name} has {len(tables[name])} rows, but its header states {count}")
    return tables


def float_columns(table: NDArray[Any], names: Sequence[str]) -> NDArray[np.float32]:
    """Returns some columns of a structured array as float32 [rows, columns]. Larger numbers become infinite."""
    out = np.empty((len(table), len(names)), np.float32)
    with np.errstate(over="ignore"):
        for i, name in enumerate(names):
            out[:, i] = table[name]
    return out


def ply_header(elements: Mapping[str, tuple[np.dtype[Any], int]], *comments: str) -> bytes:
    """Returns the header of a binary little-endian file. elements: the kind and the number of rows of each, by name."""
    lines = ["ply", "format binary_little_endian 1.0"]
    # Viewers of 3DGS's authors read the count from the third line.
    notes = [f"comment {comment}" for comment in comments]
    for name, (kind, count) in elements.items():
        lines += [f"element {name} {count}", *notes]
        lines += [f"property {_NAMES[np.dtype(kind[field]).str[1:]]} {field}" for field in kind.names or ()]
        notes = []
    return "\n".join([*lines, "end_header", ""]).encode("ascii")


def ply_bytes(elements: Mapping[str, NDArray[Any]], *comments: str) -> bytes:
    """Returns a binary little-endian file. elements: structured arrays [rows], little endian, by name."""
    header = ply_header({name: (table.dtype, len(table)) for name, table in elements.items()}, *comments)
    return header + b"".join(table.tobytes() for table in elements.values())


def _header(file: BinaryIO, size: int) -> tuple[str, list[_Element]]:
    """Returns the byte order, empty for text, and the elements, and leaves the file at the first byte after them.

    size: of the whole file, bytes.
    """
    formats: list[str] = []
    elements: list[_Element] = []
    for line in _header_lines(file)[1:-1]:
        first, *words = line.split() or [""]
        if first == "format":
            formats += words[:1]
        elif first == "element":
            if len(words) != 2 or not _COUNT.fullmatch(words[1]) or int(words[1]) > COUNT_MAX:
                raise PlyError(f"an element must have a name and a count of at most {COUNT_MAX}")
            elements.append(_Element(words[0], int(words[1]), []))
        elif first == "property":
            if not words or len(words[-1]) > NAME_MAX:
                raise PlyError(f"a property must have a name of at most {NAME_MAX} characters")
            if words[0] == "list" and elements:
                # Programs for meshes write faces for point clouds, too, and no row of them.
                if elements[-1].rows:
                    name = elements[-1].name
                    raise MeshError(
                        f"it has a property of lists in its element {name}, as meshes have; none is allowed"
                    )
                continue
            if not elements or len(words) != 2 or words[0] not in _TYPES:
                raise PlyError(f"a property must have a type and a name, after an element: {' '.join(words)}")
            elements[-1].fields.append((words[1], _TYPES[words[0]]))
        elif first not in ("comment", "obj_info"):
            raise PlyError(f"a line of its header is neither an element, a property nor a comment: {line}")
    properties = sum(len(element.fields) for element in elements)
    if len(elements) > ELEMENTS_MAX or properties > PROPERTIES_MAX:
        raise PlyError(
            f"{len(elements)} elements with {properties} properties, but at most {ELEMENTS_MAX} with "
            f"{PROPERTIES_MAX} are allowed"
        )
    if len(formats) != 1 or formats[0] not in _FORMATS:
        raise PlyError(f"its format must be one of {', '.join(_FORMATS)}")
    order = _FORMATS[formats[0]]
    # A last line of text may end with the file.
    if size - file.tell() + (not order) < sum(element.size(not order) for element in elements):
        raise PlyError("it has fewer bytes than the rows that it states")
    return order, elements


def _header_lines(file: BinaryIO) -> list[str]:
    """Returns the lines up to end_header, and leaves the file at the first byte after it."""
    lines: list[str] = []
    while not lines or lines[-1] != "end_header":
        line = file.readline(LINE_MAX + 1)
        if len(line) > LINE_MAX or file.tell() > HEADER_MAX:
            raise PlyError(f"its header is longer than {HEADER_MAX} bytes, or a line of it than {LINE_MAX}")
        if not line.endswith(b"\n"):
            raise PlyError("its header has no end")
        lines.append(line.decode("latin-1").strip())
        if not lines[-1].isascii() and not lines[-1].startswith(("comment", "obj_info")):
            raise PlyError("its header is not ASCII")
        if lines[0] != "ply":
            raise PlyError("it does not begin with ply")
    return lines
