"""Which anchors a camera may see: those with a Gaussian that may reach into its image."""

import math

import numpy as np
import torch
from torch import Tensor

from ..rendering.camera import Camera
from .cpu.visible import visible_rows
from .device import has_kernel

# Bounds of the anchors that a camera may see. EXTENT: deviations at which an alpha of one has fallen to 1/255. REACH: a
# factor, for values that rounding moves. EDGE: pixels around an image, for the low-pass filter.
EXTENT, REACH, EDGE = 3.33, 1.05, 4.0


def _sides(camera: Camera) -> list[list[float]]:
    """For x and for y: skew, half and factor, by which a sphere is outside the edges of the image.

    A sphere of radius r around (x, y, z) is outside if |x - skew z| - half z >= factor r: then a plane through the eye
    and an edge, EDGE pixels farther out, separates the two.
    """
    sides = []
    for size, focal, middle in ((camera.width, camera.fx, camera.cx), (camera.height, camera.fy, camera.cy)):
        half, skew = (size / 2 + EDGE) / focal, (size / 2 - middle) / focal
        sides.append([skew, half, math.sqrt(1 + (half + abs(skew)) ** 2)])
    return sides


def visible_torch(position: Tensor, tables: dict[str, Tensor], length: float, camera: Camera, near: float) -> Tensor:
    """The anchors that have a Gaussian which a camera may see: int64 [n], ascending.

    No anchor that could be drawn is left out. An anchor reaches as far as its farthest offset and the longest axes of
    its Gaussians.

    Args:
        position: float32 [N, 3], in training units, which are those of the camera and of near.
        tables: those of Scaffold: offsets [N, 3 K], scalings [N, 6].
        length: the length of a training unit in the world.
        camera: in training units.
        near: the depth at which the view begins.
    """
    offsets = tables["offsets"]
    assert position.shape == (len(offsets), 3)
    rotation, translation = (
        torch.from_numpy(v.astype(np.float32)).to(position.device) for v in (camera.rotation, camera.translation)
    )
    p = position @ rotation.T + translation
    lengths = torch.exp(tables["scalings"] - math.log(length))
    reach = offsets.reshape(len(offsets), -1, 3).abs().amax(dim=1).mul_(lengths[:, :3]).norm(dim=1)
    reach = REACH * (reach + EXTENT * lengths[:, 3:].amax(dim=1))
    depth = p[:, 2]
    inside = depth > near - reach
    for axis, (skew, half, factor) in enumerate(_sides(camera)):
        inside &= (p[:, axis] - skew * depth).abs() - half * depth < reach * factor
    return torch.nonzero(inside)[:, 0]


def visible(position: Tensor, tables: dict[str, Tensor], length: float, camera: Camera, near: float) -> Tensor:
    """visible_torch, in a kernel on CPUs."""
    if not has_kernel(position):
        return visible_torch(position, tables, length, camera, near)
    arrays = (v.numpy() for v in (position, tables["offsets"], tables["scalings"]))
    view = np.column_stack([camera.rotation, camera.translation]).astype(np.float32)
    sides = np.array(_sides(camera), np.float32)
    bounds = np.float32(REACH), np.float32(EXTENT)
    seen = visible_rows(*arrays, np.float32(math.log(length)), view, np.float32(near), sides, bounds)
    return torch.from_numpy(np.flatnonzero(seen))
