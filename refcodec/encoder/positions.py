"""SPEC.md B.1: the position grid, the order of anchors, and the model of packed positions."""

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..bitstream import positions as cells
from ..bitstream.chunks import chunk_ranges
from ..bitstream.conventions import F32, Int64
from ..bitstream.entropy import SymbolName
from ..bitstream.header import ORIGIN_BOUND, SCALE_EXPONENT_MAX, PositionGrid
from ..bitstream.scene import Scene, take_anchors
from ..bitstream.tables import TOTAL, ModelSet, tables

# fp16 holds integers up to this exactly. Without a lattice, the approximate largest coordinate of a scene in fp16, and
# that of positions far out: those beyond so many times the distance within which this share of all is.
EXACT, FP16_EXTENT, FP16_MOST, FAR, SHARE = 2048, 1024.0, 60000.0, 4, 0.95


def choose_grid(positions: F32, voxel: float | None = None) -> PositionGrid:
    """SPEC B.1: returns the position grid of some positions, float32 [N, 3] in world units.

    voxel: the edge of the lattice's voxels in world units, or None. With a voxel, the origin lies on the lattice near
    the middle, and fp16 holds the lattice exactly up to 2048 voxels from it. Without one, the largest coordinate is
    about 1024 in fp16. Positions far out, such as a sky, decide nothing. Raises ValueError for NaN, infinity, and a
    voxel or a distance that the grid cannot hold.
    """
    if not np.isfinite(positions).all():
        raise ValueError("a position is NaN or infinite")
    p = positions.astype(np.float64)
    p = p if len(p) else np.zeros((1, 3))
    low, high, median = p.min(axis=0), p.max(axis=0), np.median(p, axis=0)
    middle, half, away = (low + high) / 2, float((high - low).max()) / 2, np.abs(p - median).max(axis=1)
    reach, extent = float(np.quantile(away, SHARE)), half / FP16_EXTENT
    if half > (EXACT * voxel if voxel else FAR * reach):
        middle, extent = median, max(reach / FP16_EXTENT, float(away.max()) / FP16_MOST)
    # The bound on the grid's origin allows no smaller unit at this distance from the world's origin.
    unit = voxel or max(extent, float(np.abs(middle).max()) * 2.0**-21) or 1.0
    # A mantissa of 16 bits keeps scale_mantissa * P within 56 bits.
    fraction, exponent = math.frexp(unit)
    mantissa = round(fraction * 65536)
    if mantissa == 65536:
        mantissa, exponent = 32768, exponent + 1
    exponent -= 16
    if abs(exponent) > SCALE_EXPONENT_MAX:
        raise ValueError(f"a voxel of {unit} is out of range")
    # The origin is a whole number of units. It is stated in 2^(exponent - 24).
    step = mantissa * 2.0**exponent
    origin = tuple(round(m / step) * mantissa << 24 for m in middle.tolist())
    if max(abs(o) for o in origin) >= ORIGIN_BOUND:
        problem = f"its middle is {np.abs(middle).max():.3g} units from the world's origin, too far for its voxels of "
        raise ValueError(f"{problem}{step:.3g}: subtract an offset from all positions, or choose larger voxels")
    return PositionGrid((origin[0], origin[1], origin[2]), mantissa, exponent)


def to_fp16(positions: F32, grid: PositionGrid) -> NDArray[np.float16]:
    """Returns the fp16 positions nearest to world positions, float16 [N, 3], with 0 in place of -0 (SPEC 6.4, B.7).

    positions: float32 [N, 3]. Raises ValueError if fp16 cannot hold one.
    """
    unit = grid.scale_mantissa * 2.0**grid.scale_exponent
    origin = np.array([o * 2.0 ** (grid.scale_exponent - 24) for o in grid.origin])
    with np.errstate(over="ignore"):
        half = ((positions.astype(np.float64) - origin) / unit).astype(np.float16)
    if not np.isfinite(half).all():
        raise ValueError("a position does not fit the position grid")
    half[half == 0] = 0
    return half


def choose_cells(positions: NDArray[np.float16]) -> int:
    """SPEC B.1: returns the largest cell_shift with which every position has a cell, or 40 if there is none.

    positions: float16 [N, 3], finite.
    """
    every = int(np.bitwise_or.reduce(cells.position_integers(positions), axis=None))
    shift = min((every & -every).bit_length() - 1, cells.CELL_INDEX - 1) if every else 0
    return cells.CELL_INDEX if (cells.cells(positions, shift) < 0).any() else shift


def morton_order(positions: NDArray[np.float16]) -> Int64:
    """SPEC B.1: returns the indices that sort positions, float16 [N, 3], along the Morton curve of their cells.

    Positions with the same cell keep their order.
    """
    return np.argsort(cells.morton(cells.cells(positions, choose_cells(positions))), kind="stable")


class _Counter:
    """A coder that counts the symbols of trees of cells. counts: int64 [18, 16], by model and symbol."""

    def __init__(self) -> None:
        self.counts = np.zeros((cells.POSITION_MODELS, cells.HALVES), dtype=np.int64)

    def plain(self, models: ModelSet, index: Int64, counts: list[int], name: SymbolName, given: Int64 | None) -> Int64:
        assert given is not None
        np.add.at(self.counts, (index, given), 1)
        return given


def frequencies(counts: Int64, first: int) -> Int64:
    """Returns the frequencies of a model, int64 [symbols], with the sum 2^14.

    counts: int64 [symbols], occurrences of each symbol. first: the first possible symbol; from there on no frequency is
    0. The most frequent symbol absorbs the rounding difference.
    """
    frequency = np.zeros(len(counts), dtype=np.int64)
    seen = counts[first:] if counts[first:].any() else np.ones(len(counts) - first, dtype=np.int64)
    frequency[first:] = np.maximum(seen * TOTAL // seen.sum(), 1)
    frequency[np.argmax(frequency)] += TOTAL - frequency.sum()
    return frequency


def position_model(
    positions: NDArray[np.float16], chunk_size: int, chunks: list[range] | None = None
) -> cells.PositionModel:
    """SPEC B.1: returns cell_shift and the observed frequencies in the chunks that can be packed.

    positions: float16 [N, 3], finite, in file order. chunks: the anchors of each, None for the fewest chunks.
    """
    cell_shift, counter = choose_cells(positions), _Counter()
    for chunk in chunk_ranges(len(positions), chunk_size) if chunks is None else chunks:
        code = cells.chunk_codes(positions[chunk.start : chunk.stop], cell_shift)
        if code is not None:
            cells.code_cells(counter, tables().gauss, [], [len(chunk)], code)
    frequency = [frequencies(c, int(model in cells.EMPTY_MODELS)) for model, c in enumerate(counter.counts)]
    return cells.PositionModel(cell_shift, np.array(frequency, dtype=np.uint16))


def pack_positions(scene: Scene, layers: Int64 | None = None) -> Scene:
    """SPEC B.1: returns the scene with its anchors along the Morton curve, and with an index of mode 1.

    layers: of each anchor, from 0, int64 [N]: those of layer 0 come first, and no chunk has anchors of two. None for a
    single one. The attributes of an anchor do not change.
    """
    order, chunks = morton_order(scene.positions), None
    if layers is not None:
        order = order[np.argsort(layers[order], kind="stable")]
        ranges = [chunk_ranges(count, scene.chunk_size) for count in np.bincount(layers).tolist()]
        chunks = tuple(len(chunk) for own in ranges for chunk in own)
    scene = replace(take_anchors(scene, order), chunk_anchors=chunks)
    return replace(scene, position_model=position_model(scene.positions, scene.chunk_size, scene.chunks))
