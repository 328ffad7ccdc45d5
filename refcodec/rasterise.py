"""Images of Gaussians on the CPU, and their gradients (SPEC.md 14.4 and 14.5), with numba and without torch.

A renderer of this kind is that of Kerbl et al., "3D Gaussian Splatting for Real-Time Radiance Field Rendering" (2023), with the
projection of Zwicker et al., "EWA Splatting" (2002). `image` draws what SPEC.md 14.3 makes of a file; `rasterise` draws any arrays and
keeps what `rasterise_backward` needs.

Projection is float64 inside, blending float32. Results are the same bits whatever the number of threads: each tile is blended by one
thread, and every sum has one order. The number of threads is numba's (numba.set_num_threads, NUMBA_NUM_THREADS). Numbers of any size
are taken: a Gaussian with a value that is not finite, or whose projection leaves float64, is not drawn.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numba import njit, parallel_chunksize, prange
from numpy.typing import ArrayLike, NDArray

from .lanes import (
    WIDTH,
    bits,
    column_sums,
    count_up,
    exp2,
    fma,
    fnma,
    load,
    lowest,
    maximum,
    minimum,
    round_down,
    round_up,
    runs,
    select,
    splat,
    square_root,
    store,
    total,
)
from .rendering import Camera, Gaussians
from .scene import RenderInfo

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I32 = NDArray[np.int32]
I64 = NDArray[np.int64]

# SPEC 14.5: alphas below it count as 0; where less than the other would be left, a pixel takes no more.
ALPHA_MIN, TRANSMITTANCE_MIN = 1 / 255, 1e-4
# SPEC 14.4: how far beyond the image, in its size, the projection's derivative is taken.
BEYOND = 0.15

# Pixels of a block, whose values fill the lanes, and of a tile. A tile has 8 x 8 blocks: as many as a uint64 has bits.
BLOCK_WIDTH, BLOCK_HEIGHT = 4, 2
BLOCKS_WIDE = 8
TILE_WIDTH, TILE_HEIGHT = BLOCKS_WIDE * BLOCK_WIDTH, 8 * BLOCK_HEIGHT
# Floats of a block in a tile's state: eight planes of it, one behind the other.
BLOCK = 8 * WIDTH
# Gaussians of a tile between two looks at what of it is still to be drawn.
LOOK = 16
# Parts into which the sorted Gaussians are cut to be listed in parallel; no result depends on it.
PARTS = 16
# A pair's place in its tile's list is kept as a float32 lane, and among all pairs as an int32.
LIST_MAX, PAIRS_MAX = 1 << 24, 1 << 27

_MIN = np.float32(ALPHA_MIN)
_STOP = np.float32(TRANSMITTANCE_MIN)
_LOG2_MIN = math.log2(ALPHA_MIN)
# Exponents below this give alphas far below 1/255, and are raised to it: exp2 wants at least -126.
_FLOOR = np.float32(-32)
# exp(-w^2 / 2) = exp2(-(K w)^2).
_K2 = 0.5 / math.log(2)
# Pixels added to spans: a span may hold too much, since alpha decides, but never too little.
_SLACK = 0.01
# What the inverse deviations are kept between, for float32's sake. Steeper ones are those of a Gaussian that meets no pixel's centre;
# flatter ones do not change over an image.
_FLATTEST, _STEEPEST = 1e-30, 1e30
# Opacities from here on would overflow exp2.
_OPACITY_MAX = 2.0**126
# A span's half width that makes it empty.
_FAR = np.float32(1e18)
# Values of a pair's gradient: 1, u, v, u^2, uv, v^2 weighted with dL/dlog(alpha), then the colour's three.
_SUMS = 9


@dataclass(frozen=True)
class Settings:
    """What SPEC 6.5 leaves to a file, with the values of the original 3DGS. low_pass: square pixels added to both variances; near_plane:
    depth in world units up to which nothing is drawn; alpha_max: largest alpha; background: red, green, blue, 1 for white.

    Raises ValueError for values that SPEC R6.5-1 excludes, or another number of background values than three.
    """

    low_pass: float = 0.3
    near_plane: float = 0.2
    alpha_max: float = 0.99
    background: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        if not (0 <= self.low_pass < math.inf and 0 < self.near_plane < math.inf and 0 < self.alpha_max <= 1):
            raise ValueError(
                f"low_pass {self.low_pass}, near_plane {self.near_plane}, alpha_max {self.alpha_max}: "
                "at least 0, above 0 and in ]0, 1] are wanted"
            )
        if len(self.background) != 3:
            raise ValueError(f"{len(self.background)} background values, not 3")


@dataclass(frozen=True, eq=False)
class _Tape:
    """What the backward pass needs: the inputs, and the lists of the forward pass (P pairs of Gaussian and tile)."""

    inputs: tuple[F32, F32, F32, F32, F32]
    camera: Camera
    settings: Settings
    # f32[N,16]: see _project.
    record: F32
    # i64[N+1]: Gaussian i has room for its pairs at begin[i] : begin[i + 1], of which the first count[i] are used.
    begin: I64
    count: I32
    # i32[...]: for each of these its place among the pairs sorted by tile, then depth.
    place: I32
    # i64[tiles+1] and i32[P]: the Gaussians of tile t are members[tile_begin[t] : tile_begin[t + 1]], nearest first.
    tile_begin: I64
    members: I32
    # f32[H,W]: place in the tile's list of the last Gaussian drawn in each pixel, -1 for none.
    last: F32


@dataclass(frozen=True, eq=False)
class Rendering:
    """image f32[H,W,3] with the background; transmittance f32[H,W] that reaches it; radius f32[N] in pixels.

    radius is the larger half axis of the ellipse in which alpha is at least 1/255, and 0 for what is not drawn: behind the near plane,
    outside the image, of opacity below 1/255 or from 2^126 on, or not finite.
    """

    image: F32
    transmittance: F32
    radius: F32
    tape: _Tape = field(repr=False)


@dataclass(frozen=True, eq=False)
class Gradients:
    """dL/dx, f32 and shaped like the inputs; 0 for what is not drawn. screen f32[N]: densification's measure.

    quaternion: with respect to the value given, not the normalised one. screen: the length of the gradient of the projected mean in
    normalised device units, in which the image is 2 wide and 2 high: |(dL/dx * width / 2, dL/dy * height / 2)| with x, y in pixels;
    3DGS grows where its mean over the views exceeds 0.0002.
    """

    mean: F32
    quaternion: F32
    scale: F32
    opacity: F32
    colour: F32
    screen: F32


@njit(cache=True, error_model="numpy")
def _dot(x: Any, y: Any) -> float:
    return x[0] * y[0] + x[1] * y[1] + x[2] * y[2]


@njit(cache=True, error_model="numpy")
def _combine(f: Any, v: Any) -> Any:
    """The sum of three vectors v, each times its factor f."""
    return (
        f[0] * v[0][0] + f[1] * v[1][0] + f[2] * v[2][0],
        f[0] * v[0][1] + f[1] * v[1][1] + f[2] * v[2][1],
        f[0] * v[0][2] + f[1] * v[1][2] + f[2] * v[2][2],
    )


@njit(cache=True, error_model="numpy")
def _row3(values: F32, i: int) -> Any:
    return np.float64(values[i, 0]), np.float64(values[i, 1]), np.float64(values[i, 2])


@njit(cache=True, error_model="numpy")
def _rows_of(v: Any) -> Any:
    """Rows of three of a flat tuple; parallel loops take none that is nested."""
    return (v[0], v[1], v[2]), (v[3], v[4], v[5]), (v[6], v[7], v[8]), (v[9], v[10], v[11])


@njit(cache=True, error_model="numpy")
def _camera_space(i: int, mean: F32, view: Any) -> Any:
    """Mean of Gaussian i in camera space. view: the rotation's rows, then the translation, as tuples."""
    m = _row3(mean, i)
    return _dot(view[0], m) + view[3][0], _dot(view[1], m) + view[3][1], _dot(view[2], m) + view[3][2]


@njit(cache=True, error_model="numpy")
def _axes(i: int, p: Any, quaternion: F32, view: Any, lens: Any) -> Any:
    """For Gaussian i at p in camera space: the rows of J W, the unit quaternion and 1 / its length, the columns of its rotation R, and
    the rows of J W R.
    """
    fx, fy, _, _, x_low, x_high, y_low, y_high = lens
    near = 1 / p[2]
    slope_x, slope_y = min(max(p[0] * near, x_low), x_high), min(max(p[1] * near, y_low), y_high)
    row_x = _combine((fx * near, 0.0, -fx * near * slope_x), view)
    row_y = _combine((0.0, fy * near, -fy * near * slope_y), view)
    w, x, y, z = np.float64(quaternion[i, 0]), np.float64(quaternion[i, 1]), np.float64(quaternion[i, 2]), np.float64(quaternion[i, 3])
    shrink = 1 / math.sqrt(w * w + x * x + y * y + z * z)
    w, x, y, z = w * shrink, x * shrink, y * shrink, z * shrink
    columns = (
        (1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)),
        (2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)),
        (2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)),
    )
    along_x = (_dot(row_x, columns[0]), _dot(row_x, columns[1]), _dot(row_x, columns[2]))
    along_y = (_dot(row_y, columns[0]), _dot(row_y, columns[1]), _dot(row_y, columns[2]))
    return row_x, row_y, (w, x, y, z), shrink, columns, along_x, along_y


@njit(cache=True, error_model="numpy")
def _scaled(s: Any, v: Any) -> Any:
    return s[0] * v[0], s[1] * v[1], s[2] * v[2]


@njit(cache=True, parallel=True, error_model="numpy")
def _project(
    mean: F32,
    quaternion: F32,
    scale: F32,
    opacity: F32,
    colour: F32,
    view: Any,
    lens: Any,
    width: int,
    height: int,
    low_pass: float,
    near_plane: float,
) -> Any:
    """SPEC 14.4, PROJECT: record f32[N,16], room i32[N], depth f64[N] and radius f32[N]; what is not drawn has room and
    radius 0, and no record.

    A record is one line of the cache: column and row of the pixel of the image that is nearest to the centre, and u and v at that
    pixel's centre; a, b, c and log2(opacity); red, green, blue; the box in tiles as four int32 (from x, to x, from y, to y).
    alpha = exp2(log2(opacity) - u^2 - v^2), where a pixel to the right adds a to u, and one below adds b to u and c to v: this
    triangular root of the inverse covariance keeps digits that a needle's quadratic form loses, and numbers counted from a pixel of
    the image keep those that a far centre's would. room is the number of tiles in the box.
    """
    n = mean.shape[0]
    record, room = np.empty((n, 16), np.float32), np.empty(n, np.int32)
    depth, radius = np.empty(n, np.float64), np.empty(n, np.float32)
    box = record.view(np.int32)
    k = math.sqrt(_K2)
    for i in prange(n):
        room[i], radius[i] = 0, 0
        # SPEC 14.5: an opacity below 1/255 gives no alpha that counts.
        if not (opacity[i] >= _MIN and opacity[i] < _OPACITY_MAX):
            continue
        if not (math.isfinite(colour[i, 0]) and math.isfinite(colour[i, 1]) and math.isfinite(colour[i, 2])):
            continue
        log_opacity = math.log2(np.float64(opacity[i]))
        world = _rows_of(view)
        p = _camera_space(i, mean, world)
        # SPEC 14.4: not drawn at depth near_plane or less.
        if not (p[2] > near_plane and p[2] < math.inf):
            continue
        _, _, _, _, _, along_x, along_y = _axes(i, p, quaternion, world, lens)
        s = _row3(scale, i)
        # SPEC 14.4, PROJECT's `half`; the covariance's entries are the products of its rows.
        to_x, to_y = _scaled(s, along_x), _scaled(s, along_y)
        x2, y2, xy = _dot(to_x, to_x), _dot(to_y, to_y), _dot(to_x, to_y)
        cross = (to_x[1] * to_y[2] - to_x[2] * to_y[1], to_x[2] * to_y[0] - to_x[0] * to_y[2], to_x[0] * to_y[1] - to_x[1] * to_y[0])
        # The root of PROJECT's d, by Lagrange's identity: no difference of large products, so that needles keep their width.
        root = math.sqrt(_dot(cross, cross) + low_pass * (x2 + y2) + low_pass * low_pass)
        width_x, width_y = math.sqrt(x2 + low_pass), math.sqrt(y2 + low_pass)
        a, b, c = k * width_y / root, -k * xy / (width_y * root), k / width_y
        x, y = lens[0] * p[0] / p[2] + lens[2], lens[1] * p[1] / p[2] + lens[3]
        # The root is infinite where the covariance's determinant overflows. Written so that what is not a number fails.
        if not (root < math.inf and max(a, c) < _STEEPEST and abs(b) < _STEEPEST and abs(x) + abs(y) < math.inf):
            continue
        reach = math.sqrt(max(log_opacity - _LOG2_MIN, 0.0)) / k
        reach_x, reach_y = reach * width_x, reach * width_y
        # Pixels whose centres the ellipse's box holds; compared before they are integers, which such numbers may not fit.
        left, right = max(x - reach_x - 0.5 - _SLACK, 0.0), min(x + reach_x - 0.5 + _SLACK, width - 1.0)
        top, bottom = max(y - reach_y - 0.5 - _SLACK, 0.0), min(y + reach_y - 0.5 + _SLACK, height - 1.0)
        if not (left <= right and top <= bottom):
            continue
        x_from, x_to, y_from, y_to = math.ceil(left), math.floor(right), math.ceil(top), math.floor(bottom)
        if x_from > x_to or y_from > y_to:
            continue
        box[i, 11], box[i, 12] = x_from // TILE_WIDTH, x_to // TILE_WIDTH + 1
        box[i, 13], box[i, 14] = y_from // TILE_HEIGHT, y_to // TILE_HEIGHT + 1
        room[i] = (box[i, 12] - box[i, 11]) * (box[i, 14] - box[i, 13])
        # SPEC 14.2: pixels' centres are at halves.
        column, row = math.floor(min(max(x, 0.0), width - 1.0)), math.floor(min(max(y, 0.0), height - 1.0))
        dx, dy = column + 0.5 - x, row + 0.5 - y
        record[i, 0], record[i, 1], record[i, 2], record[i, 3] = column, row, a * dx + b * dy, c * dy
        record[i, 4], record[i, 5], record[i, 6], record[i, 7] = max(a, _FLATTEST), b, max(c, _FLATTEST), log_opacity
        record[i, 8], record[i, 9], record[i, 10] = colour[i, 0], colour[i, 1], colour[i, 2]
        depth[i] = p[2]
        middle, apart = (x2 + y2) / 2, (x2 - y2) / 2
        radius[i] = reach * math.sqrt(low_pass + middle + math.sqrt(apart * apart + xy * xy))
    return record, room, depth, radius


@njit(cache=True, error_model="numpy")
def _sort(depth: F64, room: I32) -> I32:
    """SPEC 14.5: the drawn Gaussians (those with room) by depth, equal depths by index: i32[V]."""
    n = 0
    for i in range(room.shape[0]):
        n += room[i] > 0
    order, rounded = np.empty(n, np.int32), np.empty(n, np.float32)
    n = 0
    for i in range(room.shape[0]):
        if room[i] > 0:
            order[n], rounded[n] = i, depth[i]
            n += 1
    # Depths are above 0: their bits sort as integers. A radix sort, eleven bits at a time from the lowest, keeps equal keys in order.
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
    # Few depths are the same as float32; a stable sort of those settles them.
    first = 0
    for i in range(1, n + 1):
        if i < n and key[i] == key[first]:
            continue
        if i - first > 1:
            same = order[first:i].copy()
            order[first:i] = same[np.argsort(depth[same], kind="mergesort")]
        first = i
    return order


@njit(cache=True, parallel=True, error_model="numpy")
def _list(order: I32, record: F32, room: I32, columns: int, rows: int) -> Any:
    """Pairs of Gaussians and tiles, by tile, then depth: a _Tape's begin, count, place, tile_begin, members."""
    n, drawn, tiles = room.shape[0], order.shape[0], columns * rows
    begin, count = np.empty(n + 1, np.int64), np.empty(n, np.int32)
    begin[0] = 0
    for i in range(n):
        begin[i + 1] = begin[i] + room[i]
    box = record.view(np.int32)
    # First the tile of each pair, then its place in the sorted list.
    place = np.empty(begin[n], np.int32)
    for i in prange(n):
        count[i] = _tiles_of(i, record, box, columns, place, begin[i]) if room[i] else 0
    # Pairs of each part of the order in each tile, then where they begin.
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


@njit(cache=True, error_model="numpy")
def _tiles_of(i: int, record: F32, box: I32, columns: int, tiles: I32, begin: int) -> int:
    """Writes the tiles with a pixel centre where Gaussian i's alpha may reach 1/255 to tiles[begin:], and returns how many."""
    left, right, top, bottom = box[i, 11], box[i, 12], box[i, 13], box[i, 14]
    n = begin
    if right - left == 1 or bottom - top == 1:
        # The ellipse touches all sides of its box.
        for row in range(top, bottom):
            for column in range(left, right):
                tiles[n] = row * columns + column
                n += 1
        return n - begin
    x, y, u_there, v_there = np.float64(record[i, 0]), np.float64(record[i, 1]), np.float64(record[i, 2]), np.float64(record[i, 3])
    c = np.float64(record[i, 6])
    lean, width = record[i, 5] / c, 1 / np.float64(record[i, 4])
    reach2 = max(np.float64(record[i, 7]) - _LOG2_MIN, 0.0)
    # v of the ellipse's rightmost point; its leftmost lies opposite.
    v_right = -lean * math.sqrt(reach2 / (lean * lean + 1))
    for row in range(top, bottom):
        # v of the tile's first and last row of pixel centres. There u^2 is at most reach2 - v^2; a pixel where u and v are so much
        # is (u - u_there - b / c * (v - v_there)) / a from the record's.
        v_from = v_there + c * (row * TILE_HEIGHT - _SLACK - y)
        v_to = v_from + c * (TILE_HEIGHT - 1 + 2 * _SLACK)
        v = min(max(v_right, v_from), v_to)
        x_to = x + (math.sqrt(max(reach2 - v * v, 0.0)) - u_there - lean * (v - v_there)) * width + _SLACK
        v = min(max(-v_right, v_from), v_to)
        x_from = x - (math.sqrt(max(reach2 - v * v, 0.0)) + u_there + lean * (v - v_there)) * width - _SLACK
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


@njit(cache=True, inline="always", error_model="numpy")
def _at(x: int, y: int) -> int:
    """Where pixel (x, y) of a tile is in the first plane of its state."""
    return ((y // BLOCK_HEIGHT) * BLOCKS_WIDE + x // BLOCK_WIDTH) * BLOCK + y % BLOCK_HEIGHT * BLOCK_WIDTH + x % BLOCK_WIDTH


@njit(cache=True, inline="always", error_model="numpy")
def _blocks(a: np.float32, b: np.float32, c: np.float32, log_opacity: np.float32, u: np.float32, v: np.float32) -> np.uint64:
    """The blocks of a tile in which alpha may reach 1/255; bit 8 * row + column is set for a block's.

    u and v: at the centre of the tile's first pixel. One lane is one row of blocks; each has two rows of pixels.
    """
    zero, end = splat(np.float32(0)), splat(np.float32(BLOCKS_WIDE))
    shift, slack, width = splat(np.float32(1 / BLOCK_WIDTH)), splat(np.float32(_SLACK)), splat(np.float32(1) / a)
    u_even = fma(count_up(), splat(b * np.float32(BLOCK_HEIGHT)), splat(u))
    v_even = fma(count_up(), splat(c * np.float32(BLOCK_HEIGHT)), splat(v))
    u_odd, v_odd = u_even + splat(b), v_even + splat(c)
    # u^2 can be this much.
    rest = splat(log_opacity - np.float32(_LOG2_MIN))
    even, odd = fnma(v_even, v_even, rest), fnma(v_odd, v_odd, rest)
    half_even = fma(square_root(maximum(even, zero)), width, slack)
    half_odd = fma(square_root(maximum(odd, zero)), width, slack)
    # A row that is out of reach, by more than a rounding, has an empty span.
    half_even = select(even >= zero - slack, half_even, splat(-_FAR))
    half_odd = select(odd >= zero - slack, half_odd, splat(-_FAR))
    middle_even, middle_odd = zero - u_even * width, zero - u_odd * width
    left = minimum(middle_even - half_even, middle_odd - half_odd)
    right = maximum(middle_even + half_even, middle_odd + half_odd)
    first = minimum(maximum(round_down(round_up(left) * shift), zero), end)
    last = minimum(round_down(round_down(right) * shift) + splat(np.float32(1)), end)
    return runs(first, maximum(last, first))


@njit(cache=True, parallel=True, error_model="numpy")
def _blend(record: F32, tile_begin: I64, members: I32, width: int, height: int, alpha_max: np.float32, background: F32) -> Any:
    """Image f32[H,W,3], transmittance f32[H,W] and last f32[H,W] (see _Tape)."""
    image, transmittance = np.empty((height, width, 3), np.float32), np.empty((height, width), np.float32)
    last = np.empty((height, width), np.float32)
    columns = (width + TILE_WIDTH - 1) // TILE_WIDTH
    for t in prange(tile_begin.shape[0] - 1):
        x0, y0 = t % columns * TILE_WIDTH, t // columns * TILE_HEIGHT
        _blend_tile(
            record,
            members[tile_begin[t] : tile_begin[t + 1]],
            x0,
            y0,
            alpha_max,
            background,
            image[y0 : y0 + TILE_HEIGHT, x0 : x0 + TILE_WIDTH],
            transmittance[y0 : y0 + TILE_HEIGHT, x0 : x0 + TILE_WIDTH],
            last[y0 : y0 + TILE_HEIGHT, x0 : x0 + TILE_WIDTH],
        )
    return image, transmittance, last


@njit(cache=True, error_model="numpy")
def _blend_tile(
    record: F32,
    members: I32,
    x0: int,
    y0: int,
    alpha_max: np.float32,
    background: F32,
    image: F32,
    transmittance: F32,
    last: F32,
) -> None:
    """SPEC 14.5, PIXEL: blends one tile; image, transmittance and last are its parts of the whole."""
    rows, columns = transmittance.shape
    # Planes of a block: x, y, transmittance, place of the last Gaussian drawn, red, green, blue. The sign of the transmittance is a
    # flag: it is negative where the pixel is finished or outside the image, so that what would be left is below the least one too.
    state = np.zeros(TILE_HEIGHT * TILE_WIDTH // WIDTH * BLOCK, np.float32)
    for y in range(TILE_HEIGHT):
        for x in range(TILE_WIDTH):
            at = _at(x, y)
            state[at], state[at + WIDTH] = x, y
            state[at + 2 * WIDTH], state[at + 3 * WIDTH] = 1 if y < rows and x < columns else -1, -1
    zero, floor = splat(np.float32(0)), splat(_FLOOR)
    cap, least, stop = splat(alpha_max), splat(_MIN), splat(_STOP)
    unfinished = _unfinished(state)
    for k in range(members.shape[0]):
        i = members[k]
        a, b, c, log_opacity = record[i, 4], record[i, 5], record[i, 6], record[i, 7]
        dx, dy = np.float32(x0) - record[i, 0], np.float32(y0) - record[i, 1]
        u0, v0 = record[i, 2] + (a * dx + b * dy), record[i, 3] + c * dy
        blocks = _blocks(a, b, c, log_opacity, u0, v0) & unfinished
        while blocks:
            at = lowest(blocks) * BLOCK
            blocks &= blocks - np.uint64(1)
            x, y = load(state, at), load(state, at + WIDTH)
            u, v = fma(splat(a), x, fma(splat(b), y, splat(u0))), fma(splat(c), y, splat(v0))
            raw = exp2(maximum(fnma(u, u, fnma(v, v, splat(log_opacity))), floor))
            # SPEC 14.5, PIXEL. Unseen: alpha 0. So the transmittance stays, or is what it was when the pixel was finished.
            alpha = minimum(raw, cap)
            seen = alpha >= least
            alpha = select(seen, alpha, zero)
            before = load(state, at + 2 * WIDTH)
            after = fnma(alpha, before, before)
            going = after >= stop
            weight = select(going, alpha * before, zero)
            store(state, at + 2 * WIDTH, select(going, after, minimum(before, zero - before)))
            # A sum, exact for integers: a choice between the stored value and another would compile to a masked store, ten times slower.
            place = load(state, at + 3 * WIDTH)
            store(state, at + 3 * WIDTH, place + select(going & seen, splat(np.float32(k)) - place, zero))
            store(state, at + 4 * WIDTH, fma(weight, splat(record[i, 8]), load(state, at + 4 * WIDTH)))
            store(state, at + 5 * WIDTH, fma(weight, splat(record[i, 9]), load(state, at + 5 * WIDTH)))
            store(state, at + 6 * WIDTH, fma(weight, splat(record[i, 10]), load(state, at + 6 * WIDTH)))
        if k % LOOK == LOOK - 1:
            unfinished = _unfinished(state)
            if not unfinished:
                break
    for y in range(rows):
        for x in range(columns):
            at = _at(x, y)
            left = abs(state[at + 2 * WIDTH])
            transmittance[y, x], last[y, x] = left, state[at + 3 * WIDTH]
            for channel in range(3):
                image[y, x, channel] = state[at + (4 + channel) * WIDTH] + left * background[channel]


@njit(cache=True, error_model="numpy")
def _unfinished(state: F32) -> np.uint64:
    """The blocks with a pixel that takes more, as _blocks has them."""
    found = np.uint64(0)
    for block in range(TILE_HEIGHT * TILE_WIDTH // WIDTH):
        some = bits(load(state, block * BLOCK + 2 * WIDTH) >= splat(_STOP)) != np.uint64(0)
        found |= np.uint64(some) << np.uint64(block)
    return found


@njit(cache=True, parallel=True, error_model="numpy")
def _unblend(
    record: F32,
    tile_begin: I64,
    members: I32,
    last: F32,
    transmittance: F32,
    alpha_max: np.float32,
    background: F32,
    grad_image: F32,
    grad_transmittance: F32,
) -> F32:
    """Gradient of each pair, f32[P * 9]: see _SUMS. A pair that no pixel reached has zeros."""
    sums = np.empty(members.shape[0] * _SUMS, np.float32)
    columns = (transmittance.shape[1] + TILE_WIDTH - 1) // TILE_WIDTH
    for t in prange(tile_begin.shape[0] - 1):
        x0, y0 = t % columns * TILE_WIDTH, t // columns * TILE_HEIGHT
        _unblend_tile(
            record,
            members[tile_begin[t] : tile_begin[t + 1]],
            x0,
            y0,
            alpha_max,
            background,
            transmittance[y0 : y0 + TILE_HEIGHT, x0 : x0 + TILE_WIDTH],
            last[y0 : y0 + TILE_HEIGHT, x0 : x0 + TILE_WIDTH],
            grad_image[y0 : y0 + TILE_HEIGHT, x0 : x0 + TILE_WIDTH],
            grad_transmittance[y0 : y0 + TILE_HEIGHT, x0 : x0 + TILE_WIDTH],
            sums[tile_begin[t] * _SUMS : tile_begin[t + 1] * _SUMS],
        )
    return sums


@njit(cache=True, error_model="numpy")
def _unblend_tile(
    record: F32,
    members: I32,
    x0: int,
    y0: int,
    alpha_max: np.float32,
    background: F32,
    transmittance: F32,
    last: F32,
    grad_image: F32,
    grad_transmittance: F32,
    sums: F32,
) -> None:
    """Walks one tile back to front, undoing the blending: what lies behind a Gaussian is then known, and small where it is small."""
    rows, columns = transmittance.shape
    # Planes of a block: x, y, transmittance in front of what was undone, dL/d of its logarithm, place of the last Gaussian drawn, and
    # the gradient of red, green, blue.
    state = np.zeros(TILE_HEIGHT * TILE_WIDTH // WIDTH * BLOCK, np.float32)
    furthest = np.full(TILE_HEIGHT * TILE_WIDTH // WIDTH, np.float32(-1))
    for y in range(TILE_HEIGHT):
        for x in range(TILE_WIDTH):
            at = _at(x, y)
            state[at], state[at + WIDTH], state[at + 4 * WIDTH] = x, y, -1
            if y >= rows or x >= columns:
                continue
            behind = grad_transmittance[y, x]
            for channel in range(3):
                behind += grad_image[y, x, channel] * background[channel]
                state[at + (5 + channel) * WIDTH] = grad_image[y, x, channel]
            state[at + 2 * WIDTH] = transmittance[y, x]
            state[at + 3 * WIDTH] = transmittance[y, x] * behind
            state[at + 4 * WIDTH] = last[y, x]
            furthest[at // BLOCK] = max(furthest[at // BLOCK], last[y, x])
    end = int(furthest.max()) + 1
    for j in range(end * _SUMS, members.shape[0] * _SUMS):
        sums[j] = 0
    zero, one, floor, cap, least = splat(np.float32(0)), splat(np.float32(1)), splat(_FLOOR), splat(alpha_max), splat(_MIN)
    reached = np.uint64(0)
    for k in range(end - 1, -1, -1):
        if k == end - 1 or k % LOOK == LOOK - 1:
            # The blocks in which this Gaussian, or one of the next until this is asked again, was drawn.
            reached = np.uint64(0)
            for row in range(TILE_HEIGHT // BLOCK_HEIGHT):
                some = load(furthest, row * WIDTH) >= splat(np.float32(k - k % LOOK))
                reached |= bits(some) << np.uint64(row * WIDTH)
        i = members[k]
        a, b, c, log_opacity = record[i, 4], record[i, 5], record[i, 6], record[i, 7]
        dx, dy = np.float32(x0) - record[i, 0], np.float32(y0) - record[i, 1]
        u0, v0 = record[i, 2] + (a * dx + b * dy), record[i, 3] + c * dy
        s_1, s_u, s_v, s_uu, s_uv, s_vv = zero, zero, zero, zero, zero, zero
        s_red, s_green, s_blue = zero, zero, zero
        blocks = _blocks(a, b, c, log_opacity, u0, v0) & reached
        while blocks:
            at = lowest(blocks) * BLOCK
            blocks &= blocks - np.uint64(1)
            x, y = load(state, at), load(state, at + WIDTH)
            u, v = fma(splat(a), x, fma(splat(b), y, splat(u0))), fma(splat(c), y, splat(v0))
            raw = exp2(maximum(fnma(u, u, fnma(v, v, splat(log_opacity))), floor))
            drawn = (raw >= least) & (load(state, at + 4 * WIDTH) >= splat(np.float32(k)))
            raw = select(drawn, raw, zero)
            alpha = minimum(raw, cap)
            inverse = one / (one - alpha)
            before = load(state, at + 2 * WIDTH) * inverse
            weight = alpha * before
            red, green, blue = load(state, at + 5 * WIDTH), load(state, at + 6 * WIDTH), load(state, at + 7 * WIDTH)
            along = fma(splat(record[i, 8]), red, fma(splat(record[i, 9]), green, splat(record[i, 10]) * blue))
            behind = load(state, at + 3 * WIDTH)
            store(state, at + 2 * WIDTH, before)
            store(state, at + 3 * WIDTH, fma(weight, along, behind))
            # dL/dlog(alpha): alpha adds its colour and dims what lies behind. The cap lets no gradient through.
            g = select(raw <= cap, raw * fnma(behind, inverse, before * along), zero)
            g_u, g_v = g * u, g * v
            s_1, s_u, s_v = s_1 + g, s_u + g_u, s_v + g_v
            s_uu, s_uv, s_vv = fma(g_u, u, s_uu), fma(g_v, u, s_uv), fma(g_v, v, s_vv)
            s_red, s_green, s_blue = fma(weight, red, s_red), fma(weight, green, s_green), fma(weight, blue, s_blue)
        store(sums, k * _SUMS, column_sums(s_1, s_u, s_v, s_uu, s_uv, s_vv, s_red, s_green))
        sums[k * _SUMS + 8] = total(s_blue)


@njit(cache=True, parallel=True, error_model="numpy")
def _unproject(
    sums: F32,
    record: F32,
    begin: I64,
    count: I32,
    place: I32,
    mean: F32,
    quaternion: F32,
    scale: F32,
    opacity: F32,
    view: Any,
    lens: Any,
    width: int,
    height: int,
) -> Any:
    """Adds up the pairs of each Gaussian, and takes the gradient through the projection; the arrays of Gradients, in their order."""
    n = mean.shape[0]
    d_mean, d_quaternion, d_scale = np.empty((n, 3), np.float32), np.empty((n, 4), np.float32), np.empty((n, 3), np.float32)
    d_opacity, d_colour, screen = np.empty(n, np.float32), np.empty((n, 3), np.float32), np.empty(n, np.float32)
    fx, fy, _, _, x_low, x_high, y_low, y_high = lens
    for i in prange(n):
        if count[i] == 0:
            for j in range(3):
                d_mean[i, j], d_quaternion[i, j], d_scale[i, j], d_colour[i, j] = 0, 0, 0, 0
            d_quaternion[i, 3], d_opacity[i], screen[i] = 0, 0, 0
            continue
        s_1, s_u, s_v, s_uu, s_uv, s_vv, s_red, s_green, s_blue = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for p in range(begin[i], begin[i] + count[i]):
            at = place[p] * _SUMS
            s_1 += sums[at]
            s_u += sums[at + 1]
            s_v += sums[at + 2]
            s_uu += sums[at + 3]
            s_uv += sums[at + 4]
            s_vv += sums[at + 5]
            s_red += sums[at + 6]
            s_green += sums[at + 7]
            s_blue += sums[at + 8]
        d_colour[i, 0], d_colour[i, 1], d_colour[i, 2] = s_red, s_green, s_blue
        d_opacity[i] = s_1 / opacity[i]
        # alpha = opacity * exp(-(u^2 + v^2) / (2 K^2)), where (u, v) is A times the offset, A = (a b; 0 c): the gradient of the
        # centre is A^T s / K^2, that of the covariance A^T S A / (2 K^4). Of xy it is that of both of the matrix's entries.
        a, b, c = np.float64(record[i, 4]) / _K2, np.float64(record[i, 5]) / _K2, np.float64(record[i, 6]) / _K2
        d_x, d_y = a * s_u, b * s_u + c * s_v
        screen[i] = math.sqrt((d_x * width) ** 2 + (d_y * height) ** 2) / 2
        twice_xx = a * a * s_uu
        d_xy = a * (b * s_uu + c * s_uv)
        twice_yy = b * b * s_uu + 2 * b * c * s_uv + c * c * s_vv
        world = _rows_of(view)
        q = _camera_space(i, mean, world)
        row_x, row_y, unit, shrink, columns, along_x, along_y = _axes(i, q, quaternion, world, lens)
        # The covariance's entries are products of to_x and to_y; those are scale times along_x, along_y; those rows times columns.
        s = _row3(scale, i)
        to_x, to_y = _scaled(s, along_x), _scaled(s, along_y)
        d_to_x, d_to_y = _combine((twice_xx, d_xy, 0.0), (to_x, to_y, to_y)), _combine((d_xy, twice_yy, 0.0), (to_x, to_y, to_y))
        d_scale[i, 0] = d_to_x[0] * along_x[0] + d_to_y[0] * along_y[0]
        d_scale[i, 1] = d_to_x[1] * along_x[1] + d_to_y[1] * along_y[1]
        d_scale[i, 2] = d_to_x[2] * along_x[2] + d_to_y[2] * along_y[2]
        d_x_axes, d_y_axes = _scaled(d_to_x, s), _scaled(d_to_y, s)
        # Columns of the gradient of R.
        r0 = _combine((d_x_axes[0], d_y_axes[0], 0.0), (row_x, row_y, row_y))
        r1 = _combine((d_x_axes[1], d_y_axes[1], 0.0), (row_x, row_y, row_y))
        r2 = _combine((d_x_axes[2], d_y_axes[2], 0.0), (row_x, row_y, row_y))
        w, x, y, z = unit
        d_w = 2 * (x * (r1[2] - r2[1]) + y * (r2[0] - r0[2]) + z * (r0[1] - r1[0]))
        d_i = 2 * (y * (r1[0] + r0[1]) + z * (r2[0] + r0[2]) + w * (r1[2] - r2[1]) - 2 * x * (r1[1] + r2[2]))
        d_j = 2 * (x * (r1[0] + r0[1]) + z * (r2[1] + r1[2]) + w * (r2[0] - r0[2]) - 2 * y * (r0[0] + r2[2]))
        d_k = 2 * (x * (r2[0] + r0[2]) + y * (r2[1] + r1[2]) + w * (r0[1] - r1[0]) - 2 * z * (r0[0] + r1[1]))
        # Only what turns the quaternion, not what lengthens it.
        radial = w * d_w + x * d_i + y * d_j + z * d_k
        d_quaternion[i, 0], d_quaternion[i, 1] = (d_w - w * radial) * shrink, (d_i - x * radial) * shrink
        d_quaternion[i, 2], d_quaternion[i, 3] = (d_j - y * radial) * shrink, (d_k - z * radial) * shrink
        d_row_x, d_row_y = _combine(d_x_axes, columns), _combine(d_y_axes, columns)
        near = 1 / q[2]
        # A clamped slope is a constant.
        d_slope_x = -fx * near * _dot(d_row_x, world[2]) if x_low <= q[0] * near <= x_high else 0.0
        d_slope_y = -fy * near * _dot(d_row_y, world[2]) if y_low <= q[1] * near <= y_high else 0.0
        d_q = (near * (fx * d_x + d_slope_x), near * (fy * d_y + d_slope_y), 0.0)
        depth_gradient = -near * (_dot(d_row_x, row_x) + _dot(d_row_y, row_y) + _dot(q, d_q))
        d = _combine((d_q[0], d_q[1], depth_gradient), world)
        d_mean[i, 0], d_mean[i, 1], d_mean[i, 2] = d
    return d_mean, d_quaternion, d_scale, d_opacity, d_colour, screen


def _view(camera: Camera) -> tuple[float, ...]:
    """The rotation's rows and the translation: a tuple, since rows of an array are counted references."""
    return (*camera.rotation.ravel().tolist(), *camera.translation.tolist())


def _lens(camera: Camera) -> tuple[float, ...]:
    """fx, fy, cx, cy and (SPEC 14.4) the least and largest slopes x/z and y/z of the projection's derivative."""
    beyond_x, beyond_y = BEYOND * camera.width / camera.fx, BEYOND * camera.height / camera.fy
    return (
        float(camera.fx),
        float(camera.fy),
        float(camera.cx),
        float(camera.cy),
        -camera.cx / camera.fx - beyond_x,
        (camera.width - camera.cx) / camera.fx + beyond_x,
        -camera.cy / camera.fy - beyond_y,
        (camera.height - camera.cy) / camera.fy + beyond_y,
    )


def check_camera(camera: Camera) -> None:
    """Raises ValueError for wrong shapes, values that are not finite, focal lengths or sizes that are not positive."""
    for name, shape in (("rotation", (3, 3)), ("translation", (3,))):
        value = getattr(camera, name)
        if value.shape != shape or not np.isfinite(value).all():
            raise ValueError(f"{name}: shape {value.shape}; finite values of shape {shape} are wanted")
    if not all(math.isfinite(v) for v in (camera.fx, camera.fy, camera.cx, camera.cy)) or min(camera.fx, camera.fy) <= 0:
        raise ValueError(
            f"focal lengths {camera.fx}, {camera.fy} and centre {camera.cx}, {camera.cy}: finite and lengths above 0 are wanted"
        )
    if min(camera.width, camera.height) < 1:
        raise ValueError(f"image of {camera.width} x {camera.height}")


# What float32 cannot hold becomes infinite, and is not drawn.
@np.errstate(over="ignore")
def _inputs(*values: ArrayLike) -> tuple[F32, F32, F32, F32, F32]:
    mean, quaternion, scale, opacity, colour = (np.ascontiguousarray(v, dtype=np.float32) for v in values)
    n = len(opacity) if opacity.ndim == 1 else -1
    for name, value, shape in (
        ("mean", mean, (n, 3)),
        ("quaternion", quaternion, (n, 4)),
        ("scale", scale, (n, 3)),
        ("opacity", opacity, (n,)),
        ("colour", colour, (n, 3)),
    ):
        if value.shape != shape:
            raise ValueError(f"{name}: shape {value.shape}, not {shape}; N is the length of opacity, which has one dimension")
    return mean, quaternion, scale, opacity, colour


def rasterise(
    mean: ArrayLike,
    quaternion: ArrayLike,
    scale: ArrayLike,
    opacity: ArrayLike,
    colour: ArrayLike,
    camera: Camera,
    settings: Settings | None = None,
) -> Rendering:
    """Draws N Gaussians: mean f32[N,3], quaternion f32[N,4] (w, x, y, z; any length but 0), scale f32[N,3] (standard deviations, in
    the unit of mean), opacity f32[N], colour f32[N,3]. Other dtypes are cast. Without settings: Settings().

    Raises ValueError for other shapes, for a camera that check_camera refuses, and if there are 2^27 pairs of a Gaussian and a tile it
    may touch. The rendering keeps the inputs for rasterise_backward, uncopied where they are contiguous float32: do not change them
    before.
    """
    check_camera(camera)
    settings = settings or Settings()
    inputs = _inputs(mean, quaternion, scale, opacity, colour)
    width, height = camera.width, camera.height
    record, room, depth, radius = _project(
        *inputs, _view(camera), _lens(camera), width, height, float(settings.low_pass), float(settings.near_plane)
    )
    pairs = int(room.sum(dtype=np.int64))
    if pairs >= PAIRS_MAX:
        raise ValueError(f"{pairs} pairs of Gaussians and tiles; fewer than {PAIRS_MAX} are wanted")
    columns, rows = -(-width // TILE_WIDTH), -(-height // TILE_HEIGHT)
    begin, count, place, tile_begin, members = _list(_sort(depth, room), record, room, columns, rows)
    background = np.array(settings.background, np.float32)
    with parallel_chunksize(1):
        image, transmittance, last = _blend(record, tile_begin, members, width, height, np.float32(settings.alpha_max), background)
    tape = _Tape(inputs, camera, settings, record, begin, count, place, tile_begin, members, last)
    return Rendering(image, transmittance, radius, tape)


def rasterise_backward(rendering: Rendering, grad_image: ArrayLike, grad_transmittance: ArrayLike | None = None) -> Gradients:
    """Gradients of a loss of which grad_image f32[H,W,3] and grad_transmittance f32[H,W] (None: zeros) are the gradients.

    Exact where the image is smooth: not drawing below 1/255, finishing a pixel and the order of depths are taken as they were.
    Raises ValueError for other shapes, and if 2^24 or more Gaussians meet one tile.
    """
    tape, shape = rendering.tape, rendering.transmittance.shape
    grad_image = np.ascontiguousarray(grad_image, dtype=np.float32)
    grad_transmittance = np.zeros(shape, np.float32) if grad_transmittance is None else np.ascontiguousarray(grad_transmittance, np.float32)
    if grad_image.shape != (*shape, 3) or grad_transmittance.shape != shape:
        raise ValueError(f"gradients of shapes {grad_image.shape} and {grad_transmittance.shape} for an image of {shape}")
    crowd = int(np.diff(tape.tile_begin).max())
    if crowd >= LIST_MAX:
        raise ValueError(f"{crowd} Gaussians meet one tile; fewer than {LIST_MAX} are wanted")
    camera, settings = tape.camera, tape.settings
    with parallel_chunksize(1):
        sums = _unblend(
            tape.record,
            tape.tile_begin,
            tape.members,
            tape.last,
            rendering.transmittance,
            np.float32(settings.alpha_max),
            np.array(settings.background, np.float32),
            grad_image,
            grad_transmittance,
        )
    return Gradients(
        *_unproject(
            sums,
            tape.record,
            tape.begin,
            tape.count,
            tape.place,
            *tape.inputs[:4],
            _view(camera),
            _lens(camera),
            camera.width,
            camera.height,
        )
    )


def image(g: Gaussians, camera: Camera, info: RenderInfo) -> F32:
    """SPEC 14.5: what a camera sees, float32 [height, width, 3], 1 for white. Raises ValueError as rasterise does."""
    red, green, blue = info.background
    settings = Settings(info.low_pass, info.near_plane, info.alpha_max, (red / 255, green / 255, blue / 255))
    return rasterise(g.mean, g.quaternion, g.lengths, g.opacity, g.colour, camera, settings).image
