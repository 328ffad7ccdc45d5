"""Clauses 5.14 and 6.11: the chunks."""

import struct
import zlib

from .attributes import AttributeDecoder
from .context import ContextSource
from .conventions import padded
from .entropy import Substream
from .errors import require
from .header import Header
from .index import CHUNK_HEAD_LENGTH, ChunkEntry, Index
from .masks import read_masks
from .positions import POSITION_LENGTH, read_packed_positions, read_raw_positions
from .scene import Chunk
from .syntax import check_padding
from .tables import Tables
from .trace import Trace
from .weights import Weights

RAW, PACKED = 0, 1


# SPEC 5.14, [R6.6-6], [R6.11-1] to [R6.11-5]
def _read_parts(data: bytes, entry: ChunkEntry, packable: bool) -> tuple[int, list[tuple[int, int]]]:
    """Return the form of a chunk's positions, and where each part starts and its length.

    packable: whether the index has a model of positions.
    """
    at, end = entry.offset, entry.offset + entry.length
    require(end <= len(data), "section.truncated", len(data))
    require(zlib.crc32(memoryview(data)[at:end]) == entry.crc, "chunk.crc", at)
    *lengths, form = struct.unpack_from("<3IB", data, at)
    require(data[at + 13 : at + CHUNK_HEAD_LENGTH] == bytes(3), "chunk.reserved", at + 13)
    require(form == RAW or (form == PACKED and packable), "chunk.form", at + 12)
    require(CHUNK_HEAD_LENGTH + sum(map(padded, lengths)) == entry.length, "chunk.length", at)
    require(form != RAW or lengths[0] == POSITION_LENGTH * entry.anchors, "chunk.length", at)
    spans, place = [], at + CHUNK_HEAD_LENGTH
    for length in lengths:
        check_padding(data, place + length, "chunk.padding")
        spans.append((place, length))
        place += padded(length)
    return form, spans


class ChunkReader:
    """Decodes the chunks of a file."""

    def __init__(
        self,
        data: bytes,
        header: Header,
        index: Index,
        weights: Weights,
        context: ContextSource,
        tables: Tables,
        trace: Trace | None,
    ) -> None:
        self._data = data
        self._header = header
        self._index = index
        self._weights = weights
        self._context = context
        self._gauss = tables.gauss
        self._trace = trace

    # SPEC 7.1, 10.1
    def read(self, entry: ChunkEntry) -> Chunk:
        """Check a chunk, and return it."""
        data, header, model = self._data, self._header, self._index.position_model
        anchors = range(entry.first, entry.first + entry.anchors)
        form, spans = _read_parts(data, entry, model is not None)
        if form == PACKED and model is not None:
            stream = Substream(data, *spans[0], header["mask_lanes_log2"])
            positions = read_packed_positions(stream, model, len(anchors), entry.number, self._trace)
        else:
            positions = read_raw_positions(data, spans[0][0], len(anchors))
        # SPEC [R6.11-10]
        axes = list(zip(*positions))
        bounds = [min(axis) for axis in axes], [max(axis) for axis in axes]
        require(bounds == (entry.low, entry.high), "chunk.bounds", entry.offset)
        stream = Substream(data, *spans[1], header["mask_lanes_log2"])
        masks = read_masks(stream, self._index.mask_model, header["offset_count"], anchors, self._trace)
        # SPEC [R6.11-11]
        require(sum(map(sum, masks)) == entry.kept, "chunk.kept", entry.offset)
        stream = Substream(data, *spans[2], header["attribute_lanes_log2"])
        decoder = AttributeDecoder(stream, header, self._weights, self._gauss, self._trace, anchors.start)
        symbols, steps = decoder.run([self._context(position) for position in positions], masks)
        stream.finish()
        return Chunk(positions, masks, symbols, steps)
