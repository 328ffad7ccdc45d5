"""Clauses 5.11 to 5.13 and 6.10: the index."""

from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from . import syntax
from .conventions import Int64
from .dimensions import Dimensions, mask_contexts
from .errors import BitstreamError
from .masks import parse_mask_model
from .positions import F16, PositionModel, first_bad, parse_position_model
from .source import Piece, pad4

# One number of anchors, or an array of them.
Count = TypeVar("Count", int, Int64)

# SPEC 5.13: the size of a ChunkEntry in bytes, and its fields as a dtype.
ENTRY_BYTES = syntax.size_of("ChunkEntry")
ENTRY = np.dtype(
    [
        *((name, "<u4") for name in ("length", "crc", "anchor_count", "kept_count")),
        ("low", "<f2", 3),
        ("high", "<f2", 3),
    ]
)
CHUNK_HEAD_BYTES = syntax.size_of("Chunk")
# SPEC 6.10: the most anchors for each byte of a chunk.
ANCHORS_OF_A_BYTE = 16


@dataclass(frozen=True)
class ChunkEntry:
    """SPEC 5.13: the index entry of a chunk.

    number: of the chunk. start: the offset of its first byte. anchors: the numbers of its anchors in the file.
    kept: the number of its kept offsets. low, high: float16 [3], the bounds of its positions.
    """

    number: int
    start: int
    length: int
    crc: int
    anchors: range
    kept: int
    low: F16
    high: F16

    @property
    def path(self) -> str:
        """The name of the chunk in paths."""
        return f"chunk[{self.number}]"


@dataclass(frozen=True, eq=False)
class Index:
    """SPEC 5.11 to 5.13: the index, with the entries in order. Entry objects are created on access.

    mask_model: uint16 [K (K + 1) / 2]. position_model: None in mode 0. The other arrays have an item for each chunk;
    starts and anchors have one more, the end.
    """

    mask_model: NDArray[np.uint16]
    position_model: PositionModel | None
    table: NDArray[np.void]
    starts: Int64
    anchors: Int64

    def __len__(self) -> int:
        return len(self.table)

    def __getitem__(self, number: int) -> ChunkEntry:
        """Returns the entry of a chunk. Raises IndexError."""
        row = self.table[number]
        return ChunkEntry(
            number,
            int(self.starts[number]),
            int(row["length"]),
            int(row["crc"]),
            range(int(self.anchors[number]), int(self.anchors[number + 1])),
            int(row["kept_count"]),
            row["low"],
            row["high"],
        )


def entries_start(offset_count: int, mode: int) -> int:
    """SPEC 5.11: returns the number of bytes of the index before its entries."""
    return pad4(2 * mask_contexts(offset_count)) + (syntax.size_of("PositionModel") if mode else 0)


def index_bytes(offset_count: int, mode: int, chunks: int) -> int:
    """SPEC [R6.6-5]: returns the length of the index in bytes."""
    return entries_start(offset_count, mode) + ENTRY_BYTES * chunks


def parse_index(
    section: Piece, mode: int, d: Dimensions, anchor_count: int, chunk_size: int, data_start: int, data_length: int
) -> Index:
    """SPEC 5.11 to 5.13 and 6.10: returns the index. Raises BitstreamError 431 to 436.

    The section has the length that the header implies. anchor_count: N. data_start, data_length: the place of DATA.
    """
    # SPEC [R6.10-1], [R6.10-2]
    mask_model, at = parse_mask_model(section, d.offset_count), 2 * mask_contexts(d.offset_count)
    section.require_zero("index.padding", at, pad4(at), "index.mask_model")
    # SPEC [R6.10-3], [R6.10-4]
    position_model = parse_position_model(section, pad4(at)) if mode else None
    first = entries_start(d.offset_count, mode)
    table = np.frombuffer(section.data, ENTRY, -1, first)
    # SPEC [R6.10-5]
    wrong = _wrong_entries(table, d.offset_count, chunk_size)
    if wrong.any():
        raise _entry_error(section, first, table, int(np.argmax(wrong)), d.offset_count, chunk_size)
    # SPEC [R6.10-6]
    anchors, lengths = (table[name].astype(np.int64) for name in ("anchor_count", "length"))
    for column, wanted, what in ((anchors, anchor_count, "anchors"), (lengths, data_length, "bytes")):
        total = int(column.sum())
        if total != wanted:
            raise section.error("index.length", 0, "index", f"entries of {total} {what}", f"{wanted} {what}")
    sums = [np.concatenate([np.zeros(1, np.int64), np.cumsum(each)]) for each in (lengths, anchors)]
    return Index(mask_model, position_model, table, data_start + sums[0], sums[1])


def chunk_floor(anchors: Count) -> Count:
    """SPEC [R6.10-5]: returns the least chunk length for a number of anchors, or for an array of such numbers."""
    return CHUNK_HEAD_BYTES + -(-anchors // ANCHORS_OF_A_BYTE)


def _wrong_entries(table: NDArray[np.void], offset_count: int, chunk_size: int) -> NDArray[np.bool_]:
    """SPEC [R6.10-5]: returns which entries have an invalid field, bool [C]."""
    count, length = table["anchor_count"].astype(np.int64), table["length"].astype(np.int64)
    wrong = (count < 1) | (count > chunk_size) | (length % 4 != 0) | (length < chunk_floor(count))
    wrong |= table["kept_count"] > offset_count * count
    for name in ("low", "high"):
        bits = table[name].view(np.uint16)
        wrong |= (((bits & 0x7C00) == 0x7C00) | (bits == 0x8000)).any(axis=1)
    with np.errstate(invalid="ignore"):
        wrong |= (table["low"] > table["high"]).any(axis=1)
    return np.asarray(wrong)


def _entry_error(
    section: Piece, first: int, table: NDArray[np.void], number: int, offset_count: int, chunk_size: int
) -> BitstreamError:
    """SPEC [R6.10-5]: returns the first error of an invalid entry, in the order of the requirement."""
    entry = syntax.Struct("ChunkEntry", section, first + ENTRY_BYTES * number, f"index.entry[{number}]")
    name, e = "index.chunk", entry.fields
    if not 1 <= e.anchor_count <= chunk_size:
        return entry.error(name, "anchor_count", e.anchor_count, f"1 to {chunk_size}")
    least = chunk_floor(int(e.anchor_count))
    if e.length % 4 or e.length < least:
        return entry.error(name, "length", e.length, f"a multiple of 4, at least {least}")
    if e.kept_count > offset_count * e.anchor_count:
        return entry.error(name, "kept_count", e.kept_count, f"at most {offset_count * e.anchor_count}")
    row = table[number]
    for bound in ("low", "high"):
        bad = first_bad(row[bound].view(np.uint16))
        if bad is not None:
            return entry.error(name, f"{bound}[{bad[1]}]", row[bound][bad[1]], "finite numbers but -0")
    axis = int(np.argmax(row["low"] > row["high"]))
    return entry.error(name, f"low[{axis}]", row["low"][axis], f"at most high, {row['high'][axis]}")


def emit_entry(content: bytes, crc: int, positions: F16, kept: int) -> bytes:
    """SPEC 5.13: returns the entry of a chunk. positions: float16 [n, 3]. kept: the number of its kept offsets."""
    return syntax.build(
        "ChunkEntry",
        {
            "length": len(content),
            "crc": crc,
            "anchor_count": len(positions),
            "kept_count": kept,
            "low": positions.min(axis=0).tolist(),
            "high": positions.max(axis=0).tolist(),
        },
    )
