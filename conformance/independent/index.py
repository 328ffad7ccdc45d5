"""Clauses 5.11 to 5.13 and 6.10: the index, which has the models of chunks, and an entry for each chunk."""

import struct
from typing import NamedTuple

from .conventions import ANCHORS_OF_A_BYTE, padded
from .errors import require
from .header import Header
from .masks import read_mask_model
from .positions import POSITION_MODEL_LENGTH, PositionModel, half_integer, read_position_model
from .syntax import check_padding

CHUNK_ENTRY_LENGTH = 28
CHUNK_HEAD_LENGTH = 16


class ChunkEntry(NamedTuple):
    """What the index says of a chunk.

    number: of the chunk. offset: its first byte in the file. first: the number of its first anchor. low, high: P of
    each axis.
    """

    number: int
    offset: int
    length: int
    crc: int
    first: int
    anchors: int
    kept: int
    low: list[int]
    high: list[int]


class Index(NamedTuple):
    """mask_model: the frequencies of a kept offset. position_model: None in mode 0."""

    mask_model: list[int]
    position_model: PositionModel | None
    entries: list[ChunkEntry]


# SPEC 5.11, 5.12
def entries_start(header: Header, mode: int) -> int:
    """Return how many bytes of the index come before its entries."""
    offsets = header["offset_count"]
    return padded(offsets * (offsets + 1)) + POSITION_MODEL_LENGTH * mode


# SPEC 5.13, [R6.10-5]
def _read_entry(data: bytes, at: int, header: Header, number: int, offset: int, first: int) -> ChunkEntry:
    """Return the entry at data[at]. offset, first: where its chunk starts in the file, and its first anchor."""
    error = "index.chunk"
    length, crc, anchors, kept, *bounds = struct.unpack_from("<4I6H", data, at)
    require(1 <= anchors <= header["chunk_size"], error, at + 8)
    require(length & 3 == 0 and ANCHORS_OF_A_BYTE * (length - CHUNK_HEAD_LENGTH) >= anchors, error, at)
    require(kept <= header["offset_count"] * anchors, error, at + 12)
    for n, bits in enumerate(bounds):
        require(bits & 0x7C00 != 0x7C00 and bits != 0x8000, error, at + 16 + 2 * n)
    low, high = [half_integer(bits) for bits in bounds[:3]], [half_integer(bits) for bits in bounds[3:]]
    for axis in range(3):
        require(low[axis] <= high[axis], error, at + 16 + 2 * axis)
    return ChunkEntry(number, offset, length, crc, first, anchors, kept, low, high)


# SPEC 5.11, 6.10, 10.1
def read_index(data: bytes, header: Header, mode: int, at: int, data_span: tuple[int, int]) -> Index:
    """Return the index at data[at]. mode: of its section. data_span: where DATA starts, and its length."""
    mask_model = read_mask_model(data, header, at)
    check_padding(data, at + 2 * len(mask_model), "index.padding")
    models_end = at + padded(2 * len(mask_model))
    position_model = read_position_model(data, models_end) if mode else None
    entries: list[ChunkEntry] = []
    place, first = data_span[0], 0
    for number in range(header["chunk_count"]):
        entry_at = at + entries_start(header, mode) + CHUNK_ENTRY_LENGTH * number
        entry = _read_entry(data, entry_at, header, number, place, first)
        entries.append(entry)
        place, first = place + entry.length, first + entry.anchors
    require(first == header["anchor_count"], "index.length", at)
    require(place == sum(data_span), "index.length", at)
    return Index(mask_model, position_model, entries)
