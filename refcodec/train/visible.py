"""Which anchors a camera may see: those with a Gaussian that may reach into its image."""

from __future__ import annotations

import math

import numpy as np
import torch
from numba import prange
from numpy.typing import NDArray
from torch import Tensor

from ..render.camera import Camera
from ..render.compiled import compiled

F32 = NDArray[np.float32]

# Bounds of what a camera may see. EXTENT: deviations at which an alpha of one has fallen to 1/255. REACH: a factor, for
# values that rounding moves. EDGE: pixels around an image, for the low-pass filter.
EXTENT, REACH, EDGE = 3.33, 1.05, 4.0

_REACH, _EXTENT = np.float32(REACH), np.float32(EXTENT)


def _sides(camera: Camera) -> list[list[float]]:
    """Of x and of y: skew, half and the factor of a reach, by which an anchor is outside the image's edges.

    A sphere of radius r around (x, y, z) is outside if |x - skew z| - half z is at least the factor times r: then a
    plane through the eye and an edge, some pixels farther out, is between the two.
    """
    found = []
    for size, focal, middle in ((camera.width, camera.fx, camera.cx), (camera.height, camera.fy, camera.cy)):
        half, skew = (size / 2 + EDGE) / focal, (size / 2 - middle) / focal
        found.append([skew, half, math.sqrt(1 + (half + abs(skew)) ** 2)])
    return found


@compiled(parallel=True)
def _inside(
    position: F32, offsets: F32, scalings: F32, length: np.float32, view: F32, near: np.float32, sides: F32
) -> NDArray[np.bool_]:
    """view: [3, 4], of rotation and translation. length: the logarithm of a unit's. sides: [2, 3], of _sides."""
    found = np.empty(position.shape[0], np.bool_)
    for r in prange(position.shape[0]):
        square = np.float32(0)
        for j in range(3):
            most = np.float32(0)
            for at in range(j, offsets.shape[1], 3):
                most = max(most, abs(offsets[r, at]))
            most *= math.exp(scalings[r, j] - length)
            square += most * most
        longest = math.exp(max(scalings[r, 3], scalings[r, 4], scalings[r, 5]) - length)
        reach = _REACH * (math.sqrt(square) + _EXTENT * longest)
        x, y, z = position[r, 0], position[r, 1], position[r, 2]
        depth = view[2, 0] * x + view[2, 1] * y + view[2, 2] * z + view[2, 3]
        inside = depth > near - reach
        for axis in range(2):
            across = view[axis, 0] * x + view[axis, 1] * y + view[axis, 2] * z + view[axis, 3]
            away = abs(across - sides[axis, 0] * depth) - sides[axis, 1] * depth
            inside &= away < reach * sides[axis, 2]
        found[r] = inside
    return found


def visible(position: Tensor, tables: dict[str, Tensor], length: float, camera: Camera, near: float) -> Tensor:
    """The anchors that have a Gaussian which a camera may see: int64 [n], ascending.

    None is left out that could be drawn. An anchor reaches as far as its farthest offset and the longest axes of its
    Gaussians.

    position: float32 [N, 3], in training units, which are the camera's and those of near, where its view begins.
    tables: those of Scaffold. length: of a training unit in the world.
    """
    if position.device.type != "cpu":
        return visible_anywhere(position, tables, length, camera, near)
    arrays = (v.numpy() for v in (position, tables["offsets"], tables["scalings"]))
    view = np.column_stack([camera.rotation, camera.translation]).astype(np.float32)
    sides = np.array(_sides(camera), np.float32)
    found = _inside(*arrays, np.float32(math.log(length)), view, np.float32(near), sides)
    return torch.from_numpy(np.flatnonzero(found))


def visible_anywhere(position: Tensor, tables: dict[str, Tensor], length: float, camera: Camera, near: float) -> Tensor:
    """What `visible` finds, with torch on the device of the tensors."""
    rotation, translation = (
        torch.from_numpy(v.astype(np.float32)).to(position.device) for v in (camera.rotation, camera.translation)
    )
    p = position @ rotation.T + translation
    lengths = torch.exp(tables["scalings"] - math.log(length))
    offsets = tables["offsets"]
    reach = offsets.reshape(len(offsets), -1, 3).abs().amax(dim=1).mul_(lengths[:, :3]).norm(dim=1)
    reach = REACH * (reach + EXTENT * lengths[:, 3:].amax(dim=1))
    depth = p[:, 2]
    inside = depth > near - reach
    for axis, (skew, half, factor) in enumerate(_sides(camera)):
        inside &= (p[:, axis] - skew * depth).abs() - half * depth < reach * factor
    return torch.nonzero(inside)[:, 0]
