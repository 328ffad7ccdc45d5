"""Plain 3D Gaussians as tensors, and their images as differentiable functions of them."""

from collections.abc import Mapping

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import normalize

from ..formats.harmonics import ZERO, degree_of
from ..formats.splats import Splats
from ..rendering.camera import Camera
from ..rendering.rasterise import Settings
from ..train.harmonics import harmonics_torch
from ..train.splat import draw

# float32 tensors by the names of the arrays of Splats, with their shapes.
Tensors = Mapping[str, Tensor]


def tensors(splats: Splats) -> dict[str, Tensor]:
    """Returns Gaussians as tensors."""
    return {name: torch.from_numpy(np.ascontiguousarray(values)) for name, values in vars(splats).items()}


def colours(base: Tensor, rest: Tensor, mean: Tensor, centre: Tensor, degree: int) -> Tensor:
    """SPEC 14.6: returns the colours [N, 3], at least 0, of Gaussians at `mean` [N, 3] for a camera at `centre` [3].

    base: coefficients of degree 0, [N, 3]. rest: those of the other harmonics, [N, K, 3]. degree: the highest
    degree to use, at most that of rest.
    """
    total = ZERO * base + 0.5
    if degree:
        basis = harmonics_torch(mean - centre, (degree + 1) ** 2)[:, 1:]
        total = total + (basis[:, :, None] * rest[:, : basis.shape[1]]).sum(dim=1)
    return total.clamp_min(0)


def drawn(
    splats: Tensors, camera: Camera, settings: Settings, degree: int | None = None, screen: Tensor | None = None
) -> tuple[Tensor, Tensor, Tensor]:
    """Draws Gaussians: returns image [H, W, 3], transmittance [H, W] and radius [N] (refcodec.train.splat.draw).

    degree: the highest degree of harmonics to use, None for all. screen: as for draw.
    """
    mean, base, rest = splats["mean"], splats["base"], splats["rest"]
    highest = degree_of(rest.shape[1]) if degree is None else degree
    colour = colours(base, rest, mean, torch.from_numpy(camera.centre.astype(np.float32)), highest)
    lengths, opacity = splats["scale"].exp(), torch.sigmoid(splats["opacity"])
    return draw((mean, normalize(splats["quaternion"]), lengths, opacity, colour), camera, settings, screen)
