"""Plain 3D Gaussians with spherical harmonics: their tensors, their PLY files, and what a camera sees of them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import torch
from plyfile import PlyData
from torch import Tensor
from torch.nn.functional import normalize

from refcodec.evaluate.quality import measures
from refcodec.export.harmonics import degree_of
from refcodec.export.ply import columns, ply_bytes
from refcodec.export.splats import Splats as Exported
from refcodec.photographs.photographs import Photograph
from refcodec.render.camera import Camera
from refcodec.render.rasterise import Settings
from refcodec.train.splat import draw

from .harmonics import colours

# float32 tensors of N Gaussians, by name, as 3DGS's files have them:
#   mean [N, 3], world units.
#   base [N, 3] and rest [N, K, 3], coefficients of the harmonics.
#   opacity [N], logits.
#   scale [N, 3], natural logarithms of the lengths in world units.
#   quaternion [N, 4], w, x, y, z, of any length but 0.
Splats = Mapping[str, Tensor]


def write_ply(splats: Splats, path: Path) -> None:
    """Writes the file that 3DGS's own code writes (refcodec.export.ply)."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(ply_bytes(Exported(**{name: values.detach().numpy() for name, values in splats.items()})))


def read_ply(path: Path) -> dict[str, Tensor]:
    """The Gaussians of a file as write_ply writes it, its properties in any order. Raises ValueError and OSError."""
    try:
        table = PlyData.read(str(path))["vertex"].data
    except OSError:
        raise
    # plyfile answers bad bytes with many types.
    except Exception as error:
        raise ValueError(f"{path}: it is not a readable PLY file ({error})") from None
    names = table.dtype.names
    extra = sum(name.startswith("f_rest_") for name in names)
    if extra % 3:
        raise ValueError(f"{path}: {extra} coefficients f_rest, which are not three channels")
    degree_of(extra // 3)
    found = {}
    for name, properties in columns(extra // 3).items():
        missing = [p for p in properties if p not in names]
        if missing:
            raise ValueError(f"{path}: there is no property {missing[0]}, as files of 3DGS have")
        values = np.empty((len(table), len(properties)), np.float32)
        for column, own in enumerate(properties):
            values[:, column] = table[own]
        found[name] = torch.from_numpy(values)
    found["opacity"] = found["opacity"][:, 0]
    found["rest"] = found["rest"].reshape(len(table), 3, -1).transpose(1, 2).contiguous()
    return found


def drawn(
    splats: Splats, camera: Camera, settings: Settings, degree: int | None = None, screen: Tensor | None = None
) -> tuple[Tensor, Tensor, Tensor]:
    """What a camera sees: image [H, W, 3], transmittance [H, W] and radius [N] (refcodec.train.splat.draw).

    degree: the highest harmonics that are used, None for all. screen: as draw has it.
    """
    mean, base, rest = splats["mean"], splats["base"], splats["rest"]
    highest = degree_of(rest.shape[1]) if degree is None else degree
    colour = colours(base, rest, mean, torch.from_numpy(camera.centre.astype(np.float32)), highest)
    lengths, opacity = splats["scale"].exp(), torch.sigmoid(splats["opacity"])
    return draw(mean, normalize(splats["quaternion"]), lengths, opacity, colour, camera, settings, screen)


@torch.no_grad()
def quality(splats: Splats, photographs: tuple[Photograph, ...], settings: Settings) -> dict[str, float]:
    """The mean of refcodec.evaluate.quality.measures over photographs."""
    rows = [measures(drawn(splats, p.camera, settings)[0].numpy(), p.image) for p in photographs]
    return {name: sum(row[name] for row in rows) / len(rows) for name in rows[0]}
