"""Annotated bytes: the elements of each section, as in `inspect --hex`, with their meanings."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import islice

from ...bitstream.header import PROLOGUE_BYTES
from ..dump import hex_text, value_text
from ..elements import Bytes, Outline, Row, rows_of, section_rows
from ..meaning import meaning
from ..specification import fields
from ..specification import text as specification

# The most elements of a section that are shown.
ROWS_MAX = 240


@dataclass(frozen=True)
class Part:
    """Bytes start to end of a file, and their elements.

    rows: for each element its offset, bytes, path, type, value, meaning and clauses, as text. rest: the offset of the
    first element that is left out, or `end`.
    """

    name: str
    start: int
    end: int
    rows: list[tuple[str, ...]]
    rest: int


def _row(data: Bytes, row: Row, words: dict[str, tuple[str, str]]) -> tuple[str, ...]:
    found = meaning(row.path)
    says = words[f"{found.table}.{found.field}"][1] if found.table else found.words
    clauses = ", ".join(found.clauses[:4])
    return f"{row.start:08x}", hex_text(data, row), row.path, row.kind, value_text(row), says, clauses


def parts(data: Bytes, outline: Outline) -> Iterator[Part]:
    """Yields the prologue, the header and the sections of a file in file order."""
    words = fields(specification())

    def part(name: str, start: int, end: int, found: Iterable[Row]) -> Part:
        shown = list(islice(found, ROWS_MAX + 1))
        rest = shown[ROWS_MAX].start if len(shown) > ROWS_MAX else end
        return Part(name, start, end, [_row(data, row, words) for row in shown[:ROWS_MAX]], rest)

    front = list(rows_of(data, replace(outline, sections=[])))
    yield part("prologue", 0, PROLOGUE_BYTES, (row for row in front if row.end <= PROLOGUE_BYTES))
    yield part("header", PROLOGUE_BYTES, outline.header_end, (row for row in front if row.start >= PROLOGUE_BYTES))
    for place in outline.sections:
        if place.stop > place.start:
            yield part(place.name, place.start, place.stop, section_rows(data, outline, place))
