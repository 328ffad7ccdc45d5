"""Photographs and images of results on the device of a training run."""

from copy import copy
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from ..bitstream.dimensions import STATIC
from ..bitstream.reconstruction import reconstruct
from ..bitstream.scene import Scene
from ..photographs.photographs import Photograph, PhotographSet
from ..rendering.camera import Camera
from ..rendering.gaussians import gaussians_of
from ..rendering.rasterise import Settings
from .scaffold import Scaffold
from .splat import draw


def pixels(photograph: Photograph, device: torch.device | str = "cpu") -> Tensor:
    """A photograph on a device, float32 [H, W, 3], 1 for white; with a mask [H, W, 4]: 1, or 0 0 0 0 if excluded."""
    image, mask = photograph.image.astype(np.float32) / 255, photograph.mask
    if mask is not None:
        image = np.concatenate([image, np.ones_like(image[..., :1])], axis=2) * mask[..., None]
    return torch.from_numpy(image).to(device)


def behind(photographs: PhotographSet, drawing: Settings, random: torch.Generator) -> Settings:
    """The settings by which a step draws: behind opaque photographs with a random background.

    What shines through a scene is wrong in all viewers but those with the background of the training.
    """
    if not photographs.opaque:
        return drawing
    red, green, blue = torch.rand(3, generator=random).tolist()
    return replace(drawing, background=(red, green, blue))


@torch.no_grad()
def show(scaffold: Scaffold, drawing: Settings, scene: Scene, camera: Camera) -> Tensor:
    """The image of a result by a camera of the world, drawn as in training: float32 [H, W, 3].

    The networks, units and rasteriser are the training's own, and no anchor is left out. The Gaussians of a static
    scene are the decoder's (SPEC 14.6). drawing: Run.drawing.
    """
    units, device = scaffold.units, scaffold.device
    if scene.render.render_model == STATIC:
        g = gaussians_of(scene, camera)
        moved = (g.mean - units.origin) / units.length, g.quaternion, g.lengths / units.length, g.opacity, g.colour
        mean, quaternion, lengths, opacity, rgb = (torch.from_numpy(v.astype(np.float32)).to(device) for v in moved)
        return draw((mean, quaternion, lengths, opacity, rgb), units.camera(camera), drawing)[0].clamp(0, 1)
    held = copy(scaffold)
    held.lattice = scene.positions.astype(np.int64)
    held.place()
    decoded = reconstruct(scene)
    attributes = {
        "features": decoded.features,
        "scalings": decoded.scalings,
        "offsets": decoded.offsets.reshape(scene.anchor_count, -1),
    }
    values = {name: torch.from_numpy(value).to(device) for name, value in attributes.items()}
    camera, rows = units.camera(camera), torch.arange(scene.anchor_count, device=device)
    _, gaussians, _ = held.gaussians(rows, camera, values, torch.from_numpy(scene.masks).float().to(device))
    return draw(gaussians, camera, drawing)[0].clamp(0, 1)
