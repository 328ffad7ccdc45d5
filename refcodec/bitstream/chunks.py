"""Clauses 5.10 and 6.10: the chunk table."""

from __future__ import annotations

import zlib
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from . import syntax
from .conventions import Int64
from .dimensions import mask_contexts
from .errors import BitstreamError

# SPEC 5.10: the bytes of a chunk's entry, and the sections in which a chunk has a part, in the order of the fields.
CHUNK_ENTRY_BYTES = syntax.size_of("ChunkEntry")
PARTS = ("positions", "masks", "attributes")
# SPEC 5.11: the bytes of an anchor's raw position.
POSITION_BYTES = 6
# SPEC 6.10: how many anchors a byte of a chunk's positions stands for in mode 1, at most.
ANCHORS_OF_A_BYTE = 16


def chunk_ranges(anchor_count: int, chunk_size: int) -> list[range]:
    """SPEC 6.10: returns the anchors of each of the ceil(N / chunk_size) chunks. The last chunk may be shorter."""
    return [range(a, min(a + chunk_size, anchor_count)) for a in range(0, anchor_count, chunk_size)]


def entries_start(offset_count: int, position_mode: int) -> int:
    """SPEC 5.10: returns how many bytes of the chunk table come before its entries."""
    return 2 * mask_contexts(offset_count) + (syntax.size_of("PositionModel") if position_mode else 0)


def table_bytes(offset_count: int, position_mode: int, chunks: int) -> int:
    """SPEC 5.10: returns the length of the chunk table in bytes."""
    return entries_start(offset_count, position_mode) + CHUNK_ENTRY_BYTES * chunks


@dataclass(frozen=True)
class Part:
    """The parts of all chunks in one section.

    name: that of the section.
    bounds: int64 [chunks + 1], offsets in the file. The part of chunk c is data[bounds[c]:bounds[c + 1]].
    crc: int64 [chunks], the CRC-32s of the chunk table.
    """

    name: str
    bounds: Int64
    crc: Int64

    def span(self, chunk: int) -> tuple[int, int]:
        """Returns where a chunk's part begins and ends in the file."""
        return int(self.bounds[chunk]), int(self.bounds[chunk + 1])

    def path(self, chunk: int) -> str:
        """Returns the name of a chunk's part in paths."""
        return f"{self.name}[chunk {chunk}]"

    def check(self, data: bytes, chunk: int) -> BitstreamError | None:
        """SPEC [R6.10-3]: returns the error chunks.crc, or None. Parts that the file cuts off have the error."""
        start, end = self.span(chunk)
        crc, stored = zlib.crc32(memoryview(data)[start:end]), int(self.crc[chunk])
        if end <= len(data) and crc == stored:
            return None
        at = min(start, len(data))
        return BitstreamError("chunks.crc", at, self.path(chunk), f"0x{stored:08x}", f"0x{crc:08x}")


def parse_entries(
    data: bytes, at: int, chunks: list[range], spans: Mapping[str, tuple[int, int]], position_mode: int
) -> dict[str, Part]:
    """SPEC 5.10 and [R6.10-2]: returns the parts of the chunks, by the names of PARTS.

    at: where the first entry is. chunks: the anchors of each chunk. spans: where each section begins and ends, by name.
    Raises BitstreamError chunks.length.
    """
    table = np.frombuffer(data, "<u4", 6 * len(chunks), at).astype(np.int64).reshape(-1, 6)
    anchors = np.array([len(c) for c in chunks], dtype=np.int64)
    parts = {}
    for column, name in enumerate(PARTS):
        length = table[:, 2 * column]
        if name == "positions":
            wrong = length * ANCHORS_OF_A_BYTE < anchors if position_mode else length != POSITION_BYTES * anchors
            if wrong.any():
                chunk = int(np.argmax(wrong))
                raw, least = str(POSITION_BYTES * anchors[chunk]), f"at least a sixteenth of {anchors[chunk]}"
                path = f"chunk_table.entry[{chunk}].position_length"
                place = at + CHUNK_ENTRY_BYTES * chunk
                raise BitstreamError("chunks.length", place, path, length[chunk], least if position_mode else raw)
        start, end = spans[name]
        if length.sum() != end - start:
            found = f"a chunk table that announces {int(length.sum())} bytes"
            raise BitstreamError("chunks.length", start, name, found, end - start)
        parts[name] = Part(name, start + np.concatenate([[0], np.cumsum(length)]), table[:, 2 * column + 1])
    return parts


def emit_entry(parts: tuple[bytes, bytes, bytes]) -> bytes:
    """SPEC 5.10: returns the entry of a chunk. parts: its bytes in each section, in the order of PARTS."""
    names = ("position", "mask", "attribute")
    entry = {f"{name}_length": len(part) for name, part in zip(names, parts, strict=True)}
    entry |= {f"{name}_crc": zlib.crc32(part) for name, part in zip(names, parts, strict=True)}
    return syntax.build("ChunkEntry", entry)
