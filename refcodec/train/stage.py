"""The interface of a stage of the method, and the training run that all stages share.

A stage of your own is an object that `train` takes, as gsplat takes a strategy; docs/method.md has an example.
It is called after the stages of the method. A stage of the method itself is a module of `stages` with an entry in
settings.MODES, which names it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, TypeVar

import torch
from torch import Tensor

from ..photographs.photographs import Photograph, PhotographSet
from ..rendering.camera import Camera
from ..rendering.rasterise import Settings
from .scaffold import Scaffold
from .schedule import Clock
from .settings import TrainSettings
from .splat import draw
from .state import Saved
from .views import pixels

S = TypeVar("S", bound="Stage")


@dataclass(eq=False)
class Sight:
    """The anchors in front of a camera.

    camera: in training units. rows: the n anchors that it may see, int64 [n], ascending. values: their features [n, F],
    offsets [n, 3 K], scalings [n, 6] and masks' logits [n, K], float32, which stages replace by the values to draw.
    steps: of features, scalings and offsets [n, 3]; None before there is an entropy model. masks: float32 [n, K], which
    multiply the opacities; None for ones.
    """

    camera: Camera
    rows: Tensor
    values: dict[str, Tensor]
    steps: Tensor | None = None
    masks: Tensor | None = None


@dataclass(eq=False)
class Step(Sight):
    """A step of training.

    photograph: its number. leaves: the anchors' values as tensors with gradients, of which `values` are made. taken:
    all sets of rows whose leaves have a gradient in this step, those of the image first. The other fields are set once
    the image is drawn. chosen: the offsets that were drawn, int64 [m], ascending, row * K + offset. opacity: of all
    offsets [n, K]. screen: [m], whose gradient is that of the projected centres.
    """

    photograph: int = 0
    leaves: dict[str, Tensor] = field(default_factory=dict)
    taken: list[tuple[Tensor, dict[str, Tensor]]] = field(default_factory=list)
    chosen: Tensor | None = None
    opacity: Tensor | None = None
    screen: Tensor | None = None


class Stage:
    """A stage of the method. A training run calls its stages in their order at each of these points.

    A stage defines only the calls that it needs. name: its name in the phases of the settings and in saved states.
    needs_rate: whether an uncompressed training omits it. run: the training run.
    """

    name = ""
    needs_rate = False
    run: Run

    def join(self, run: Run) -> None:
        """Before the first step, and before a saved state is restored. A stage that defines it calls this one first."""
        self.run = run

    @property
    def mode(self) -> str:
        """The present mode of a stage of the method, of settings.MODES."""
        return self.run.clock.mode(self.name)

    # --- of a step, in this order -------------------------------------------------------------------------------------

    def before_step(self) -> None:
        """Before a step: creates the objects that the phase requires, unless they exist."""

    def viewed(self, camera: Camera, photograph: Tensor) -> tuple[Camera, Tensor]:
        """The camera in training units and the photograph of a step: the whole ones, if not changed."""
        return camera, photograph

    def prepare(self, step: Step) -> None:
        """Before the image is drawn: changes the values to draw."""

    def photographed(self, step: Step, image: Tensor) -> Tensor:
        """The image [H, W, 3] that is compared with the photograph: the one that was drawn, if not changed."""
        return image

    def loss(self, step: Step) -> Tensor | None:
        """The term that is added to the loss of the image, a scalar, or None."""

    def descend(self, step: Step) -> None:
        """After the gradients: updates parameters."""

    def after_step(self) -> None:
        """Between two steps, after the clock has counted this one."""

    # --- at other times -----------------------------------------------------------------------------------------------

    def show(self, sight: Sight) -> None:
        """Replaces the values to draw by those of the decoder, without gradients or random numbers."""

    def anchors_changed(self) -> None:
        """After anchors were added or removed."""

    def finish(self) -> None:
        """Before the result: creates the objects that a file needs, unless they exist."""

    def state(self) -> dict[str, Any]:
        """The values that a saved training needs: tensors, and values of JSON."""
        return {}

    def restore(self, state: Saved) -> None:
        """Restores the values of `state`. The anchors are restored before, the random numbers after all stages.

        Raises ValueError for values that cannot be a state of this stage.
        """


class Run:
    """A training run as its stages see it.

    stages: in the order in which the loop calls them. cameras: those of the photographs to learn from, in training
    units. drawing: the settings of the rasteriser.

    device: of all tensors of a step; kernels replace definitions in torch on the CPU. random: draws the first values,
    the order of photographs and the growth, on the CPU, which makes these the same on every device. noise: draws on the
    device the noise of steps and the anchors whose bits count. On the CPU both are the same generator.
    """

    settings: TrainSettings
    photographs: PhotographSet
    device: torch.device
    random: torch.Generator
    noise: torch.Generator
    clock: Clock
    scaffold: Scaffold
    cameras: list[Camera]
    drawing: Settings
    stages: list[Stage]

    def of(self, kind: type[S]) -> Iterator[S]:
        """The stages of a kind, of which there is one or none."""
        return (stage for stage in self.stages if isinstance(stage, kind))

    def anchors_changed(self) -> None:
        """Tells all stages that anchors were added or removed."""
        for stage in self.stages:
            stage.anchors_changed()

    def pixels(self, photograph: Photograph) -> Tensor:
        """A photograph on the training's device (views.pixels)."""
        return pixels(photograph, self.device)

    @torch.no_grad()
    def draw(self, camera: Camera) -> Tensor:
        """The image of the scene in training by a camera of the world: float32 [H, W, 3], rounded if training is."""
        camera = self.scaffold.units.camera(camera)
        rows = self.scaffold.visible(camera)
        sight = Sight(camera, rows, {name: table[rows] for name, table in self.scaffold.tables.items()})
        for stage in self.stages:
            stage.show(sight)
        _, gaussians, _ = self.scaffold.gaussians(rows, camera, sight.values, sight.masks)
        return draw(gaussians, camera, self.drawing)[0].clamp(0, 1)
