"""Plain 3D Gaussians with spherical harmonics: their tensors, and their images."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn.functional import normalize

from ..rendering.camera import Camera
from ..rendering.harmonics import degree_of
from ..rendering.rasterise import Settings
from ..train.splat import draw
from .harmonics import colours

# float32 tensors of N Gaussians, by name, as in 3DGS files:
#   mean [N, 3], world units.
#   base [N, 3] and rest [N, K, 3], coefficients of the harmonics.
#   opacity [N], logits.
#   scale [N, 3], natural logarithms of the lengths in world units.
#   quaternion [N, 4], w, x, y, z, of any length but 0.
Splats = Mapping[str, Tensor]


def tensors(arrays: Mapping[str, NDArray[np.float32]]) -> dict[str, Tensor]:
    """Returns Gaussians as tensors."""
    return {name: torch.from_numpy(np.ascontiguousarray(values)) for name, values in arrays.items()}


def drawn(
    splats: Splats, camera: Camera, settings: Settings, degree: int | None = None, screen: Tensor | None = None
) -> tuple[Tensor, Tensor, Tensor]:
    """Draws Gaussians: returns image [H, W, 3], transmittance [H, W] and radius [N] (refcodec.train.splat.draw).

    degree: the highest degree of harmonics to use, None for all. screen: as for draw.
    """
    mean, base, rest = splats["mean"], splats["base"], splats["rest"]
    highest = degree_of(rest.shape[1]) if degree is None else degree
    colour = colours(base, rest, mean, torch.from_numpy(camera.centre.astype(np.float32)), highest)
    lengths, opacity = splats["scale"].exp(), torch.sigmoid(splats["opacity"])
    return draw(mean, normalize(splats["quaternion"]), lengths, opacity, colour, camera, settings, screen)
