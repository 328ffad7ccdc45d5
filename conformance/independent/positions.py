"""Clauses 5.12, 6.11, 7.4 and 7.12: the positions."""

import math
import struct
from dataclasses import dataclass

from .conventions import CELL_INDEX, CELL_LEVELS, POSITION_MODELS, PRECISION
from .entropy import Substream
from .errors import require
from .tables import make_model
from .trace import Trace

Position = tuple[int, int, int]
HALF = 1 << CELL_LEVELS - 1
POSITION_MODEL_LENGTH = 580
POSITION_LENGTH = 6


# SPEC 7.4
def half_integer(bits: int) -> int:
    """Return P of a finite f16."""
    (number,) = struct.unpack("<e", struct.pack("<H", bits))
    return int(math.ldexp(number, 24))


# SPEC 7.4
def _join(bits: list[int]) -> list[Position]:
    """Return P of each axis of each anchor. bits: of the f16 of the first anchor, then of the second, and so on."""
    integers = [half_integer(b) for b in bits]
    return list(zip(integers[::3], integers[1::3], integers[2::3]))


# SPEC 5.14, [R6.11-6], [R6.11-7]
def read_raw_positions(data: bytes, at: int, anchors: int) -> list[Position]:
    """Return the positions of a chunk in form 0, P of each axis. They start at data[at]."""
    bits = list(struct.unpack_from(f"<{3 * anchors}H", data, at))
    for n, item in enumerate(bits):
        require(item & 0x7C00 != 0x7C00, "positions.not_finite", at + 2 * n)
        require(item != 0x8000, "positions.negative_zero", at + 2 * n)
    return _join(bits)


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


@dataclass(frozen=True)
class PositionModel:
    """What packed positions are coded with. frequencies: the 16 of each of the 18 models."""

    cell_shift: int
    frequencies: list[list[int]]


# SPEC 5.12, [R6.10-3], [R6.10-4]
def read_position_model(data: bytes, at: int) -> PositionModel:
    """Return the model that starts at data[at]."""
    require(not any(data[at + 1 : at + 4]), "index.reserved", at + 1)
    require(data[at] <= CELL_INDEX, "index.position_model", at)
    frequencies = []
    for n in range(POSITION_MODELS):
        first = at + 4 + 32 * n
        model = list(struct.unpack_from("<16H", data, first))
        require(sum(model) == 1 << PRECISION, "index.position_model", first)
        # At least one half of a node has children. So the second half is not empty if the first one is.
        empty_at = [symbol for symbol, frequency in enumerate(model) if frequency == 0]
        require(empty_at == ([0] if n % 6 == 1 else []), "index.position_model", first)
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


# SPEC 7.12, [R6.11-8], [R6.11-9]
def read_packed_positions(
    stream: Substream, model: PositionModel, anchors: int, chunk: int, trace: Trace | None
) -> list[Position]:
    """Return the positions of a chunk in form 1, P of each axis. chunk: its number."""
    cells, whole = _decode_cells(stream, model, anchors, chunk, trace)
    stream.finish()
    require(whole, "positions.count", stream.offset)
    numbers = [_number(c, model.cell_shift) for cell in cells for c in cell]
    bits = [n for n in numbers if n is not None]
    require(len(bits) == len(numbers), "positions.cell", stream.offset)
    return _join(bits)
