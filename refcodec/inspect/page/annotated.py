"""Annotated bytes: the elements of each section, as `inspect --hex` has them, with what they mean."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from itertools import islice

from ...bitstream.header import PROLOGUE_BYTES
from ..dump import hex_text, value_text
from ..elements import Bytes, Outline, Row, rows_of, section_rows
from ..meaning import meaning
from ..specification import fields
from ..specification import text as specification
from .markup import NUMBER, TEXT, size, table, tag, text

# The most elements of a section that are shown.
ROWS_MAX = 240


def _row(data: Bytes, row: Row, words: dict[str, tuple[str, str]]) -> tuple[str, ...]:
    found = meaning(row.path)
    says = words[f"{found.table}.{found.field}"][1] if found.table else found.words
    return (
        f"{row.start:08x}",
        tag("code", text(hex_text(data, row))),
        text(row.path),
        text(row.kind),
        text(value_text(row), 60),
        text(says),
        text(", ".join(found.clauses[:4])),
    )


def _part(data: Bytes, name: str, start: int, end: int, found: Iterable[Row], words: dict[str, tuple[str, str]]) -> str:
    """One part of the file, closed. found: its elements."""
    shown = list(islice(found, ROWS_MAX + 1))
    more = shown[ROWS_MAX:]
    columns = [
        ("offset", NUMBER),
        ("bytes", TEXT),
        ("element", TEXT),
        ("type", TEXT),
        ("value", TEXT),
        ("meaning", TEXT),
        ("clauses", TEXT),
    ]
    inside = table(columns, (_row(data, row, words) for row in shown[:ROWS_MAX]), class_="bytes")
    if more:
        at = more[0].start
        inside += tag(
            "p",
            f"The elements from byte {at:,} on are left out: {size(end - at)} of this part. ",
            tag("code", "refcodec inspect FILE --hex"),
            " shows all, and ",
            tag("code", f"refcodec inspect FILE --near {at}"),
            " those around a byte.",
        )
    note = f"{size(end - start)} from byte {start:,}"
    return tag("details", tag("summary", tag("b", text(name)), " ", tag("span", note, class_="soft")), inside)


def section(data: Bytes, outline: Outline) -> str:
    """Returns the section of the page."""
    words = fields(specification())
    front = list(rows_of(data, replace(outline, sections=[])))
    parts = [
        _part(data, "prologue", 0, PROLOGUE_BYTES, (r for r in front if r.end <= PROLOGUE_BYTES), words),
        _part(
            data, "header", PROLOGUE_BYTES, outline.header_end, (r for r in front if r.start >= PROLOGUE_BYTES), words
        ),
    ]
    for place in outline.sections:
        if place.stop > place.start:
            found = section_rows(data, outline, place)
            parts.append(_part(data, place.name, place.start, place.stop, found, words))
    return tag(
        "section",
        tag("h2", "Annotated bytes"),
        tag(
            "p",
            "Offsets and bytes are hexadecimal. The bytes of a payload are folded to its first ones. "
            f"Of a part at most {ROWS_MAX} elements are shown. Clauses are those of SPEC.md: ",
            tag("code", "refcodec explain 7.12"),
            " prints one.",
        ),
        *parts,
        id="bytes",
    )
