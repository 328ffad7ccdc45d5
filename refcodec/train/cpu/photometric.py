"""The image loss, (1 - s) L1 + s (1 - SSIM), with its gradient: the kernel of losses.photometric_torch.

SSIM takes one pass each way over eight values at a time. Its bits do not depend on the number of threads.
"""

from typing import Any

import numpy as np
import torch
from numba import prange
from numpy.typing import NDArray
from torch import Tensor

from ...rendering.compiled import compiled
from ...rendering.simd import WIDTH, fma, fnma, load, splat, store, total
from ..ssim import C1 as _C1
from ..ssim import C2 as _C2
from ..ssim import RADIUS, TAPS, WINDOW

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]

C1, C2 = np.float32(_C1), np.float32(_C2)
# Rows that a thread takes at once.
BAND = 8


@compiled(inline="always")
def _across(row: F32, begin: int, at: int, channels: int, window: F32) -> Any:
    """The window's mean along the row of a buffer that begins at `begin`, for eight values from `at`."""
    mean = splat(np.float32(0))
    for k in range(TAPS):
        mean = fma(splat(window[k]), load(row, begin + at + k * channels), mean)
    return mean


@compiled(parallel=True)
def _forward(buffers: F32, window: F32, height: int, values: int, channels: int) -> F64:
    """Sum of SSIM over each row, f64[height]; writes the derivatives."""
    size = buffers.shape[2]
    sums = np.empty(height, np.float64)
    flat_x, flat_y = buffers[0].reshape(-1), buffers[1].reshape(-1)
    flat_mean, flat_square, flat_product = buffers[2].reshape(-1), buffers[3].reshape(-1), buffers[4].reshape(-1)
    # A row's means down the columns, between zeros.
    room = size + (TAPS - 1) * channels
    for band in prange((height + BAND - 1) // BAND):
        rows, similar = np.zeros(5 * room, np.float32), np.empty(size, np.float32)
        one, two, c1, c2 = splat(np.float32(1)), splat(np.float32(2)), splat(C1), splat(C2)
        zero = splat(np.float32(0))
        for line in range(band * BAND, min(band * BAND + BAND, height)):
            for at in range(0, size, WIDTH):
                m_x, m_y, m_xx, m_yy, m_xy = zero, zero, zero, zero, zero
                for k in range(TAPS):
                    weight = splat(window[k])
                    value_x, value_y = load(flat_x, (line + k) * size + at), load(flat_y, (line + k) * size + at)
                    weighted_x, weighted_y = weight * value_x, weight * value_y
                    m_x, m_y = m_x + weighted_x, m_y + weighted_y
                    m_xx, m_yy = fma(weighted_x, value_x, m_xx), fma(weighted_y, value_y, m_yy)
                    m_xy = fma(weighted_x, value_y, m_xy)
                to = RADIUS * channels + at
                store(rows, to, m_x)
                store(rows, room + to, m_y)
                store(rows, 2 * room + to, m_xx)
                store(rows, 3 * room + to, m_yy)
                store(rows, 4 * room + to, m_xy)
            summed = zero
            for at in range(0, size, WIDTH):
                m_x, m_y = _across(rows, 0, at, channels, window), _across(rows, room, at, channels, window)
                m_xx, m_yy = (
                    _across(rows, 2 * room, at, channels, window),
                    _across(rows, 3 * room, at, channels, window),
                )
                m_xy = _across(rows, 4 * room, at, channels, window)
                # a b / (c d): luminance a / c, contrast and structure b / d.
                a, b = fma(two * m_x, m_y, c1), fma(two, fnma(m_x, m_y, m_xy), c2)
                c = fma(m_x, m_x, fma(m_y, m_y, c1))
                d = fnma(m_x, m_x, m_xx) + fnma(m_y, m_y, m_yy) + c2
                by_c, by_d = one / c, one / d
                by_both = by_c * by_d
                s = a * b * by_both
                # The mean of x is also in the variance of x and the covariance.
                to = (line + RADIUS) * size + at
                store(flat_mean, to, two * fma(m_y * (b - a), by_both, m_x * s * (by_d - by_c)))
                store(flat_square, to, zero - s * by_d)
                store(flat_product, to, two * a * by_both)
                store(similar, at, s)
                if at + WIDTH <= values:
                    summed = summed + s
            # Values beyond the end of the row are not pixels, and must not affect pixels.
            rest = np.float64(total(summed))
            for at in range(values // WIDTH * WIDTH, values):
                rest += similar[at]
            sums[line] = rest
            for at in range((line + RADIUS) * size + values, (line + RADIUS + 1) * size):
                flat_mean[at], flat_square[at], flat_product[at] = 0, 0, 0
    return sums


@compiled(parallel=True)
def _backward(buffers: F32, window: F32, height: int, channels: int, factor: np.float32) -> F32:
    """factor times the gradient of the sum of SSIM with respect to x: f32[height, row]."""
    size = buffers.shape[2]
    gradient = np.empty((height, size), np.float32)
    flat_x, flat_y, flat = buffers[0].reshape(-1), buffers[1].reshape(-1), gradient.reshape(-1)
    flat_mean, flat_square, flat_product = buffers[2].reshape(-1), buffers[3].reshape(-1), buffers[4].reshape(-1)
    room = size + (TAPS - 1) * channels
    for band in prange((height + BAND - 1) // BAND):
        rows = np.zeros(3 * room, np.float32)
        zero, two, scale = splat(np.float32(0)), splat(np.float32(2)), splat(factor)
        for line in range(band * BAND, min(band * BAND + BAND, height)):
            for at in range(0, size, WIDTH):
                mean, square, product = zero, zero, zero
                for k in range(TAPS):
                    weight, place = splat(window[k]), (line + k) * size + at
                    mean = fma(weight, load(flat_mean, place), mean)
                    square = fma(weight, load(flat_square, place), square)
                    product = fma(weight, load(flat_product, place), product)
                to = RADIUS * channels + at
                store(rows, to, mean)
                store(rows, room + to, square)
                store(rows, 2 * room + to, product)
            for at in range(0, size, WIDTH):
                mean, square = _across(rows, 0, at, channels, window), _across(rows, room, at, channels, window)
                product = _across(rows, 2 * room, at, channels, window)
                place = (line + RADIUS) * size + at
                along = fma(two * load(flat_x, place), square, fma(load(flat_y, place), product, mean))
                store(flat, line * size + at, scale * along)
    return gradient


class Photometric(torch.autograd.Function):
    """Photometric.apply(image, photograph, ssim) -> loss, a scalar: (1 - ssim) L1 + ssim (1 - SSIM).

    Both images are float32 [H, W, 3] on the CPU. Only the first has a gradient. Raises ValueError for shapes that
    differ, or without a pixel.
    """

    @staticmethod
    def forward(ctx: Any, image: Tensor, photograph: Tensor, ssim: float) -> Tensor:
        if image.shape != photograph.shape or image.ndim != 3 or image.numel() == 0:
            shapes = f"{tuple(image.shape)} and {tuple(photograph.shape)}"
            raise ValueError(f"the images have the shapes {shapes}, but must have the same [H,W,C]")
        height, width, channels = image.shape
        values = width * channels
        # Rows of values between zeros: both images x and y, and the derivatives of the sum of SSIM with respect to the
        # window's means of x, x^2 and xy.
        buffers = np.zeros((5, height + 2 * RADIUS, -(-values // WIDTH) * WIDTH), np.float32)
        buffers[:2, RADIUS:-RADIUS, :values] = torch.stack([image, photograph]).reshape(2, height, values).numpy()
        similar = float(_forward(buffers, WINDOW, height, values, channels).sum() / image.numel())
        away = image - photograph
        ctx.save_for_backward(away)
        ctx.buffers, ctx.ssim = buffers, ssim
        return (1 - ssim) * away.abs().mean() + ssim * (1 - similar)

    @staticmethod
    def backward(ctx: Any, *upstream: Tensor) -> tuple[Tensor, None, None]:
        (away,) = ctx.saved_tensors
        height, width, channels = away.shape
        gradient = torch.sign(away).mul_((1 - ctx.ssim) / away.numel())
        similar = _backward(ctx.buffers, WINDOW, height, channels, np.float32(ctx.ssim / away.numel()))
        gradient -= torch.from_numpy(similar)[:, : width * channels].reshape(away.shape)
        return gradient * upstream[0], None, None
