"""The trace of a file, with its elements and symbols in decoding order, and its symbol trace."""

from __future__ import annotations

import io
import itertools
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from ..bitstream.codec import Parsed, parse
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
    waiting = _trace_parts(data)
    held: list[Row] = []

    def show(end: int) -> None:
        """Writes the elements that start before the byte `end`."""
        for row in itertools.chain(held[:], waiting):
            held.clear()
            if row.start >= end:
                held.append(row)
                return
            write(f"{row.path}\t{row.kind}\t-\t-\t{value_text(row) or row.value.hex()}\n")

    def symbol(row: TraceRow) -> None:
        # The head of a substream comes before its symbols.
        show(row.substream + 1)
        write(f"{row.path}\t{row.family}\t{row.mean}\t{row.scale}\t{row.value}\n")

    try:
        parsed = parse(data, trace=symbol)
    except BitstreamError as error:
        # The last element is the one that the error points at.
        show(error.offset + 1)
        raise
    show(len(data))
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


def _trace_parts(data: bytes) -> Iterator[Row]:
    """Yields the elements that are no symbols, in file order. Raw positions are values, one by one."""
    outline = outline_of(data)
    yield from rows_of(data, replace(outline, sections=[]))
    anchor = 0
    for place in outline.sections:
        for row in section_rows(data, outline, place):
            if row.kind.startswith("f16["):
                yield from _position_rows(data, row, anchor)
                anchor += (row.end - row.start) // POSITION_BYTES
            else:
                yield row


def _position_rows(data: bytes, part: Row, anchor: int) -> Iterator[Row]:
    """Yields raw positions of a chunk, value by value. anchor: its first one."""
    values = np.frombuffer(data, "<f2", (part.end - part.start) // 2, part.start)
    for i, value in enumerate(values):
        at = part.start + 2 * i
        yield Row(at, at + 2, f"positions[{anchor + i // 3},{i % 3}]", "f16", value)
