"""The trace of a file, with its elements and symbols in decoding order, and its symbol trace."""

import io
import itertools
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from ..bitstream.codec import Coding, Parsed, parse, parse_container
from ..bitstream.entropy import TraceRow
from ..bitstream.errors import BitstreamError
from ..bitstream.positions import POSITION_BYTES
from ..bitstream.scene import Scene
from ..bitstream.syntax import Element
from . import probes as probe
from .dump import value_text
from .elements import outline_of, rows_of, section_rows

_FEATURES = "attributes.features["


def trace(data: bytes, write: Callable[[str], object]) -> Parsed:
    """Decodes a file and writes a line for each syntax element and each symbol, in decoding order.

    The columns are path, type or family of models, mean, scale and value. Tabs separate them. "-" stands for nothing.
    Raises the BitstreamError of a file that is refused, after the lines of the elements before it.
    """
    write("path\tkind\tmean\tscale\tvalue\n")
    waiting = _trace_parts(data)
    held: list[Element] = []

    def show(end: int) -> None:
        """Writes the elements that start before the byte `end`."""
        for row in itertools.chain(held[:], waiting):
            held.clear()
            if row.start >= end:
                held.append(row)
                return
            write(f"{row.path}\t{row.kind}\t-\t-\t{value_text(row) or row.value.hex()}\n")

    def symbol(row: TraceRow) -> None:
        # The head of a substream precedes its symbols.
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


def symbol_trace(data: bytes, write: Callable[[str], object], *, probes: bool = False) -> Parsed:
    """Decodes a file and writes its symbol trace (vectors/README.md), a line `path value` for each symbol.

    The substreams are in file order. The symbols of a substream are in the order of its CRC-32 (SPEC 8.8). probes: with
    the probes of each chunk, each before the symbols that are decoded with its numbers. Raises the BitstreamError of a
    file that is refused, after the lines of the decoded symbols. In this case it has no probes.
    """
    # The symbols of substreams that are decoded side by side are kept as text. Rows would take many times the memory.
    texts: dict[int, _Text] = {}
    ends = np.cumsum(parse_container(data).dimensions.slices) if probes else np.zeros(0, np.int64)

    def add(row: TraceRow) -> None:
        text = texts.setdefault(row.substream, _Text())
        if probes and row.path.startswith(_FEATURES):
            channel = int(row.path[:-1].rpartition(",")[2])
            text.enter(int(np.searchsorted(ends, channel, "right")))
        text.write(f"{row.path} {row.value}\n", row.path.startswith("attributes."))

    parsed = None
    try:
        parsed = parse(data, trace=add)
        return parsed
    finally:
        scene = parsed.scene if parsed and probes else None
        coding = Coding(scene) if scene else None
        chunks = iter(scene.chunks) if scene else iter(())
        for _, text in sorted(texts.items()):
            if scene and coding and text.attributes:
                text.write_with_probes(scene, coding, next(chunks), write)
            else:
                write(text.whole())


class _Text:
    """The lines of a substream. attributes: whether they are symbols of attributes."""

    def __init__(self) -> None:
        self._text = io.StringIO()
        self._places: dict[int, int] = {}
        self.attributes = False

    def enter(self, index: int) -> None:
        """Records that the next symbol is of a slice."""
        if index not in self._places:
            self._places[index] = self._text.tell()

    def write(self, line: str, attributes: bool) -> None:
        self._text.write(line)
        self.attributes = attributes

    def whole(self) -> str:
        """All lines."""
        return self._text.getvalue()

    def write_with_probes(self, scene: Scene, coding: Coding, chunk: range, write: Callable[[str], object]) -> None:
        """Writes the lines of a chunk's attributes, and its probes between them."""
        text, at, done = self.whole(), slice(chunk.start, chunk.stop), 0
        known = probe.before_symbols(scene, coding, at)
        write("".join(probe.lines(known, chunk.start)))
        for i, models in enumerate(probe.of_slices(scene, coding, at, known), 1):
            write(text[done : self._places[i]])
            write("".join(probe.lines(models, chunk.start)))
            done = self._places[i]
        write(text[done:])
        write("".join(probe.lines([probe.step_numbers(known)], chunk.start)))


def _trace_parts(data: bytes) -> Iterator[Element]:
    """Yields the elements that are not symbols, in file order. Raw positions are values, one by one."""
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


def _position_rows(data: bytes, part: Element, anchor: int) -> Iterator[Element]:
    """Yields raw positions of a chunk, value by value. anchor: its first one."""
    values = np.frombuffer(data, "<f2", (part.end - part.start) // 2, part.start)
    for i, value in enumerate(values):
        at = part.start + 2 * i
        yield Element(f"positions[{anchor + i // 3},{i % 3}]", "f16", at, at + 2, value)
