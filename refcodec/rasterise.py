"""Images of Gaussians on the CPU (SPEC.md 14.4 and 14.5), with numba; results do not depend on the number of threads."""

from __future__ import annotations

import math

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from .rendering import Camera, Gaussians, rotation_matrix
from .scene import RenderInfo

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]

# SPEC 14.5: alphas below it count as 0; where less than the other would be left, a pixel is full.
ALPHA_MIN = 1 / 255
LEFT_MIN = 1e-4
# SPEC 14.4: how far beyond the image, in its size, the projection's derivative is taken.
BEYOND = 0.15
# Pixels along a side of a tile: a matter of speed alone.
TILE = 16


# A file may hold any finite numbers; what overflows is not drawn.
@np.errstate(over="ignore", invalid="ignore")
def project(g: Gaussians, camera: Camera, near_plane: float, low_pass: float) -> tuple[F64, F64, NDArray[np.bool_]]:
    """SPEC 14.4, PROJECT. Returns float64 [n, 6]: u, v and the inverse covariance a, b, c in pixels, and the depth; float64 [n, 2]:
    how far from (u, v) along the axes alpha reaches ALPHA_MIN; and which Gaussians are drawn at all."""
    p = g.mean.astype(np.float64) @ camera.rotation.T + camera.translation
    depth = p[:, 2]
    seen = depth > near_plane
    z = np.where(seen, depth, 1.0)
    slope = p[:, :2] / z[:, None]
    focal, centre = np.array([camera.fx, camera.fy]), np.array([camera.cx, camera.cy])
    size = np.array([camera.width, camera.height])
    beyond = BEYOND * size / focal
    limited = np.clip(slope, -centre / focal - beyond, (size - centre) / focal + beyond)
    derivative = np.zeros((len(p), 2, 3))
    derivative[:, 0, 0], derivative[:, 1, 1] = camera.fx / z, camera.fy / z
    derivative[:, :, 2] = -focal * limited / z[:, None]
    half = derivative @ camera.rotation @ (rotation_matrix(g.quaternion) * g.lengths[:, None, :].astype(np.float64))
    covariance = half @ half.transpose(0, 2, 1)
    a, b, c = covariance[:, 0, 0] + low_pass, covariance[:, 0, 1], covariance[:, 1, 1] + low_pass
    d = a * c - b * b
    # A determinant that rounding took away is one of a needle that no pixel's centre meets.
    seen &= d > 0
    d = np.where(seen, d, 1.0)
    flat = np.stack([*(focal * slope + centre).T, c / d, -b / d, a / d, depth], axis=1)
    reach = 2 * np.log(np.maximum(g.opacity.astype(np.float64) / ALPHA_MIN, 1e-300))
    seen &= (reach >= 0) & np.isfinite(flat).all(axis=1)
    extent = np.sqrt(np.maximum(reach, 0)[:, None] * np.stack([a, c], axis=1))
    return flat, extent, seen


@njit(cache=True)
def _bin(flat: F64, extent: F64, across: int, down: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The Gaussians that may touch each tile, in the order given: starts int64 [tiles + 1], indices."""
    boxes = np.empty((len(flat), 4), np.int64)
    starts = np.zeros(across * down + 1, np.int64)
    for i in range(len(flat)):
        u, v = flat[i, 0], flat[i, 1]
        # Pixels' centres are at halves, so half a pixel more is more than enough.
        boxes[i, 0] = max(0, min(across, math.floor((u - extent[i, 0] - 0.5) / TILE)))
        boxes[i, 1] = max(0, min(across, math.floor((u + extent[i, 0] + 0.5) / TILE) + 1))
        boxes[i, 2] = max(0, min(down, math.floor((v - extent[i, 1] - 0.5) / TILE)))
        boxes[i, 3] = max(0, min(down, math.floor((v + extent[i, 1] + 0.5) / TILE) + 1))
        for y in range(boxes[i, 2], boxes[i, 3]):
            for x in range(boxes[i, 0], boxes[i, 1]):
                starts[y * across + x + 1] += 1
    starts = np.cumsum(starts)
    at = starts[:-1].copy()
    found = np.empty(starts[-1], np.int64)
    for i in range(len(flat)):
        for y in range(boxes[i, 2], boxes[i, 3]):
            for x in range(boxes[i, 0], boxes[i, 1]):
                tile = y * across + x
                found[at[tile]] = i
                at[tile] += 1
    return starts, found


@njit(cache=True, parallel=True)
def _blend(flat: F64, opacity: F64, colour: F64, starts: NDArray[np.int64], found: NDArray[np.int64], image: F32, alpha_max: float) -> None:
    """SPEC 14.5, PIXEL, for all pixels; image [h, w, 3] holds the background."""
    height, width = image.shape[:2]
    # Where a Gaussian is certainly below ALPHA_MIN, its exponential is not computed.
    least = np.log(ALPHA_MIN / opacity) - 1e-6
    across = (width + TILE - 1) // TILE
    for tile in prange(len(starts) - 1):
        top, left_edge = tile // across * TILE, tile % across * TILE
        for row in range(top, min(top + TILE, height)):
            for column in range(left_edge, min(left_edge + TILE, width)):
                left = 1.0
                red = green = blue = 0.0
                for n in range(starts[tile], starts[tile + 1]):
                    i = found[n]
                    dx, dy = column + 0.5 - flat[i, 0], row + 0.5 - flat[i, 1]
                    power = -0.5 * (flat[i, 2] * dx * dx + 2 * flat[i, 3] * dx * dy + flat[i, 4] * dy * dy)
                    if power < least[i]:
                        continue
                    alpha = min(opacity[i] * math.exp(power), alpha_max)
                    if alpha < ALPHA_MIN:
                        continue
                    if left * (1 - alpha) < LEFT_MIN:
                        break
                    weight = left * alpha
                    red += weight * colour[i, 0]
                    green += weight * colour[i, 1]
                    blue += weight * colour[i, 2]
                    left *= 1 - alpha
                image[row, column, 0] = red + left * image[row, column, 0]
                image[row, column, 1] = green + left * image[row, column, 1]
                image[row, column, 2] = blue + left * image[row, column, 2]


def image(g: Gaussians, camera: Camera, info: RenderInfo) -> F32:
    """SPEC 14.5: what a camera sees, float32 [height, width, 3], 1 for white."""
    flat, extent, seen = project(g, camera, info.near_plane, info.low_pass)
    # Equal depths keep the order of anchors and offsets.
    order = np.flatnonzero(seen)[np.argsort(flat[seen, 5], kind="stable")]
    made = np.empty((camera.height, camera.width, 3), np.float32)
    made[:] = np.array(info.background, np.float32) / 255
    tiles = -(-camera.width // TILE), -(-camera.height // TILE)
    starts, found = _bin(flat[order], extent[order], *tiles)
    _blend(flat[order], g.opacity[order].astype(np.float64), g.colour[order].astype(np.float64), starts, found, made, float(info.alpha_max))
    return made
