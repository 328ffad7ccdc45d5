"""The header of a PLY file, checked before plyfile reads it, whose work grows with the square of a hostile header."""

from __future__ import annotations

import re
from pathlib import Path
from typing import BinaryIO

# A header of Scaffold-GS has about a hundred properties of twenty bytes.
HEADER_MAX = 64 << 10
LINE_MAX = 1 << 10
PROPERTIES_MAX = 2048
NAME_MAX = 64
ELEMENTS_MAX = 16
COUNT_MAX = (1 << 32) - 1

# Bytes of each type, under its old and its new name.
_SIZES = {
    **{"char": 1, "uchar": 1, "int8": 1, "uint8": 1},
    **{"short": 2, "ushort": 2, "int16": 2, "uint16": 2},
    **{"int": 4, "uint": 4, "int32": 4, "uint32": 4, "float": 4, "float32": 4},
    **{"double": 8, "float64": 8},
}
_COUNT = re.compile(r"[0-9]{1,10}")


class PlyHeaderError(ValueError):
    """A header that is not PLY within the bounds. The text says what is wrong, without the file's name."""


def check_ply_header(path: Path) -> tuple[int, int]:
    """Checks that a file begins with a header of PLY that is short, and that it can hold the rows that it states.

    Lists are refused. No file of anchors, splats or points has them, and each row of one becomes a Python object.

    Returns the largest number of rows of an element, and the number of properties of all elements. Raises
    PlyHeaderError, and OSError.
    """
    with path.open("rb") as file:
        lines = _header_lines(file)
        rest = path.stat().st_size - file.tell()
    # The least bytes of a row: its numbers in binary, or a digit and a separator for each in text.
    text = lines[1].split()[1:2] == ["ascii"] if len(lines) > 1 else False
    elements, properties, count, row, most = 0, 0, 0, 0, 0
    for line in lines:
        first, *words = line.split() or [""]
        if first == "element":
            rest -= count * row
            elements, row = elements + 1, 0
            if len(words) != 2 or not _COUNT.fullmatch(words[1]) or int(words[1]) > COUNT_MAX:
                raise PlyHeaderError(f"an element has no name and a count of at most {COUNT_MAX}")
            count = int(words[1])
            most = max(most, count)
        elif first == "property":
            properties += 1
            row += 2 if text else _least_size(words)
            if not words or len(words[-1]) > NAME_MAX:
                raise PlyHeaderError(f"a property has no name of at most {NAME_MAX} characters")
            if words[0] == "list":
                raise PlyHeaderError("it has a property of lists, as meshes have: numbers alone are wanted")
    if elements > ELEMENTS_MAX or properties > PROPERTIES_MAX:
        raise PlyHeaderError(
            f"{elements} elements with {properties} properties, {ELEMENTS_MAX} with {PROPERTIES_MAX} are allowed"
        )
    # A last line of text may end with the file.
    if rest + text < count * row:
        raise PlyHeaderError("it has fewer bytes than the rows that it states")
    return most, properties


def property_names(path: Path) -> list[str]:
    """Returns the names of the properties of all elements, in file order. Raises PlyHeaderError, and OSError."""
    with path.open("rb") as file:
        lines = [line.split() for line in _header_lines(file)]
    return [words[-1] for words in lines if len(words) > 1 and words[0] == "property"]


def _header_lines(file: BinaryIO) -> list[str]:
    """Returns the lines up to end_header, and leaves the file at the first byte after it."""
    lines: list[str] = []
    while not lines or lines[-1] != "end_header":
        line = file.readline(LINE_MAX + 1)
        if len(line) > LINE_MAX or file.tell() > HEADER_MAX:
            raise PlyHeaderError(f"its header is longer than {HEADER_MAX} bytes, or a line of it than {LINE_MAX}")
        if not line.endswith(b"\n"):
            raise PlyHeaderError("its header has no end")
        try:
            lines.append(line.decode("ascii").strip("\r\n"))
        except UnicodeDecodeError:
            raise PlyHeaderError("its header is not ASCII") from None
        if lines[0] != "ply":
            raise PlyHeaderError("it does not begin with ply")
    return lines


def _least_size(words: list[str]) -> int:
    """Returns the least bytes of a property in binary. words: those after `property`."""
    # An unknown type is left to plyfile's message.
    return _SIZES.get(words[0], 0) if words else 0
