"""Plain 3D Gaussians as files of 3DGS, and how well they show photographs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from plyfile import PlyData, PlyElement
from torch import Tensor

from refcodec.convert.splat_files import read_splats
from refcodec.convert.splat_ply import columns
from refcodec.convert.splats import Splats, drawn, tensors
from refcodec.evaluate.quality import measures
from refcodec.photographs.photographs import Photograph
from refcodec.render.rasterise import Settings

_NORMALS = ("nx", "ny", "nz")


def write_ply(splats: Splats, path: Path) -> None:
    """Writes the file that 3DGS's own code writes: binary, little endian, float32, with normals of 0.

    The coefficients f_rest have one channel after the other.
    """
    count, rest = len(splats["mean"]), splats["rest"].shape[1]
    found: dict[str, NDArray[np.float32]] = {}
    for name, properties in columns(rest).items():
        values = splats[name].detach()
        if name == "rest":
            values = values.transpose(1, 2)
        found |= zip(properties, values.reshape(count, len(properties)).numpy().T, strict=True)
        if name == "mean":
            found |= {normal: np.zeros(count, np.float32) for normal in _NORMALS}
    table = np.empty(count, [(name, "<f4") for name in found])
    for name, column in found.items():
        table[name] = column
    path.parent.mkdir(parents=True, exist_ok=True)
    PlyData([PlyElement.describe(table, "vertex")], byte_order="<").write(str(path))


def read_ply(path: Path) -> dict[str, Tensor]:
    """The Gaussians of a file as write_ply writes it, its properties in any order. Raises ValueError and OSError."""
    return tensors(read_splats(path))


@torch.no_grad()
def quality(splats: Splats, photographs: tuple[Photograph, ...], settings: Settings) -> dict[str, float]:
    """The mean of refcodec.evaluate.quality.measures over photographs."""
    rows = [measures(drawn(splats, p.camera, settings)[0].numpy(), p.image) for p in photographs]
    return {name: sum(row[name] for row in rows) / len(rows) for name in rows[0]}
