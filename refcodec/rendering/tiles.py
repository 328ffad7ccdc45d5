"""Finds which Gaussians reach which tiles and blocks of an image, and sorts them by depth."""

import math
from typing import Any, NamedTuple

import numpy as np
from numba import prange

from .compiled import compiled
from .constants import (
    BLOCK,
    BLOCK_HEIGHT,
    BLOCK_WIDTH,
    BLOCKS_WIDE,
    F32,
    F64,
    FAR,
    I32,
    I64,
    LOG2_MIN,
    SLACK,
    TILE_HEIGHT,
    TILE_WIDTH,
)
from .simd import count_up, fma, fnma, maximum, minimum, round_down, round_up, runs, select, splat, square_root

# The number of parts of the sorted Gaussians that are listed in parallel. No result depends on it.
PARTS = 16
# The bounds of a pair's place in the list of its tile, which a float32 lane holds, and among all pairs, which an int32
# holds.
LIST_MAX, PAIRS_MAX = 1 << 24, 1 << 27


class Pairs(NamedTuple):
    """The pairs of Gaussians and tiles that list_tiles lists. P is their number.

    begin, counts: i64[N+1] and i32[N]. Gaussian i has room for its pairs at begin[i] : begin[i + 1], of which it uses
    the first counts[i].
    place: i32[begin[N]], for each pair its place among the pairs sorted by tile, then by depth.
    tile_begin, members: i64[tiles+1] and i32[P]. The Gaussians of tile t, nearest first, are
    members[tile_begin[t] : tile_begin[t + 1]].
    """

    begin: I64
    counts: I32
    place: I32
    tile_begin: I64
    members: I32


@compiled()
def sort_by_depth(depth: F64, room: I32) -> I32:
    """SPEC 14.5: returns the Gaussians that are drawn by increasing depth, and those of equal depth by index, i32[V].

    depth: f64[N]. room: i32[N], which is 0 for a Gaussian that is not drawn.
    """
    n = 0
    for i in range(room.shape[0]):
        n += room[i] > 0
    order, rounded = np.empty(n, np.int32), np.empty(n, np.float32)
    n = 0
    for i in range(room.shape[0]):
        if room[i] > 0:
            order[n], rounded[n] = i, depth[i]
            n += 1
    # Depths are above 0, so their bits sort as integers. A radix sort takes eleven bits at a time, from the lowest, and
    # keeps equal keys in order.
    key = rounded.view(np.uint32)
    other_order, other_key = np.empty_like(order), np.empty_like(key)
    at = np.zeros((3, 2048), np.int32)
    for i in range(n):
        for digit in range(3):
            at[digit, (key[i] >> np.uint32(11 * digit)) & np.uint32(2047)] += 1
    for digit in range(3):
        before = 0
        for value in range(2048):
            count = at[digit, value]
            at[digit, value] = before
            before += count
        for i in range(n):
            value = (key[i] >> np.uint32(11 * digit)) & np.uint32(2047)
            to = at[digit, value]
            at[digit, value] = to + 1
            other_order[to], other_key[to] = order[i], key[i]
        order, other_order = other_order, order
        key, other_key = other_key, key
    # Few depths are equal as float32. A stable sort in float64 orders them.
    first = 0
    for i in range(1, n + 1):
        if i < n and key[i] == key[first]:
            continue
        if i - first > 1:
            same = order[first:i].copy()
            order[first:i] = same[np.argsort(depth[same], kind="mergesort")]
        first = i
    return order


@compiled(parallel=True)
def list_tiles(order: I32, record: F32, room: I32, columns: int, rows: int) -> Any:
    """Lists the pairs of Gaussians and tiles, by tile, then by depth.

    Returns the fields of Pairs. order: as sort_by_depth gives it. record, room: as project_gaussians gives them.
    columns, rows: of tiles.
    """
    n, drawn, tiles = room.shape[0], order.shape[0], columns * rows
    begin, count = np.empty(n + 1, np.int64), np.empty(n, np.int32)
    begin[0] = 0
    for i in range(n):
        begin[i + 1] = begin[i] + room[i]
    box = record.view(np.int32)
    # First this holds the tile of each pair, and at the end its place in the sorted list.
    place = np.empty(begin[n], np.int32)
    for i in prange(n):
        count[i] = _tiles_of(i, record, box, columns, place, begin[i]) if room[i] else 0
    # First this holds how many pairs each part of the order has in each tile, and then where they begin.
    held = np.empty((PARTS, tiles), np.int64)
    for part in prange(PARTS):
        for t in range(tiles):
            held[part, t] = 0
        for k in range(drawn * part // PARTS, drawn * (part + 1) // PARTS):
            i = order[k]
            for p in range(begin[i], begin[i] + count[i]):
                held[part, place[p]] += 1
    tile_begin = np.empty(tiles + 1, np.int64)
    before = 0
    for t in range(tiles):
        tile_begin[t] = before
        for part in range(PARTS):
            more = held[part, t]
            held[part, t] = before
            before += more
    tile_begin[tiles] = before
    members = np.empty(before, np.int32)
    for part in prange(PARTS):
        for k in range(drawn * part // PARTS, drawn * (part + 1) // PARTS):
            i = order[k]
            for p in range(begin[i], begin[i] + count[i]):
                t = place[p]
                to = held[part, t]
                held[part, t] = to + 1
                members[to] = i
                place[p] = to
    return begin, count, place, tile_begin, members


@compiled()
def _tiles_of(i: int, record: F32, box: I32, columns: int, tiles: I32, begin: int) -> int:
    """Writes to tiles[begin:] the tiles that Gaussian i may reach, and returns how many.

    It may reach a tile if its alpha may be 1/255 at the centre of a pixel there.
    """
    left, right, top, bottom = box[i, 11], box[i, 12], box[i, 13], box[i, 14]
    n = begin
    if right - left == 1 or bottom - top == 1:
        # The ellipse touches all sides of its box.
        for row in range(top, bottom):
            for column in range(left, right):
                tiles[n] = row * columns + column
                n += 1
        return n - begin
    x, y = np.float64(record[i, 0]), np.float64(record[i, 1])
    u_there, v_there = np.float64(record[i, 2]), np.float64(record[i, 3])
    c = np.float64(record[i, 6])
    lean, width = record[i, 5] / c, 1 / np.float64(record[i, 4])
    reach2 = max(np.float64(record[i, 7]) - LOG2_MIN, 0.0)
    # v of the rightmost point of the ellipse. The leftmost point lies opposite.
    v_right = -lean * math.sqrt(reach2 / (lean * lean + 1))
    for row in range(top, bottom):
        # v at the first and the last row of pixel centres of the tile. On a row u^2 is at most reach2 - v^2. The pixel
        # with given u and v is (u - u_there - b / c * (v - v_there)) / a columns from the pixel of the record.
        v_from = v_there + c * (row * TILE_HEIGHT - SLACK - y)
        v_to = v_from + c * (TILE_HEIGHT - 1 + 2 * SLACK)
        v = min(max(v_right, v_from), v_to)
        x_to = x + (math.sqrt(max(reach2 - v * v, 0.0)) - u_there - lean * (v - v_there)) * width + SLACK
        v = min(max(-v_right, v_from), v_to)
        x_from = x - (math.sqrt(max(reach2 - v * v, 0.0)) + u_there + lean * (v - v_there)) * width - SLACK
        x_from, x_to = max(x_from, left * float(TILE_WIDTH)), min(x_to, right * float(TILE_WIDTH) - 1)
        if not x_from <= x_to:
            continue
        first, last = math.ceil(x_from), math.floor(x_to)
        if first > last:
            continue
        for column in range(first // TILE_WIDTH, last // TILE_WIDTH + 1):
            tiles[n] = row * columns + column
            n += 1
    return n - begin


@compiled(inline="always")
def block_at(x: int, y: int) -> int:
    """Returns where pixel (x, y) of a tile is in its state, in the first plane of a block."""
    return (
        ((y // BLOCK_HEIGHT) * BLOCKS_WIDE + x // BLOCK_WIDTH) * BLOCK
        + y % BLOCK_HEIGHT * BLOCK_WIDTH
        + x % BLOCK_WIDTH
    )


@compiled(inline="always")
def blocks_reached(
    a: np.float32, b: np.float32, c: np.float32, log_opacity: np.float32, u: np.float32, v: np.float32
) -> np.uint64:
    """Returns the blocks of a tile in which alpha may reach 1/255, as bits. That of a block is 8 * row + column.

    a, b, c, log_opacity: of the record. u, v: at the centre of the first pixel of the tile. One lane stands for one row
    of blocks, which has two rows of pixels.
    """
    zero, end = splat(np.float32(0)), splat(np.float32(BLOCKS_WIDE))
    shift, slack, width = splat(np.float32(1 / BLOCK_WIDTH)), splat(np.float32(SLACK)), splat(np.float32(1) / a)
    u_even = fma(count_up(), splat(b * np.float32(BLOCK_HEIGHT)), splat(u))
    v_even = fma(count_up(), splat(c * np.float32(BLOCK_HEIGHT)), splat(v))
    u_odd, v_odd = u_even + splat(b), v_even + splat(c)
    # The largest u^2 in each row of pixels.
    rest = splat(log_opacity - np.float32(LOG2_MIN))
    even, odd = fnma(v_even, v_even, rest), fnma(v_odd, v_odd, rest)
    half_even = fma(square_root(maximum(even, zero)), width, slack)
    half_odd = fma(square_root(maximum(odd, zero)), width, slack)
    # A row of pixels that is out of reach by more than a rounding error has an empty span.
    half_even = select(even >= zero - slack, half_even, splat(-FAR))
    half_odd = select(odd >= zero - slack, half_odd, splat(-FAR))
    middle_even, middle_odd = zero - u_even * width, zero - u_odd * width
    left = minimum(middle_even - half_even, middle_odd - half_odd)
    right = maximum(middle_even + half_even, middle_odd + half_odd)
    first = minimum(maximum(round_down(round_up(left) * shift), zero), end)
    last = minimum(round_down(round_down(right) * shift) + splat(np.float32(1)), end)
    return runs(first, maximum(last, first))
