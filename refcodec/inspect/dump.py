"""The bytes of a file and their elements, as text."""

import shlex
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import suppress

import numpy as np

from ..bitstream.codec import parse
from ..bitstream.errors import BitstreamError
from ..bitstream.syntax import Element
from .elements import Bytes, outline_of, rows
from .explain import element_lines, requirement_lines
from .meaning import meaning

# An element of more than _HEX_BYTES is folded to its first _FOLDED_BYTES.
_HEX_BYTES = 16
_FOLDED_BYTES = 8
# How many elements are shown before and after the one at a byte.
_NEAR_ROWS = 6


def value_text(row: Element) -> str:
    """Returns the value of an element. It is empty for bytes, and of a payload it is the number of bytes."""
    if row.value is None:
        return f"{row.end - row.start} bytes"
    if isinstance(row.value, bytes):
        return ""
    if row.path.endswith(("crc", ".type")):
        return f"0x{row.value:0{2 * (row.end - row.start)}x}"
    if row.kind == "f32":
        return str(np.float32(row.value))
    return str(row.value)


def hex_text(data: Bytes, row: Element) -> str:
    """Returns the bytes of an element, folded to the first ones if there are many."""
    folded = row.end - row.start > _HEX_BYTES
    shown = data[row.start : row.start + _FOLDED_BYTES if folded else row.end].hex(" ")
    return shown + " ..." if folded else shown


def _error_line(error: BitstreamError) -> str:
    return f"{error.offset:08x}  ^^ error {error.kind.code} {error.kind.name}: {error}"


def spots(data: bytes, error: BitstreamError) -> list[BitstreamError]:
    """Returns the error of a file, and those of the single chunks.

    The error of a file may be the CRC-32 of a section, which does not locate the damage.
    """
    with suppress(BitstreamError):
        damage = parse(data, keep_going=True).damage.values()
        return [error, *(each for each in damage if each.to_json() != error.to_json())]
    return [error]


def _rows_near(data: bytes, near: int | None) -> Iterator[Element]:
    """Yields all rows, or those of the element at the byte `near` and of a few elements before and after it."""
    if near is None:
        yield from rows(data)
        return
    before: deque[Element] = deque(maxlen=_NEAR_ROWS)
    after = _NEAR_ROWS
    for row in rows(data):
        # A byte past the end selects the last element.
        if row.end <= min(near, len(data) - 1):
            before.append(row)
        elif after >= 0:
            yield from before
            before.clear()
            yield row
            after -= 1
        else:
            return


def about_lines(data: bytes, near: int) -> Iterator[str]:
    """Yields lines about the element at a byte: its meaning, clauses and requirements, and a command for more."""
    row = next((row for row in rows(data) if row.end > min(near, len(data) - 1)), None)
    if row is not None:
        element = meaning(row.path, outline_of(data).render_model)
        yield ""
        yield from element_lines(row.path, element)
        yield from requirement_lines(element)
        yield f"  more         refcodec explain {shlex.quote(row.path)}"


def hex_lines(data: bytes, errors: Sequence[BitstreamError] = (), near: int | None = None) -> Iterator[str]:
    """Yields a line for each element with its offset, bytes, path, type and value.

    Each error stands after the element that it points at. near: a byte around which elements are shown. None shows all.
    """
    yield f"{'offset':<8}  {'bytes':<47}  {'element':<44}  {'type':<12}  value"
    waiting = deque(sorted(errors, key=lambda error: error.offset))
    for row in _rows_near(data, near):
        if near is not None:
            while waiting and waiting[0].offset < row.start:
                waiting.popleft()
        line = f"{row.start:08x}  {hex_text(data, row):<47}  {row.path:<44}  {row.kind:<12}  {value_text(row)}"
        yield line.rstrip()
        while waiting and waiting[0].offset < row.end:
            yield _error_line(waiting.popleft())
    if near is None or near >= len(data):
        yield f"{len(data):08x}  end of file"
        for error in waiting:
            yield _error_line(error)
