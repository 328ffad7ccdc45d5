"""Clauses 5.10 and 6.10: the chunk table."""

import struct
import zlib
from dataclasses import dataclass

from .errors import C3GSError, require
from .header import Header

CHUNK_ENTRY_LENGTH = 24
POSITION_MODEL_LENGTH = 577


@dataclass(frozen=True)
class Part:
    """A chunk's part of a section: its first byte in the file, its length in bytes, and its CRC-32 in the table."""

    offset: int
    length: int
    crc: int

    # SPEC [R6.10-3]
    def check(self, data: bytes) -> None:
        """Refuse the file if the CRC-32 of the part is wrong."""
        if zlib.crc32(memoryview(data)[self.offset : self.offset + self.length]) != self.crc:
            raise C3GSError("chunks.crc", self.offset)


# SPEC 5.10
def entries_start(header: Header) -> int:
    """Return how many bytes of the chunk table come before its entries."""
    offsets = header["offset_count"]
    return offsets * (offsets + 1) + POSITION_MODEL_LENGTH * header.position_mode


# SPEC 5.10, 6.10, 10.1 step 6
def read_entries(data: bytes, header: Header, entries_at: int, spans: list[tuple[int, int]]) -> list[tuple[Part, ...]]:
    """Return for each chunk its parts of the positions, the masks and the attributes.

    entries_at: where the first entry is. spans: the offset and the length of each of these sections.
    """
    ends = [offset for offset, _ in spans]
    chunks = []
    for c in range(header.chunk_count):
        at = entries_at + CHUNK_ENTRY_LENGTH * c
        numbers = struct.unpack_from("<6I", data, at)
        anchors = header.chunk_anchors(c)
        require(16 * numbers[0] >= anchors if header.position_mode else numbers[0] == 6 * anchors, "chunks.length", at)
        chunks.append(tuple(Part(ends[n], numbers[2 * n], numbers[2 * n + 1]) for n in range(3)))
        ends = [end + length for end, length in zip(ends, numbers[::2])]
    for (offset, length), end in zip(spans, ends):
        require(end == offset + length, "chunks.length", offset)
    return chunks
