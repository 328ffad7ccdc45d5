"""Blends the Gaussians of each tile front to back, and takes gradients back through it (SPEC.md 14.5)."""

from typing import Any

import numpy as np
from numba import prange

from .compiled import compiled
from .constants import BLOCK, BLOCK_HEIGHT, F32, I32, LEAST, SUMS, TILE_HEIGHT, TILE_WIDTH, TRANSMITTANCE_MIN
from .simd import WIDTH, bits, column_sums, exp2, fma, fnma, load, lowest, maximum, minimum, select, splat, store, total
from .tiles import Pairs, block_at, blocks_reached

# The number of Gaussians of a tile that are drawn before its unfinished blocks are updated.
LOOK = 16
_STOP = np.float32(TRANSMITTANCE_MIN)
# Smaller exponents are raised to this one, because exp2 takes no less than -126. Their alphas are far below 1/255.
_FLOOR = np.float32(-32)


@compiled(inline="always")
def _of_tile(record: F32, i: int, x0: int, y0: int) -> Any:
    """Returns a, b, c and log2(opacity) of Gaussian i, and u and v at the centre of pixel (x0, y0)."""
    a, b, c = record[i, 4], record[i, 5], record[i, 6]
    dx, dy = np.float32(x0) - record[i, 0], np.float32(y0) - record[i, 1]
    return a, b, c, record[i, 7], record[i, 2] + (a * dx + b * dy), record[i, 3] + c * dy


@compiled(parallel=True)
def blend_tiles(record: F32, pairs: Pairs, width: int, height: int, alpha_max: np.float32, background: F32) -> Any:
    """Blends all tiles. Returns image f32[H,W,3], transmittance f32[H,W] and last f32[H,W], as in _Tape.

    record: f32[N,16], as project_gaussians gives it. background: f32[3].
    """
    _, _, _, tile_begin, members = pairs
    image, transmittance = np.empty((height, width, 3), np.float32), np.empty((height, width), np.float32)
    last = np.empty((height, width), np.float32)
    columns = (width + TILE_WIDTH - 1) // TILE_WIDTH
    for t in prange(tile_begin.shape[0] - 1):
        x0, y0 = t % columns * TILE_WIDTH, t // columns * TILE_HEIGHT
        y, x = slice(y0, y0 + TILE_HEIGHT), slice(x0, x0 + TILE_WIDTH)
        own = members[tile_begin[t] : tile_begin[t + 1]]
        _blend_tile(record, own, x0, y0, alpha_max, background, (image[y, x], transmittance[y, x], last[y, x]))
    return image, transmittance, last


@compiled()
def _blend_tile(record: F32, members: I32, x0: int, y0: int, alpha_max: np.float32, background: F32, part: Any) -> None:
    """SPEC 14.5, PIXEL: blends one tile into its part of image, transmittance and last. x0, y0: its first pixel."""
    image, transmittance, last = part
    rows, columns = transmittance.shape
    # The planes of a block are x, y, transmittance, place of the last Gaussian drawn, red, green and blue. A
    # transmittance is negative outside the image.
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
        a, b, c, log_opacity, u0, v0 = _of_tile(record, i, x0, y0)
        blocks = blocks_reached(a, b, c, log_opacity, u0, v0) & unfinished
        while blocks:
            at = lowest(blocks) * BLOCK
            blocks &= blocks - np.uint64(1)
            x, y = load(state, at), load(state, at + WIDTH)
            u, v = fma(splat(a), x, fma(splat(b), y, splat(u0))), fma(splat(c), y, splat(v0))
            raw = exp2(maximum(fnma(u, u, fnma(v, v, splat(log_opacity))), floor))
            # SPEC 14.5, PIXEL. Where the Gaussian is not seen, or the pixel is finished, alpha is 0.
            alpha = minimum(raw, cap)
            before = load(state, at + 2 * WIDTH)
            seen = (alpha >= least) & (before >= stop)
            alpha = select(seen, alpha, zero)
            weight = alpha * before
            store(state, at + 2 * WIDTH, fnma(alpha, before, before))
            # The sum is exact for integers. A choice between the stored value and another would compile to a masked
            # store, which is ten times as slow.
            place = load(state, at + 3 * WIDTH)
            store(state, at + 3 * WIDTH, place + select(seen, splat(np.float32(k)) - place, zero))
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


@compiled()
def _unfinished(state: F32) -> np.uint64:
    """Returns the blocks with a pixel that takes more Gaussians, as bits in the order of blocks_reached."""
    mask = np.uint64(0)
    for block in range(TILE_HEIGHT * TILE_WIDTH // WIDTH):
        some = bits(load(state, block * BLOCK + 2 * WIDTH) >= splat(_STOP)) != np.uint64(0)
        mask |= np.uint64(some) << np.uint64(block)
    return mask


@compiled(parallel=True)
def unblend_tiles(record: F32, pairs: Pairs, drawn: Any, alpha_max: np.float32, background: F32, gradients: Any) -> F32:
    """Returns the gradients of the pairs, f32[P * 9], nine for each pair as SUMS says. They are 0 if no pixel drew it.

    drawn: transmittance and last, f32[H,W] each, as blend_tiles gives them. gradients: of the image, f32[H,W,3], and of
    the transmittance, f32[H,W].
    """
    (_, _, _, tile_begin, members), (transmittance, last), (grad_image, grad_transmittance) = pairs, drawn, gradients
    sums = np.empty(members.shape[0] * SUMS, np.float32)
    columns = (transmittance.shape[1] + TILE_WIDTH - 1) // TILE_WIDTH
    for t in prange(tile_begin.shape[0] - 1):
        x0, y0 = t % columns * TILE_WIDTH, t // columns * TILE_HEIGHT
        y, x = slice(y0, y0 + TILE_HEIGHT), slice(x0, x0 + TILE_WIDTH)
        own = members[tile_begin[t] : tile_begin[t + 1]]
        part, along = (transmittance[y, x], last[y, x]), (grad_image[y, x], grad_transmittance[y, x])
        to = sums[tile_begin[t] * SUMS : tile_begin[t + 1] * SUMS]
        _unblend_tile(record, own, x0, y0, alpha_max, background, part, along, to)
    return sums


@compiled()
def _unblend_tile(
    record: F32,
    members: I32,
    x0: int,
    y0: int,
    alpha_max: np.float32,
    background: F32,
    part: Any,
    along: Any,
    sums: F32,
) -> None:
    """Walks one tile back to front and undoes the blending, to find the gradients of its pairs.

    part, along: the tile's parts of `drawn` and `gradients` of unblend_tiles.

    What lies behind a Gaussian is then summed up from the back. It is no difference of large numbers, and so it is
    accurate where it is small.
    """
    (transmittance, last), (grad_image, grad_transmittance) = part, along
    rows, columns = transmittance.shape
    # The planes of a block are x, y, the transmittance in front of what was undone, the gradient of its logarithm, the
    # place of the last Gaussian drawn, and the gradients of red, green and blue.
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
    zero, one = splat(np.float32(0)), splat(np.float32(1))
    floor, cap, least = splat(_FLOOR), splat(alpha_max), splat(LEAST)
    reached = np.uint64(0)
    for k in range(end - 1, -1, -1):
        if k == end - 1 or k % LOOK == LOOK - 1:
            # The blocks in which this Gaussian was drawn, or one of those before the next look.
            reached = np.uint64(0)
            for row in range(TILE_HEIGHT // BLOCK_HEIGHT):
                some = load(furthest, row * WIDTH) >= splat(np.float32(k - k % LOOK))
                reached |= bits(some) << np.uint64(row * WIDTH)
        i = members[k]
        a, b, c, log_opacity, u0, v0 = _of_tile(record, i, x0, y0)
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
            # The gradient of log(alpha). Alpha adds its colour and dims what lies behind. The cap lets no gradient
            # through.
            g = select(raw <= cap, raw * fnma(behind, inverse, before * along), zero)
            g_u, g_v = g * u, g * v
            s_1, s_u, s_v = s_1 + g, s_u + g_u, s_v + g_v
            s_uu, s_uv, s_vv = fma(g_u, u, s_uu), fma(g_v, u, s_uv), fma(g_v, v, s_vv)
            s_red, s_green, s_blue = fma(weight, red, s_red), fma(weight, green, s_green), fma(weight, blue, s_blue)
        store(sums, k * SUMS, column_sums(s_1, s_u, s_v, s_uu, s_uv, s_vv, s_red, s_green))
        sums[k * SUMS + 8] = total(s_blue)
