"""Plain 3D Gaussians as files of 3DGS, and their quality on photographs."""

from __future__ import annotations

from pathlib import Path

import torch
from torch import Tensor

from refcodec.convert.drawing import Tensors, drawn, tensors
from refcodec.evaluate.quality import measures
from refcodec.formats.splats import Splats
from refcodec.formats.table import read_splats, write_splats
from refcodec.photographs.photographs import Photograph
from refcodec.rendering.rasterise import Settings


def write_ply(splats: Tensors, path: Path) -> None:
    """Writes a file in the format of 3DGS's own code (refcodec.formats.ply)."""
    path.parent.mkdir(parents=True, exist_ok=True)
    arrays = Splats(**{name: values.detach().numpy() for name, values in splats.items()})
    path.write_bytes(write_splats(arrays, ".ply"))


def read_ply(path: Path) -> dict[str, Tensor]:
    """Returns the Gaussians of a file of write_ply, with properties in any order. Raises ValueError and OSError."""
    return tensors(read_splats(path))


@torch.no_grad()
def quality(splats: Tensors, photographs: tuple[Photograph, ...], settings: Settings) -> dict[str, float]:
    """Returns the mean of refcodec.evaluate.quality.measures over photographs."""
    rows = [measures(drawn(splats, p.camera, settings)[0].numpy(), p.image) for p in photographs]
    return {name: sum(row[name] for row in rows) / len(rows) for name in rows[0]}
