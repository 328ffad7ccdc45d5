"""SPEC.md B.1: the position grid, the order of anchors, and the model of packed positions."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..bitstream.chunks import ANCHORS_OF_A_BYTE, chunk_ranges
from ..bitstream.conventions import F32, Int64
from ..bitstream.entropy import SymbolName
from ..bitstream.header import ORIGIN_BOUND, SCALE_EXPONENT_MAX, PositionGrid
from ..bitstream.positions import (
    CELL_INDEX,
    EMPTY_MODELS,
    HALVES,
    POSITION_MODELS,
    PositionModel,
    cells,
    chunk_codes,
    code_cells,
    encode_positions,
    morton,
    position_integers,
)
from ..bitstream.scene import Scene, take_anchors
from ..bitstream.tables import TOTAL, ModelSet, tables

# SPEC B.1: without a lattice, the largest coordinate becomes about this in fp16.
FP16_EXTENT = 1024.0


def choose_grid(positions: F32, voxel: float | None = None) -> PositionGrid:
    """SPEC B.1. With a voxel its lattice is exact in fp16 up to 2048 voxels from the origin, which lies on the lattice near
    the middle. Without one, the largest coordinate is 1024 in fp16. Raises ValueError for NaN, infinity, or a size out of range."""
    if not np.isfinite(positions).all():
        raise ValueError("a position is NaN or infinite")
    p = positions.astype(np.float64)
    low, high = (p.min(axis=0), p.max(axis=0)) if len(p) else (np.zeros(3), np.zeros(3))
    middle = (low + high) / 2
    # Far from the world's origin a unit cannot be smaller than the bound on the grid's origin allows.
    unit = voxel or max(float((high - low).max()) / 2 / FP16_EXTENT, float(np.abs(middle).max()) * 2.0**-21) or 1.0
    # 16 bits of mantissa, so that scale_mantissa * P fits 56 bits.
    fraction, exponent = math.frexp(unit)
    mantissa = round(fraction * 65536)
    if mantissa == 65536:
        mantissa, exponent = 32768, exponent + 1
    exponent -= 16
    if abs(exponent) > SCALE_EXPONENT_MAX:
        raise ValueError(f"a voxel of {unit} is out of range")
    # The origin is a whole number of units, in 2^(exponent - 24).
    step = mantissa * 2.0**exponent
    origin = tuple(round(m / step) * mantissa << 24 for m in middle.tolist())
    if max(abs(o) for o in origin) >= ORIGIN_BOUND:
        raise ValueError("the scene is too far from the world's origin for its size")
    return PositionGrid((origin[0], origin[1], origin[2]), mantissa, exponent)


def to_fp16(positions: F32, grid: PositionGrid) -> NDArray[np.float16]:
    """SPEC 6.4 backwards: the fp16 positions nearest to world positions; never -0. Raises ValueError if one overflows fp16."""
    unit = grid.scale_mantissa * 2.0**grid.scale_exponent
    origin = np.array([o * 2.0 ** (grid.scale_exponent - 24) for o in grid.origin])
    with np.errstate(over="ignore"):
        half = ((positions.astype(np.float64) - origin) / unit).astype(np.float16)
    if not np.isfinite(half).all():
        raise ValueError("a position does not fit the position grid")
    half[half == 0] = 0
    return half


def choose_cells(positions: NDArray[np.float16]) -> int:
    """SPEC B.1: the largest cell_shift with which every position has a cell, or 40 if none will do."""
    every = int(np.bitwise_or.reduce(position_integers(positions), axis=None))
    shift = min((every & -every).bit_length() - 1, CELL_INDEX - 1) if every else 0
    return CELL_INDEX if (cells(positions, shift) < 0).any() else shift


def morton_order(positions: NDArray[np.float16]) -> Int64:
    """SPEC B.1: a stable order along the Morton curve of the positions' cells."""
    return np.argsort(morton(cells(positions, choose_cells(positions))), kind="stable")


class _Counter:
    """A coder that only counts the symbols of the tree of cells. counts: int64 [18, 16]."""

    def __init__(self) -> None:
        self.counts = np.zeros((POSITION_MODELS, HALVES), dtype=np.int64)

    def plain(self, models: ModelSet, index: Int64, counts: list[int], name: SymbolName, given: Int64 | None) -> Int64:
        assert given is not None
        np.add.at(self.counts, (index, given), 1)
        return given


def frequencies(counts: Int64, first: int) -> Int64:
    """Frequencies that sum to 2^14 for symbols from `first` on, none of them 0; what rounding leaves goes to the most frequent."""
    found = np.zeros(len(counts), dtype=np.int64)
    seen = counts[first:] if counts[first:].any() else np.ones(len(counts) - first, dtype=np.int64)
    found[first:] = np.maximum(seen * TOTAL // seen.sum(), 1)
    found[np.argmax(found)] += TOTAL - found.sum()
    return found


def position_model(positions: NDArray[np.float16], chunk_size: int) -> PositionModel:
    """SPEC B.1: cell_shift, and the observed frequencies of the chunks that can be packed."""
    cell_shift, counter = choose_cells(positions), _Counter()
    for chunk in chunk_ranges(len(positions), chunk_size):
        code = chunk_codes(positions[chunk.start : chunk.stop], cell_shift)
        if code is not None:
            code_cells(counter, tables().gauss, [], [len(chunk)], code)
    frequency = [frequencies(c, int(model in EMPTY_MODELS)) for model, c in enumerate(counter.counts)]
    return PositionModel(cell_shift, np.array(frequency, dtype=np.uint16))


def pack_positions(scene: Scene) -> Scene:
    """SPEC B.1: the scene with its anchors along the Morton curve and positions in mode 1 where
    6.10 allows it. No attribute changes but its place."""
    scene = take_anchors(scene, morton_order(scene.positions))
    model, chunks = (
        position_model(scene.positions, scene.chunk_size),
        chunk_ranges(scene.anchor_count, scene.chunk_size),
    )
    parts = encode_positions(model, scene.positions, chunks, 1 << scene.lanes.mask)
    # SPEC 6.10 asks for a byte for 16 anchors, which a scene that fills a cube may not need.
    allowed = all(len(part) * ANCHORS_OF_A_BYTE >= len(chunk) for part, chunk in zip(parts, chunks, strict=True))
    return replace(scene, position_model=model if allowed else None)
