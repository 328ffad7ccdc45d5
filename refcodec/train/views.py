"""The photographs of training, and images of the learned scene, on its device."""

from __future__ import annotations

from collections.abc import Iterable
from copy import copy

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
from .scaffold import Gaussians, Scaffold
from .splat import draw
from .stage import Sight, Stage


def pixels(photograph: Photograph, device: torch.device | str = "cpu") -> Tensor:
    """A photograph as float32 [H, W, 3] on a device, 1 for white."""
    return torch.from_numpy(photograph.image.astype(np.float32) / 255).to(device)


class Views:
    """Draws images in training. cameras: those of the photographs to learn from, in training units."""

    photographs: PhotographSet
    scaffold: Scaffold
    stages: Iterable[Stage]
    cameras: list[Camera]
    settings: Settings

    def __init__(self, photographs: PhotographSet, scaffold: Scaffold, stages: Iterable[Stage]) -> None:
        """stages: those that change the values to draw; the training adds to them later."""
        self.photographs, self.scaffold, self.stages = photographs, scaffold, stages
        self.cameras = [scaffold.units.camera(p.camera) for p in photographs.train]
        red, green, blue = photographs.background
        self.settings = Settings(scaffold.low_pass, scaffold.near, background=(red / 255, green / 255, blue / 255))
        self._images: dict[int, Tensor] = {}

    def image(self, number: int) -> Tensor:
        """A photograph to learn from, float32 [H, W, 3]."""
        if number not in self._images:
            self._images[number] = self.pixels(self.photographs.train[number])
        return self._images[number]

    def pixels(self, photograph: Photograph) -> Tensor:
        """A photograph on the training's device, float32 [H, W, 3], 1 for white."""
        return pixels(photograph, self.scaffold.device)

    def drawn(self, gaussians: Gaussians, camera: Camera, screen: Tensor | None) -> Tensor:
        """The image of some Gaussians: float32 [H, W, 3].

        camera: in training units. screen: splat.draw's.
        """
        return draw(*gaussians, camera, self.settings, screen)[0]

    @torch.no_grad()
    def draw(self, camera: Camera) -> Tensor:
        """The image of the scene in training by a camera of the world: float32 [H, W, 3], rounded if training is."""
        camera = self.scaffold.units.camera(camera)
        rows = self.scaffold.visible(camera)
        sight = Sight(camera, rows, {name: table[rows] for name, table in self.scaffold.tables.items()})
        for stage in self.stages:
            stage.show(sight)
        _, gaussians, _ = self.scaffold.gaussians(rows, camera, sight.values, sight.masks)
        return self.drawn(gaussians, camera, None).clamp(0, 1)

    @torch.no_grad()
    def show(self, scene: Scene, camera: Camera) -> Tensor:
        """The image of the result by a camera of the world, drawn as in training: float32 [H, W, 3].

        The networks, units and rasteriser are the training's own, and no anchor is left out.
        """
        if scene.render.render_model == STATIC:
            return self._show_static(scene, camera)
        held, device = copy(self.scaffold), self.scaffold.device
        held.lattice = scene.positions.astype(np.int64)
        held.place()
        decoded = reconstruct(scene)
        attributes = {
            "features": decoded.features,
            "scalings": decoded.scalings,
            "offsets": decoded.offsets.reshape(scene.anchor_count, -1),
        }
        values = {name: torch.from_numpy(value).to(device) for name, value in attributes.items()}
        camera, rows = held.units.camera(camera), torch.arange(scene.anchor_count, device=device)
        _, gaussians, _ = held.gaussians(rows, camera, values, torch.from_numpy(scene.masks).float().to(device))
        return self.drawn(gaussians, camera, None).clamp(0, 1)

    def _show_static(self, scene: Scene, camera: Camera) -> Tensor:
        """As show. The Gaussians are the decoder's (SPEC 14.6)."""
        units, device = self.scaffold.units, self.scaffold.device
        g = gaussians_of(scene, camera)
        moved = (g.mean - units.origin) / units.length, g.quaternion, g.lengths / units.length, g.opacity, g.colour
        mean, quaternion, lengths, *rest = (torch.from_numpy(v.astype(np.float32)).to(device) for v in moved)
        return self.drawn((mean, quaternion, lengths, rest[0], rest[1]), units.camera(camera), None).clamp(0, 1)
