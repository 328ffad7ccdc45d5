"""The bytes of a file on the page: its sections and their parts drawn to scale, and the elements of each section."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import groupby, islice

import numpy as np

from ...bitstream.directory import DATA, INDEX, PLANES_SECTION, WEIGHTS
from ...bitstream.header import PROLOGUE_BYTES
from ...bitstream.source import pad4
from ...bitstream.syntax import Element
from ..dump import hex_text, value_text
from ..elements import Bytes, Outline, SectionPlace, read_index, rows_of, section_rows
from ..meaning import PARTS, meaning
from ..specification import fields
from ..specification import text as specification

# The most chunks that are drawn part by part, and the most pieces that chunks are drawn as.
_WHOLE_CHUNKS = 16
_PIECES = 64
# The most elements of a section that are listed.
ROWS_MAX = 240
# The names of parts of sections by the beginnings of their elements' paths. Other elements are the head of a section.
_NAMES = [
    (re.compile(pattern), name)
    for pattern, name in (
        (r"weights\.(hyper|sarm|carm\.\d+|opacity|covariance|colour)\.", r"\1"),
        (r"weights\.(?:symbol_crc|word_count|state|word|raw)", "packed weights"),
        (r"(planes\.r(?:1|2\.\w+_\w+))", r"\1"),
        (r"(chunk\[\d+\])\.", r"\1, head"),
        (r"((?:positions|masks|attributes)\[chunk \d+\])", r"\1"),
    )
]
# The CSS class of a section, by its type (style.css).
_STYLES = {kind: name for name, (kind, _) in PARTS.items() if kind.isupper()}


@dataclass(frozen=True)
class MapPiece:
    """A part of the file, with the padding after it. style: CSS class and clauses. inner: its parts, or none."""

    name: str
    style: tuple[str, str]
    start: int
    end: int
    inner: tuple[MapPiece, ...] = ()

    @property
    def length(self) -> int:
        """The number of bytes."""
        return self.end - self.start


def _clauses(clauses: Iterable[str]) -> str:
    return ", ".join(islice(clauses, 3))


def pieces(data: Bytes, outline: Outline) -> Iterator[MapPiece]:
    """Yields the prologue, the header and the sections of a file in its order, with their parts. They cover it."""
    for name, start, end in (("prologue", 0, PROLOGUE_BYTES), ("header", PROLOGUE_BYTES, outline.header_end)):
        yield MapPiece(name, ("headers", _clauses(PARTS[name][1].split())), start, end)
    for place in outline.sections:
        kind, style = place.type.decode("latin-1"), _STYLES.get(place.type.decode("latin-1"), "ancillary")
        clauses = next((known for own, known in PARTS.values() if own == kind), "12.1")
        inner: Iterable[MapPiece] = ()
        if place.type == INDEX:
            inner = _index(outline, place)
        elif place.type == DATA and chunks_per_piece(outline):
            inner = _many_chunks(data, outline, place)
        elif place.type in (WEIGHTS, PLANES_SECTION, DATA):
            inner = _parts(section_rows(data, outline, place), style)
        yield MapPiece(place.name, (style, _clauses(clauses.split())), place.start, place.stop, tuple(inner))


def _parts(elements: Iterator[Element], style: str) -> Iterator[MapPiece]:
    """Yields the parts of a section: its elements in groups of one name."""

    def name(element: Element) -> str:
        return next((m.expand(own) for pattern, own in _NAMES if (m := pattern.match(element.path))), "head")

    for key, group in groupby(elements, name):
        some = list(group)
        own = "headers" if key.endswith("head") else key.partition("[")[0] if key.endswith("]") else style
        yield MapPiece(key, (own, _clauses(meaning(some[0].path).clauses)), some[0].start, some[-1].end)


def _index(outline: Outline, place: SectionPlace) -> Iterator[MapPiece]:
    """Yields the models and the entries, of which there can be a million."""
    k = outline.header.dimensions.offset_count
    model, entries = place.start + pad4(k * (k + 1)), place.start + outline.entries_start
    yield MapPiece("mask model", ("index", "5.11, 6.10, 7.6"), place.start, model)
    if outline.index_mode:
        yield MapPiece("position model", ("index", "5.12, 6.10, 7.12"), model, entries)
    if place.end > entries:
        yield MapPiece("entries of chunks", ("index", "5.13, 6.10"), entries, place.end)


def _many_chunks(data: Bytes, outline: Outline, place: SectionPlace) -> Iterator[MapPiece]:
    """Yields chunks in pieces of several."""
    ends = (place.start + np.cumsum(read_index(data, outline)["length"].astype(np.int64))).tolist()
    starts, each = [place.start, *ends], chunks_per_piece(outline)
    for first in range(0, len(ends), each):
        last = min(first + each, len(ends)) - 1
        name = f"chunk[{first}]" if first == last else f"chunk[{first}] to chunk[{last}]"
        yield MapPiece(name, ("data", PARTS["data"][1].replace(" ", ", ")), starts[first], ends[last])


def chunks_per_piece(outline: Outline) -> int:
    """Returns the number of chunks in a piece, or 0 if the chunks are drawn part by part."""
    chunks = outline.header.chunk_count
    return -(-chunks // _PIECES) if chunks > _WHOLE_CHUNKS else 0


@dataclass(frozen=True)
class AnnotatedPart:
    """Bytes start to end of a file, and their elements.

    rows: for each element its offset, bytes, path, type, value, meaning and clauses, as text. rest: the offset of the
    first element that is left out, or `end`.
    """

    name: str
    start: int
    end: int
    rows: list[tuple[str, ...]]
    rest: int


def annotated(data: Bytes, outline: Outline) -> Iterator[AnnotatedPart]:
    """Yields the prologue, the header and the sections of a file in file order."""
    known = fields(specification())

    def row(element: Element) -> tuple[str, ...]:
        own = meaning(element.path, outline.render_model)
        facts = hex_text(data, element), element.path, element.kind, value_text(element)
        return f"{element.start:08x}", *facts, own.text(known), ", ".join(own.clauses[:4])

    def part(name: str, start: int, end: int, elements: Iterable[Element]) -> AnnotatedPart:
        shown = list(islice(elements, ROWS_MAX + 1))
        rest = shown[ROWS_MAX].start if len(shown) > ROWS_MAX else end
        return AnnotatedPart(name, start, end, list(map(row, shown[:ROWS_MAX])), rest)

    front = list(rows_of(data, replace(outline, sections=[])))
    yield part("prologue", 0, PROLOGUE_BYTES, (e for e in front if e.end <= PROLOGUE_BYTES))
    yield part("header", PROLOGUE_BYTES, outline.header_end, (e for e in front if e.start >= PROLOGUE_BYTES))
    for place in outline.sections:
        if place.stop > place.start:
            yield part(place.name, place.start, place.stop, section_rows(data, outline, place))
