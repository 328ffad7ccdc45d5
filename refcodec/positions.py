"""Positions (SPEC.md 5.11, 6.11 and 7.12): raw fp16, or for each chunk a tree of cells.

A cell's code is its MORTON; the nodes of a level are the codes without their low bits, with the number of the chunk above them,
so that the chunks of a batch are coded side by side.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .conventions import Int64
from .entropy import Encoder, SymbolCoder
from .geometry import position_integers
from .tables import TOTAL, ModelSet, build_models

F16 = NDArray[np.float16]

# SPEC 7.12: levels of the tree; the cell_shift of cells that count fp16 numbers; models of the tree.
CELL_LEVELS = 16
CELL_INDEX = 40
POSITION_MODELS = 18
# SPEC 5.15: symbols of a model, which say which of four children there are.
HALVES = 16
# SPEC 6.10: symbol 0 of these models cannot occur.
EMPTY_MODELS = (1, 7, 13)
# SPEC 5.11: the forms of a chunk.
RAW, PACKED = 0, 1

_MIDDLE = 1 << (CELL_LEVELS - 1)
_CODE_BITS = 3 * CELL_LEVELS
# How many children a symbol names.
_CHILDREN = np.array([half.bit_count() for half in range(HALVES)])


@dataclass(frozen=True, eq=False)
class PositionModel:
    """SPEC 5.15: cell_shift, 0 to 40; frequency uint16 [18, 16]."""

    cell_shift: int
    frequency: NDArray[np.uint16]

    def fault(self) -> int | None:
        """SPEC 6.10: what is first wrong: -1 for cell_shift, else the number of a model; None if all is right."""
        if not 0 <= self.cell_shift <= CELL_INDEX:
            return -1
        never = np.zeros(self.frequency.shape, dtype=bool)
        never[list(EMPTY_MODELS), 0] = True
        right = ((self.frequency == 0) == never).all(axis=1) & (self.frequency.sum(axis=1, dtype=np.int64) == TOTAL)
        return None if right.all() else int(np.argmin(right))

    def models(self) -> ModelSet:
        """SPEC 7.12: the 18 models."""
        return build_models("cells", list(self.frequency.astype(np.int64)), [0] * POSITION_MODELS)


def first_bad(bits: NDArray[np.uint16]) -> tuple[str, int] | None:
    """SPEC 6.11: the first fp16 that is not allowed, as the error's name and its index."""
    bad = np.flatnonzero(((bits & 0x7C00) == 0x7C00) | (bits == 0x8000))
    if not bad.size:
        return None
    first = int(bad[0])
    return ("positions.negative_zero" if bits[first] == 0x8000 else "positions.not_finite"), first


def cells(positions: F16, cell_shift: int) -> Int64:
    """SPEC 7.12, CELL_OF: the cells of positions, int64 [n, 3]; -1 on an axis where there is none. positions: [n, 3], finite."""
    bits = positions.view(np.uint16).astype(np.int64)
    if cell_shift == CELL_INDEX:
        return _MIDDLE + np.where(bits >> 15, -(bits & 0x7FFF), bits)
    p = position_integers(positions)
    n = p >> cell_shift
    return np.where((n << cell_shift == p) & (n >= -_MIDDLE) & (n < _MIDDLE), n + _MIDDLE, -1)


def cell_positions(cell: Int64, cell_shift: int) -> tuple[F16, NDArray[np.bool_]]:
    """SPEC 7.12, CELL_NUMBER: (positions [n, 3], which anchors have one). Anchors without one are 0."""
    n = cell - _MIDDLE
    bits = np.abs(n)
    fits = np.ones(bits.shape, dtype=bool)
    if cell_shift < CELL_INDEX:
        # |n| is at most 2^15, so that a float64 holds |n| * 2^cell_shift and its exponent exactly.
        p = bits << cell_shift
        e = np.maximum(np.frexp(p.astype(np.float64))[1].astype(np.int64) - 11, 0)
        fits = (p >> e) << e == p
        bits = (e << 10) + (p >> e)
    fits &= bits < 0x7C00
    kept = np.asarray(fits.all(axis=1))
    found = np.where(n < 0, bits | 0x8000, bits)
    return np.where(kept[:, None], found, 0).astype(np.uint16).view(np.float16), kept


def morton(cell: Int64) -> Int64:
    """SPEC 7.12, MORTON: int64 [n]. cell: int64 [n, 3], each 0 to 2^16 - 1."""
    code = np.zeros(len(cell), dtype=np.int64)
    for bit in range(CELL_LEVELS):
        for axis in range(3):
            code |= ((cell[:, axis] >> bit) & 1) << (3 * bit + axis)
    return code


def _cells_of_codes(code: Int64) -> Int64:
    """The reverse of morton."""
    cell = np.zeros((len(code), 3), dtype=np.int64)
    for bit in range(CELL_LEVELS):
        for axis in range(3):
            cell[:, axis] |= ((code >> (3 * bit + axis)) & 1) << bit
    return cell


def chunk_codes(positions: F16, cell_shift: int) -> Int64 | None:
    """SPEC 6.11: the codes of a chunk's cells if the chunk is packed in mode 1, None if it is raw."""
    cell = cells(positions, cell_shift)
    if (cell < 0).any():
        return None
    code = morton(cell)
    return code if (code[1:] > code[:-1]).all() else None


def code_cells(
    coder: SymbolCoder, models: ModelSet, numbers: list[int], counts: list[int], given: Int64 | None = None
) -> tuple[Int64, Int64]:
    """SPEC 7.12, DECODE_CELLS, in either direction: (the codes of all cells, [cells]; how many each chunk has, [chunks]).

    numbers: of the chunks, for traces; counts: their anchors; given: the codes when encoding. A chunk whose tree grew past its
    anchors has one cell more than anchors.
    """
    chunk_bits = np.repeat(np.arange(len(counts), dtype=np.int64), counts) << _CODE_BITS
    full = None if given is None else given | chunk_bits
    most = np.array(counts, dtype=np.int64)
    nodes, held, past = np.arange(len(counts), dtype=np.int64), np.ones(len(counts), dtype=np.int64), np.zeros(len(counts), dtype=bool)
    for level in range(CELL_LEVELS - 1, -1, -1):
        known = None
        if full is not None:
            children = np.unique(full >> (3 * level))
            known = np.bincount(np.searchsorted(nodes, children >> 3), 1 << (children & 7), len(nodes)).astype(np.int64)
        first = 6 * min(level, 2)

        def name(stream: int, index: int, level: int = level, half: str = "low") -> str:
            return f"positions[chunk {numbers[stream]}].level[{level}].{half}[{index}]"

        def high_name(stream: int, index: int, level: int = level) -> str:
            return name(stream, index, level, "high")

        model = np.full(len(nodes), first)
        low = coder.plain(models, model, held.tolist(), name, None if known is None else known & 15)
        model = first + 1 + _CHILDREN[low]
        high = coder.plain(models, model, held.tolist(), high_name, None if known is None else known >> 4)
        parent, child = np.nonzero(((low | high << 4)[:, None] >> np.arange(8)) & 1)
        nodes = nodes[parent] << 3 | child
        # SPEC 7.12: nodes past the chunk's anchors are dropped, so that the time is bounded.
        chunk = nodes >> (_CODE_BITS - 3 * level)
        held = np.bincount(chunk, minlength=len(counts))
        past |= held > most
        rank = np.arange(len(nodes)) - np.repeat(np.cumsum(held) - held, held)
        nodes, held = nodes[rank < most[chunk]], np.minimum(held, most)
    return nodes & ((1 << _CODE_BITS) - 1), held + past


def decode_cells(code: Int64, cell_shift: int) -> tuple[F16, NDArray[np.bool_]]:
    """Positions of codes: as cell_positions."""
    return cell_positions(_cells_of_codes(code), cell_shift)


def encode_positions(model: PositionModel | None, positions: F16, chunks: list[range], lanes: int) -> list[bytes]:
    """SPEC 5.11: the part of each chunk; model: None for mode 0. positions: of the chunks' anchors alone, in order."""
    ends = np.cumsum([len(c) for c in chunks])
    each = [positions[end - len(c) : end] for end, c in zip(ends, chunks, strict=True)]
    raw = [p.astype("<f2").tobytes() for p in each]
    if model is None:
        return raw
    codes = [chunk_codes(p, model.cell_shift) for p in each]
    packed = [code for code in codes if code is not None]
    streams: list[bytes] = []
    if packed:
        encoder = Encoder(len(packed), lanes)
        code_cells(encoder, model.models(), [], [len(c) for c in packed], np.concatenate(packed))
        streams = encoder.finish()
    streams.reverse()
    return [bytes([RAW]) + r if code is None else bytes([PACKED]) + streams.pop() for r, code in zip(raw, codes, strict=True)]
