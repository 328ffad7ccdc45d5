"""The trace of a file, with its elements and symbols in decoding order, and its symbol trace."""

from __future__ import annotations

import io
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from ..bitstream.codec import Parsed, parse
from ..bitstream.directory import SECTIONS
from ..bitstream.entropy import TraceRow
from ..bitstream.errors import BitstreamError
from ..bitstream.positions import POSITION_BYTES
from .dump import value_text
from .elements import Row, outline_of, rows_of, section_rows


def trace(data: bytes, write: Callable[[str], object]) -> Parsed:
    """Decodes a file and writes a line for each syntax element and each symbol, in decoding order.

    The columns are path, type or family of models, mean, scale and value. Tabs separate them. "-" stands for nothing.
    Raises the BitstreamError of a file that is refused, after the lines of what was read before it.
    """
    write("path\tkind\tmean\tscale\tvalue\n")
    waiting = deque(_trace_parts(data))
    stage = ""

    def show(part: int, end: int) -> None:
        """Writes the elements up to those of a part, but none that starts after the byte `end`."""
        while waiting and waiting[0][0] <= part:
            for row in waiting.popleft()[1]:
                if row.start > end:
                    return
                write(f"{row.path}\t{row.kind}\t-\t-\t{value_text(row) or row.value.hex()}\n")

    def symbol(row: TraceRow) -> None:
        nonlocal stage
        # Elements come before the first symbol that is decoded after them.
        now = row.path[:5]
        if now != stage:
            stage = now
            show(_ORDER[now], len(data))
        write(f"{row.path}\t{row.family}\t{row.mean}\t{row.scale}\t{row.value}\n")

    try:
        parsed = parse(data, trace=symbol)
    except BitstreamError as error:
        # The last element is the one that the error points at.
        show(_LAST, error.offset)
        raise
    show(_LAST, len(data))
    return parsed


def symbol_trace(data: bytes, write: Callable[[str], object]) -> Parsed:
    """Decodes a file and writes its symbol trace (vectors/README.md), a line `path value` for each symbol.

    The substreams are in file order. The symbols of a substream are in the order of its CRC-32 (SPEC 8.8). Raises the
    BitstreamError of a file that is refused, after the lines of what was decoded.
    """
    # The symbols of substreams that are decoded side by side are kept as text. Rows would take many times the memory.
    found: dict[int, io.StringIO] = {}

    def add(row: TraceRow) -> None:
        found.setdefault(row.substream, io.StringIO()).write(f"{row.path} {row.value}\n")

    try:
        return parse(data, trace=add)
    finally:
        for _, text in sorted(found.items()):
            write(text.getvalue())


# For the beginning of a symbol's path, the last part of _trace_parts that comes before the symbol.
_ORDER = {"weigh": 0, "plane": 0, "posit": 1, "masks": 1, "attri": 2}
_LAST = 2


def _trace_parts(data: bytes) -> Iterator[tuple[int, Iterator[Row]]]:
    """Yields the elements that are no symbols, in file order, with the part of the decoding that they belong to."""
    outline = outline_of(data)

    yield 0, rows_of(data, replace(outline, sections=[]))
    parts = {"chunk_table": 1, "positions": 1, "masks": 1, "attributes": _LAST}
    for kind, start, end in outline.sections:
        name = SECTIONS.get(kind, "")
        if name == "positions" and not outline.position_mode:
            yield 1, _position_rows(data, start, end)
        else:
            yield parts.get(name, 0 if name else _LAST), section_rows(data, outline, kind, start, end)


def _position_rows(data: bytes, start: int, end: int) -> Iterator[Row]:
    """Yields raw positions, value by value."""
    values = np.frombuffer(data, "<f2", max(0, end - start) // POSITION_BYTES * 3, start)
    for i, value in enumerate(values):
        yield Row(start + 2 * i, start + 2 * i + 2, f"positions[{i // 3},{i % 3}]", "f16", value)
