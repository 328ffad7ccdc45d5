"""The numbers that files store for Gaussians: opacities, bytes, the smaller components of quaternions, orders."""

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .splats import F32, F64, Splats

I64 = NDArray[np.int64]
U8 = NDArray[np.uint8]
# Opacities from this to 1 minus this have finite logits in float32.
OPACITY_LEAST = 1e-6
# The same for an opacity that was read as a byte: 0 and 255 are half a step from the next.
BYTE_OPACITY_LEAST = 0.25 / 255
# Points are far out beyond so many times the distance within which this share of all is.
FAR, SHARE = 10, 0.95


def opacities(splats: Splats) -> F64:
    """Returns the opacities, from 0 to 1, [n]."""
    return logistic(splats.opacity.astype(np.float64))


def logistic(x: NDArray[Any]) -> NDArray[Any]:
    """Returns 1 / (1 + exp(-x))."""
    # Beyond 700, the exponential overflows, and an opacity is 0 in float32.
    y: NDArray[Any] = 1 / (1 + np.exp(np.minimum(-x, 700)))
    return y


def logits(opacity: F64, least: float = OPACITY_LEAST) -> F64:
    """Returns the logits of opacities, all finite: those below `least` count as `least`, and those near 1 likewise."""
    within = np.clip(opacity, least, 1 - least)
    return np.log(within / (1 - within))


def nearest_bytes(values: NDArray[Any]) -> U8:
    """Returns the nearest integers from 0 to 255."""
    return np.clip(np.floor(values + 0.5), 0, 255).astype(np.uint8)


def smaller_components(unit: F64) -> tuple[I64, F64]:
    """Returns the index of the largest component of unit quaternions, and the other three, [n, 3], in their order.

    The signs are those of the equal rotation whose largest component is positive.
    """
    largest = np.argmax(np.abs(unit), axis=1)
    turned = unit * np.where(np.take_along_axis(unit, largest[:, None], axis=1) < 0, -1, 1)
    return largest, turned[np.arange(4) != largest[:, None]].reshape(-1, 3)


def with_largest(largest: I64, others: F64) -> F64:
    """Returns the unit quaternions, [n, 4], from the results of smaller_components."""
    out = np.empty((len(others), 4))
    out[np.arange(4) != largest[:, None]] = others.reshape(-1)
    out[np.arange(len(out)), largest] = np.sqrt(np.maximum(1 - (others**2).sum(axis=1), 0))
    return out


def bulk(mean: F32) -> NDArray[np.bool_]:
    """Returns whether points, [n, 3], are at most FAR times as far from their median as SHARE of them, bool [n].

    The others, such as a sky, must not set the ranges and steps of all.
    """
    away = np.abs(mean.astype(np.float64) - np.median(mean, axis=0)).max(axis=1)
    reach = np.quantile(away, SHARE)
    return (away <= FAR * reach) | (reach == 0)


def along_curve(mean: F32) -> I64:
    """Returns an order of points, [n, 3], along a Z-order curve of 16 bits for each axis, those far out at the end.

    Formats that code neighbours together become smaller or more accurate by it.
    """
    near = bulk(mean)
    low, high = (end(mean[near], axis=0).astype(np.float64) for end in (np.min, np.max))
    grid = ((mean - low) / np.maximum(high - low, 1e-300) * 65535).clip(0, 65535).astype(np.uint64)
    code = np.zeros(len(mean), np.uint64)
    for bit in range(16):
        for axis in range(3):
            code |= (grid[:, axis] >> np.uint64(bit) & np.uint64(1)) << np.uint64(3 * bit + axis)
    return np.lexsort((code, ~near))


def drawn_in(splats: Splats, most: float) -> Splats:
    """Returns Gaussians without coordinates beyond `most`.

    Farther ones come nearer to the world's origin, and become as much smaller: from there, they look the same.
    """
    most = max(most, float(np.finfo(np.float32).tiny))
    nearer = most / np.maximum(np.abs(splats.mean).max(axis=1, keepdims=True), most)
    scale = splats.scale + np.log(nearer)
    return replace(splats, mean=splats.mean * nearer, scale=scale) if (nearer < 1).any() else splats
