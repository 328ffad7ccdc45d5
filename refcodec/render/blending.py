"""Tiles blended front to back, and the gradients back (SPEC.md 14.5)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit, prange

from .constants import BLOCK, BLOCK_HEIGHT, F32, I32, I64, LEAST, SUMS, TILE_HEIGHT, TILE_WIDTH, TRANSMITTANCE_MIN
from .simd import WIDTH, bits, column_sums, exp2, fma, fnma, load, lowest, maximum, minimum, select, splat, store, total
from .tiles import block_at, blocks_reached

# Gaussians of a tile between two looks at what of it is still to be drawn.
LOOK = 16
_STOP = np.float32(TRANSMITTANCE_MIN)
# Exponents below this give alphas far below 1/255, and are raised to it: exp2 wants at least -126.
_FLOOR = np.float32(-32)


@njit(cache=True, parallel=True, error_model="numpy")
def blend_tiles(
    record: F32, tile_begin: I64, members: I32, width: int, height: int, alpha_max: np.float32, background: F32
) -> Any:
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
            at = block_at(x, y)
            state[at], state[at + WIDTH] = x, y
            state[at + 2 * WIDTH], state[at + 3 * WIDTH] = 1 if y < rows and x < columns else -1, -1
    zero, floor = splat(np.float32(0)), splat(_FLOOR)
    cap, least, stop = splat(alpha_max), splat(LEAST), splat(_STOP)
    unfinished = _unfinished(state)
    for k in range(members.shape[0]):
        i = members[k]
        a, b, c, log_opacity = record[i, 4], record[i, 5], record[i, 6], record[i, 7]
        dx, dy = np.float32(x0) - record[i, 0], np.float32(y0) - record[i, 1]
        u0, v0 = record[i, 2] + (a * dx + b * dy), record[i, 3] + c * dy
        blocks = blocks_reached(a, b, c, log_opacity, u0, v0) & unfinished
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
            at = block_at(x, y)
            left = abs(state[at + 2 * WIDTH])
            transmittance[y, x], last[y, x] = left, state[at + 3 * WIDTH]
            for channel in range(3):
                image[y, x, channel] = state[at + (4 + channel) * WIDTH] + left * background[channel]


@njit(cache=True, error_model="numpy")
def _unfinished(state: F32) -> np.uint64:
    """The blocks with a pixel that takes more, as blocks_reached has them."""
    found = np.uint64(0)
    for block in range(TILE_HEIGHT * TILE_WIDTH // WIDTH):
        some = bits(load(state, block * BLOCK + 2 * WIDTH) >= splat(_STOP)) != np.uint64(0)
        found |= np.uint64(some) << np.uint64(block)
    return found


@njit(cache=True, parallel=True, error_model="numpy")
def unblend_tiles(
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
    """Gradient of each pair, f32[P * 9]: see SUMS. A pair that no pixel reached has zeros."""
    sums = np.empty(members.shape[0] * SUMS, np.float32)
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
            sums[tile_begin[t] * SUMS : tile_begin[t + 1] * SUMS],
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
            at = block_at(x, y)
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
    for j in range(end * SUMS, members.shape[0] * SUMS):
        sums[j] = 0
    zero, one, floor, cap, least = (
        splat(np.float32(0)),
        splat(np.float32(1)),
        splat(_FLOOR),
        splat(alpha_max),
        splat(LEAST),
    )
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
        blocks = blocks_reached(a, b, c, log_opacity, u0, v0) & reached
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
        store(sums, k * SUMS, column_sums(s_1, s_u, s_v, s_uu, s_uv, s_vv, s_red, s_green))
        sums[k * SUMS + 8] = total(s_blue)
