"""Clauses 5.14 and 6.11: the chunks."""

import zlib
from dataclasses import dataclass

from . import syntax
from .directory import truncated
from .index import CHUNK_HEAD_BYTES, ChunkEntry
from .positions import PACKED, POSITION_BYTES, RAW, CodedPositions
from .source import Piece, Source, pad4, padded

# SPEC 5.14: the parts of a chunk, in file order.
PARTS = ("positions", "masks", "attributes")


@dataclass(frozen=True)
class CodedChunk:
    """SPEC 5.14: an encoded chunk, with the pieces of its parts."""

    entry: ChunkEntry
    form: int
    positions: Piece
    masks: Piece
    attributes: Piece

    @property
    def coded_positions(self) -> CodedPositions:
        """The encoded positions, with the parameters of their decoding."""
        return CodedPositions(self.entry.number, self.positions, self.form, self.entry.anchors)


def chunk_ranges(anchor_count: int, chunk_size: int) -> list[range]:
    """Returns the anchors of the fewest chunks. Each chunk except the last has chunk_size anchors."""
    return [range(a, min(a + chunk_size, anchor_count)) for a in range(0, anchor_count, chunk_size)]


def read_chunk(source: Source, entry: ChunkEntry, mode: int) -> CodedChunk:
    """SPEC 5.14, [R6.6-6] and [R6.11-1] to [R6.11-5]: reads a chunk. mode: that of the index.

    Raises BitstreamError section.truncated or 441 to 445.
    """
    data = source.read(entry.start, entry.length)
    # SPEC [R6.6-6]
    if len(data) < entry.length:
        raise truncated(source, entry.path, entry.start + entry.length)
    piece = Piece(data, entry.start)
    # SPEC [R6.11-1]
    crc = zlib.crc32(data)
    if crc != entry.crc:
        raise piece.error("chunk.crc", 0, entry.path, f"0x{entry.crc:08x}", f"0x{crc:08x}")
    head = syntax.Struct("Chunk", piece, 0, entry.path)
    h = head.fields
    # SPEC [R6.11-2]
    if any(h.reserved):
        raise head.error("chunk.reserved", "reserved", list(h.reserved), 0)
    # SPEC [R6.11-3]
    if h.position_form not in ((RAW, PACKED) if mode else (RAW,)):
        raise head.error("chunk.form", "position_form", h.position_form, "0 or 1" if mode else 0)
    # SPEC [R6.11-4]
    lengths = (h.position_length, h.mask_length, h.attribute_length)
    total = CHUNK_HEAD_BYTES + sum(map(pad4, lengths))
    if total != entry.length:
        stated = f"parts that take {total} bytes"
        raise piece.error("chunk.length", 0, entry.path, stated, entry.length)
    raw = POSITION_BYTES * len(entry.anchors)
    if h.position_form == RAW and h.position_length != raw:
        stated = f"position_length {h.position_length}"
        raise piece.error("chunk.length", 0, entry.path, stated, f"{raw}, for {len(entry.anchors)} anchors")
    # SPEC [R6.11-5]
    at, parts = CHUNK_HEAD_BYTES, []
    for name, length in zip(PARTS, lengths, strict=True):
        piece.require_zero("chunk.padding", at + length, at + pad4(length), f"{name}[chunk {entry.number}]")
        parts.append(piece.cut(at, at + length))
        at += pad4(length)
    return CodedChunk(entry, h.position_form, *parts)


def emit_chunk(form: int, parts: tuple[bytes, bytes, bytes]) -> bytes:
    """SPEC 5.14: returns the bytes of a chunk. form: of its positions. parts: in the order of PARTS."""
    names = ("position_length", "mask_length", "attribute_length")
    lengths = dict(zip(names, map(len, parts), strict=True))
    head = syntax.build("Chunk", {**lengths, "position_form": form, "reserved": [0, 0, 0]})
    return head + b"".join(map(padded, parts))
