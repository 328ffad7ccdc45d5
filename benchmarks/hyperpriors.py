"""Hyperpriors that the paper compares with the one of the format: planes over pairs of axes, without gamma.

No file can hold them. They are trained and estimated, and their scenes are drawn with rounded attributes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from refcodec.bitstream.attributes import KINDS
from refcodec.bitstream.frame import Frame
from refcodec.bitstream.planes import PLANES
from refcodec.bitstream.reconstruction import Reconstruction
from refcodec.folder.uncompressed import Uncompressed
from refcodec.render.camera import named_camera
from refcodec.train.export import render_info, uncompressed
from refcodec.train.rate_model.hyperprior import Contexts, PlaneSamples, scene_coordinates
from refcodec.train.rate_model.units import LATENT_UNIT, PLANE_SHIFT
from refcodec.train.trainer import Trainer


@dataclass(frozen=True)
class Planes:
    """Planes over pairs of the principal axes, with some channels, at two scales each (a Hyperprior)."""

    axes: tuple[tuple[int, int], ...]
    channels: int
    coded: bool = False

    def input_units(self) -> Tensor:
        """As Hyperprior."""
        return torch.full((2 * self.channels * len(self.axes),), LATENT_UNIT * 2**PLANE_SHIFT)

    def latent_shape(self, plane_size: int) -> tuple[int, int, int, int]:
        """As Hyperprior."""
        return PLANES * len(self.axes), self.channels, plane_size, plane_size

    def contexts(self, frame: Frame, positions: NDArray[np.float16], plane_size: int) -> Contexts:
        """As Hyperprior."""
        u = scene_coordinates(frame, positions)
        return _PlaneContexts([PlaneSamples(u[:, list(pair)], plane_size) for pair in self.axes])


class _PlaneContexts:
    def __init__(self, samples: list[PlaneSamples]) -> None:
        self.samples = samples

    def inputs(self, symbols: Tensor, rows: Tensor, rounding: bool) -> Tensor:
        parts = [s.query(symbols[PLANES * i : PLANES * (i + 1)], rows, rounding) for i, s in enumerate(self.samples)]
        return torch.cat(parts, dim=1)


_THREE = ((0, 1), (0, 2), (1, 2))
# Rows of the paper's table beside the one of the format.
HYPERPRIORS = {"plane": Planes(_THREE[:1], 8), "triplane": Planes(_THREE, 8), "triplane72": Planes(_THREE, 72)}


@torch.no_grad()
def rounded_scene(trainer: Trainer) -> Uncompressed:
    """What a training with any hyperprior shows: its attributes rounded to multiples of their steps, in world units."""
    scaffold, rate = trainer.scaffold, trainer.rate
    assert rate is not None
    for stage in trainer.stages:
        stage.finish()
    info = render_info(scaffold, trainer.photographs)
    whole = uncompressed(scaffold, info, [named_camera(trainer.photographs.train[0].camera)])
    steps, masks = rate.steps(torch.arange(scaffold.count)).numpy(), rate.masks.decided().numpy()
    values = {}
    for i, kind in enumerate(KINDS):
        found = np.asarray(getattr(whole.values, kind))
        size = steps[:, i].reshape(-1, *[1] * (found.ndim - 1))
        values[kind] = np.floor(found / size + 0.5) * size
    values["offsets"] = np.where(masks[:, :, None], values["offsets"], np.float32(0))
    return replace(whole, values=Reconstruction(whole.values.positions, **values), masks=masks)
