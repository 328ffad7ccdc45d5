"""Clauses 5.11, 5.15, 6.11, 7.4 and 7.12: the positions."""

import math
import struct
from dataclasses import dataclass
from itertools import pairwise

from .chunks import Part
from .conventions import CELL_INDEX, CELL_LEVELS, POSITION_MODELS, PRECISION
from .entropy import Substream
from .errors import require
from .header import Header
from .tables import make_model
from .trace import Trace

Position = tuple[int, int, int]
RAW, PACKED = 0, 1
HALF = 1 << CELL_LEVELS - 1
ANCHOR_LENGTH = 6


# SPEC 7.4
def _integers(bits: list[int]) -> list[int]:
    numbers = struct.unpack(f"<{len(bits)}e", struct.pack(f"<{len(bits)}H", *bits))
    return [int(math.ldexp(x, 24)) for x in numbers]


# SPEC 6.11
def _read_raw(data: bytes, at: int, anchors: int) -> list[int]:
    """Return the bits of the f16 numbers of a chunk."""
    bits = list(struct.unpack_from(f"<{3 * anchors}H", data, at))
    for n, item in enumerate(bits):
        require(item & 0x7C00 != 0x7C00, "positions.not_finite", at + 2 * n)
        require(item != 0x8000, "positions.negative_zero", at + 2 * n)
    return bits


# SPEC 7.12, CELL_OF
def _cell_of(bits: int, integer: int, cell_shift: int) -> int | None:
    """Return a coordinate of the cell of a position, or None. integer: P of the f16 with these bits."""
    if cell_shift == CELL_INDEX:
        return HALF + (bits if bits < 0x8000 else 0x8000 - bits)
    n, rest = divmod(integer, 1 << cell_shift)
    return n + HALF if rest == 0 and -HALF <= n < HALF else None


# SPEC 7.12, CELL_NUMBER
def _number(cell: int, cell_shift: int) -> int | None:
    """Return the bits of the f16 that a coordinate of a cell stands for, or None."""
    n = cell - HALF
    if cell_shift == CELL_INDEX:
        bits = n if n >= 0 else 0x8000 - n
        return bits if bits & 0x7C00 != 0x7C00 else None
    value = math.ldexp(n, cell_shift - 24)
    try:
        packed = struct.pack("<e", value)
    except OverflowError:
        return None
    return int.from_bytes(packed, "little") if struct.unpack("<e", packed)[0] == value else None


# SPEC 7.12, MORTON: the bits of its number, the highest first
def _order(cell: list[int]) -> str:
    x, y, z = (format(c, f"0{CELL_LEVELS}b") for c in cell)
    return "".join(c + b + a for a, b, c in zip(x, y, z))


# SPEC [R6.11-4]
def _packs(bits: list[int], cell_shift: int) -> bool:
    """Whether a chunk can be packed."""
    cells = [_cell_of(b, p, cell_shift) for b, p in zip(bits, _integers(bits))]
    if None in cells:
        return False
    orders = [_order([c for c in cells[n : n + 3] if c is not None]) for n in range(0, len(cells), 3)]
    return all(a < b for a, b in pairwise(orders))


@dataclass(frozen=True)
class PositionModel:
    """What packed positions are coded with. frequencies: the 16 of each of the 18 models."""

    cell_shift: int
    frequencies: list[list[int]]


# SPEC 5.15, [R6.10-4]
def read_position_model(data: bytes, at: int) -> PositionModel:
    """Return the model that starts at data[at]."""
    require(data[at] <= CELL_INDEX, "chunks.position_model", at)
    frequencies = []
    for n in range(POSITION_MODELS):
        model = list(struct.unpack_from("<16H", data, at + 1 + 32 * n))
        # At least one half of a node has children. So the second half is not empty if the first one is.
        least = [0 if n % 6 == 1 else 1] + [1] * 15
        right = sum(model) == 1 << PRECISION and all(map(int.__ge__, model, least)) and (n % 6 != 1 or model[0] == 0)
        require(right, "chunks.position_model", at + 1 + 32 * n)
        frequencies.append(model)
    return PositionModel(data[at], frequencies)


# SPEC 7.12, DECODE_CELLS
def _decode_cells(
    stream: Substream, model: PositionModel, anchors: int, chunk: int, trace: Trace | None
) -> tuple[list[Position], bool]:
    """Return the cells of a chunk, and whether there are as many as anchors."""
    models = [make_model(frequencies, 0) for frequencies in model.frequencies]
    nodes, whole = [(0, 0, 0)], True
    for level in reversed(range(CELL_LEVELS)):
        first = 6 * min(level, 2)
        lows = stream.plain([models[first]] * len(nodes))
        highs = stream.plain([models[first + 1 + low.bit_count()] for low in lows])
        if trace:
            trace.level(chunk, level, lows, highs)
        below = []
        for (x, y, z), low, high in zip(nodes, lows, highs):
            present = [child for child in range(8) if (low | high << 4) >> child & 1]
            below += [(2 * x + child % 2, 2 * y + child // 2 % 2, 2 * z + child // 4) for child in present]
        whole = whole and len(below) <= anchors
        nodes = below[:anchors]
    return nodes, whole and len(nodes) == anchors


# SPEC 5.11, 6.11, 7.12, 10.1 step 7
def read_positions(
    data: bytes, header: Header, chunk: int, part: Part, model: PositionModel | None, trace: Trace | None
) -> list[Position]:
    """Return P of each axis of each anchor of a chunk. model: None in mode 0."""
    part.check(data)
    anchors, at = header.chunk_anchors(chunk), part.offset
    if model is None:
        bits = _read_raw(data, at, anchors)
    elif part.length and data[at] == PACKED:
        stream = Substream(data, at + 1, part.length - 1, header["mask_lanes_log2"])
        cells, whole = _decode_cells(stream, model, anchors, chunk, trace)
        stream.finish()
        require(whole, "positions.count", at)
        numbers = [_number(c, model.cell_shift) for cell in cells for c in cell]
        bits = [n for n in numbers if n is not None]
        require(len(bits) == len(numbers), "positions.cell", at)
    else:
        right = part.length == 1 + ANCHOR_LENGTH * anchors and data[at] == RAW
        require(right, "positions.form", at)
        bits = _read_raw(data, at + 1, anchors)
        require(not _packs(bits, model.cell_shift), "positions.raw", at)
    integers = _integers(bits)
    return list(zip(integers[::3], integers[1::3], integers[2::3]))
