"""PLY files of ordinary 3D Gaussians, as the 3DGS code writes them."""

from __future__ import annotations

import re

import numpy as np

from ..files import ply as files_ply
from ..files.outputs import Kind
from .splats import Splats

# The 3DGS viewers read the count from the third line of the file, so the mark follows that line.
MARK = "refcodec"
PLY = Kind(
    "a PLY file of Gaussians that refcodec wrote",
    re.compile(rb"ply\nformat binary_little_endian 1\.0\nelement vertex [0-9]+\ncomment " + MARK.encode() + rb"\n"),
)


def columns(rest: int) -> dict[str, tuple[str, ...]]:
    """Returns the properties of each array of Splats in a file, in the order of the file.

    rest: number of harmonics besides the first.
    """
    return {
        "mean": ("x", "y", "z"),
        "base": tuple(f"f_dc_{i}" for i in range(3)),
        "rest": tuple(f"f_rest_{i}" for i in range(3 * rest)),
        "opacity": ("opacity",),
        "scale": tuple(f"scale_{i}" for i in range(3)),
        "quaternion": tuple(f"rot_{i}" for i in range(4)),
    }


def ply_bytes(splats: Splats) -> bytes:
    """Returns the file: binary, little endian, float32, with normals of 0 after the means.

    The coefficients f_rest are ordered by channel.
    """
    count = len(splats.mean)
    names: list[str] = []
    parts = []
    for name, properties in columns(splats.rest.shape[1]).items():
        values = getattr(splats, name)
        if name == "rest":
            values = values.transpose(0, 2, 1)
        names += properties
        parts.append(values.reshape(count, len(properties)))
        if name == "mean":
            names += ("nx", "ny", "nz")
            parts.append(np.zeros((count, 3), np.float32))
    table = np.concatenate(parts, axis=1).astype("<f4").view([(name, "<f4") for name in names]).reshape(count)
    return files_ply.ply_bytes(table, MARK)
