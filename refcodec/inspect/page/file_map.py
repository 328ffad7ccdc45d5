"""The file drawn to scale: its sections, and in each of them its substreams and other parts."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import groupby

import numpy as np

from ...bitstream.ancillary import TYPES
from ...bitstream.chunks import PARTS
from ...bitstream.directory import DATA, INDEX, PLANES_SECTION, WEIGHTS
from ...bitstream.header import PROLOGUE_BYTES
from ...bitstream.index import CHUNK_HEAD_BYTES
from ...bitstream.source import pad4
from ..elements import Bytes, Outline, Place, parse_elements, read_index, section_rows

# The most chunks that are drawn part by part, and the most pieces that chunks are drawn as.
_WHOLE_CHUNKS = 16
_PIECES = 64
# The CSS class (style.css) and the clauses of SPEC.md of each kind of piece.
_KINDS = {
    "prologue": ("headers", "5.1, 6.1"),
    "header": ("headers", "5.2, 6.2"),
    "FRAM": ("frame", "5.7, 6.7"),
    "WGTS": ("weights", "5.8, 6.8"),
    "PLNS": ("planes", "5.10, 6.9"),
    "INDX": ("index", "5.11, 6.10"),
    "DATA": ("data", "5.14, 6.11"),
    "head": ("headers", "5.14"),
    "positions": ("positions", "5.14, 7.12"),
    "masks": ("masks", "5.14, 7.6"),
    "attributes": ("attributes", "5.14, 7.10"),
    "weights": ("weights", "5.8, 7.13"),
    "planes": ("planes", "5.15, 7.3"),
    "mask model": ("index", "5.11, 7.6"),
    "position model": ("index", "5.12, 7.12"),
    "entries of chunks": ("index", "5.13, 6.10"),
}
_KINDS |= {kind.decode(): ("ancillary", f"{entry.tables[entry.head]}, {entry.clause}") for kind, entry in TYPES.items()}
_OTHER = "ancillary", "12.1"


@dataclass(frozen=True)
class Piece:
    """A part of the file, with the padding after it. kind: a key of _KINDS. inner: its parts, or none."""

    name: str
    kind: str
    start: int
    end: int
    inner: tuple[Piece, ...] = ()

    @property
    def length(self) -> int:
        """The number of bytes."""
        return self.end - self.start

    @property
    def style(self) -> tuple[str, str]:
        """The CSS class and the clauses."""
        return _KINDS.get(self.kind, _OTHER)


def pieces(data: Bytes, outline: Outline) -> Iterator[Piece]:
    """Yields the prologue, the header and the sections of a file in its order, with their parts. They cover it."""
    yield Piece("prologue", "prologue", 0, PROLOGUE_BYTES)
    yield Piece("header", "header", PROLOGUE_BYTES, outline.header_end)
    inner = {WEIGHTS: _weights, PLANES_SECTION: _planes, INDEX: _index, DATA: _chunks}
    for place in outline.sections:
        make = inner.get(place.type)
        parts = make(data, outline, place) if make else ()
        yield Piece(
            place.name,
            place.type.decode("latin-1"),
            place.start,
            place.stop,
            tuple(part for part in parts if part.length),
        )


def _grouped(data: Bytes, outline: Outline, place: Place, pattern: str, kind: str) -> Iterator[Piece]:
    """Yields the elements of a section in groups: those in a row whose paths begin with the same text.

    pattern: matches the path; its first group is the name of the piece.
    """

    def name(path: str) -> str:
        found = re.match(pattern, path)
        return found[1] if found else "head"

    for key, rows in groupby(section_rows(data, outline, place), lambda row: name(row.path)):
        some = list(rows)
        yield Piece(key, kind if key != "head" else place.type.decode(), some[0].start, some[-1].end)


def _weights(data: Bytes, outline: Outline, place: Place) -> Iterator[Piece]:
    pattern = r"(?:weights\.)?((?:hyper|sarm|carm\.\d+|opacity|covariance|colour)(?=\.)|symbol_crc|word|state|raw)"
    found = [*_grouped(data, outline, place, pattern, "WGTS")]
    stream = [piece for piece in found if piece.name in ("symbol_crc", "word", "state", "raw")]
    yield from (piece for piece in found if piece not in stream)
    if stream:
        yield Piece("packed weights", "weights", stream[0].start, stream[-1].end)


def _planes(data: Bytes, outline: Outline, place: Place) -> Iterator[Piece]:
    yield from _grouped(data, outline, place, r"(planes\.r(?:1|2\.\w+_\w+))", "planes")


def _index(data: Bytes, outline: Outline, place: Place) -> Iterator[Piece]:
    k = outline.header.dimensions.offset_count
    model, entries = place.start + pad4(k * (k + 1)), place.start + outline.entries_start
    yield Piece("mask model", "mask model", place.start, model)
    if outline.index_mode:
        yield Piece("position model", "position model", model, entries)
    yield Piece("entries of chunks", "entries of chunks", entries, place.end)


def _chunks(data: Bytes, outline: Outline, place: Place) -> Iterator[Piece]:
    lengths = read_index(data, outline)["length"].astype(np.int64)
    ends = (place.start + np.cumsum(lengths)).tolist()
    starts = [place.start, *ends][: len(ends)]
    if len(ends) > _WHOLE_CHUNKS:
        each = -(-len(ends) // _PIECES)
        for first in range(0, len(ends), each):
            last = min(first + each, len(ends)) - 1
            name = f"chunk[{first}]" if first == last else f"chunk[{first}] to chunk[{last}]"
            yield Piece(name, "DATA", starts[first], ends[last])
        return
    for number, (start, end) in enumerate(zip(starts, ends, strict=True)):
        _, head = parse_elements("Chunk", data, start, end, f"chunk[{number}]")
        at = start + CHUNK_HEAD_BYTES
        yield Piece(f"chunk[{number}], head", "head", start, at)
        for part in PARTS:
            stop = at + pad4(head[f"{part.removesuffix('s')}_length"])
            yield Piece(f"{part}[chunk {number}]", part, at, stop)
            at = stop


def chunks_per_piece(outline: Outline) -> int:
    """Returns the number of chunks in a piece, or 0 if the chunks are drawn part by part."""
    chunks = outline.header.chunk_count
    return -(-chunks // _PIECES) if chunks > _WHOLE_CHUNKS else 0
