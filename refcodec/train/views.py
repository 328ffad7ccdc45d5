"""The photographs of a training, and images of what it has learnt, on its device."""

from __future__ import annotations

from collections.abc import Iterable
from copy import copy

import numpy as np
import torch
from torch import Tensor

from ..bitstream.reconstruction import reconstruct
from ..bitstream.scene import Scene
from ..photographs.photographs import Photograph, PhotographSet
from ..render.camera import Camera
from ..render.rasterise import Settings
from .part import Part, Sight
from .scaffold import Gaussians, Scaffold
from .splat import draw


def pixels(photograph: Photograph) -> Tensor:
    """A photograph as float32 [H, W, 3], 1 for white."""
    return torch.from_numpy(photograph.image.astype(np.float32) / 255)


class Views:
    """Draws for a training. cameras: of the photographs to learn from, in training units."""

    def __init__(self, photographs: PhotographSet, scaffold: Scaffold, parts: Iterable[Part], device: str) -> None:
        """parts: what changes an image on the way; the training adds to them later."""
        self.photographs, self.scaffold, self.parts, self.device = photographs, scaffold, parts, device
        self.cameras = [scaffold.units.camera(p.camera) for p in photographs.train]
        red, green, blue = photographs.background
        self.settings = Settings(near_plane=scaffold.near, background=(red / 255, green / 255, blue / 255))
        self._images: dict[int, Tensor] = {}

    def image(self, number: int) -> Tensor:
        """A photograph to learn from, float32 [H, W, 3]."""
        if number not in self._images:
            self._images[number] = pixels(self.photographs.train[number])
        return self._images[number]

    def drawn(self, gaussians: Gaussians, camera: Camera, screen: Tensor | None) -> Tensor:
        """The image of some Gaussians, drawn on the training's device: float32 [H, W, 3] on the CPU.

        camera: in training units. screen: splat.draw's, on the CPU.
        """
        mean, quaternion, lengths, opacity, colour = (g.to(self.device) for g in gaussians)
        moved = None if screen is None else screen.to(self.device)
        return draw(mean, quaternion, lengths, opacity, colour, camera, self.settings, moved)[0].cpu()

    @torch.no_grad()
    def draw(self, camera: Camera) -> Tensor:
        """What a camera of the world sees of the training as it is: float32 [H, W, 3]. It is rounded if training is."""
        camera = self.scaffold.units.camera(camera)
        rows = self.scaffold.visible(camera)
        sight = Sight(camera, rows, {name: table[rows] for name, table in self.scaffold.tables.items()})
        for part in self.parts:
            part.show(sight)
        _, gaussians, _ = self.scaffold.gaussians(rows, camera, sight.values, sight.masks)
        return self.drawn(gaussians, camera, None).clamp(0, 1)

    @torch.no_grad()
    def show(self, scene: Scene, camera: Camera) -> Tensor:
        """What a camera of the world sees of the result, drawn as training draws: float32 [H, W, 3].

        The networks, units and rasteriser are the training's own, and no anchor is left out.
        """
        held = copy(self.scaffold)
        held.lattice = scene.positions.astype(np.int64)
        held.place()
        found = reconstruct(scene)
        values = {"features": torch.from_numpy(found.features), "scalings": torch.from_numpy(found.scalings)}
        values["offsets"] = torch.from_numpy(found.offsets.reshape(scene.anchor_count, -1))
        camera, rows = held.units.camera(camera), torch.arange(scene.anchor_count)
        _, gaussians, _ = held.gaussians(rows, camera, values, torch.from_numpy(scene.masks).float())
        return self.drawn(gaussians, camera, None).clamp(0, 1)
