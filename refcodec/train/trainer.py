"""Training: photographs to a scene, by Scaffold-GS and CAT-3DGS Pro's rate-distortion optimisation.

The loss of a step is L_Scaffold + lambda_r L_rate + lambda_m L_m (the paper's equation 4). One loop calls the stages of
the method in turn. Each stage reads from the phases of the settings when it is active; the loop does not know them.
"""

import time
from collections.abc import Callable, Sequence
from importlib import import_module
from typing import Any
from zlib import crc32

import torch
from torch import Tensor

from ..bitstream.scene import Scene
from ..folder.uncompressed import Uncompressed
from ..photographs.photographs import PhotographSet
from ..rendering.camera import STATED, spread_cameras
from ..rendering.rasterise import Settings
from .device import noise_generator, training_device
from .export import coded_scene, render_info, uncompressed
from .fit_input import Given
from .looks import Looks
from .losses import photometric
from .scaffold import Scaffold
from .schedule import Clock
from .settings import MODES, TrainSettings
from .settings_file import document
from .splat import draw
from .stage import Run, Stage, Step
from .stages.rate import Rate
from .state import Saved, run_steps
from .views import behind

Watch = Callable[["Trainer"], None]
# The name of the device's random numbers in a saved state.
NOISE = "noise"


def method(settings: TrainSettings) -> list[Stage]:
    """The stages of the method that the settings select: a class of its name in each module of `stages`."""
    stages = [getattr(import_module(f".stages.{name}", __package__), name.capitalize())() for name in MODES]
    return [stage for stage in stages if settings.rate.lambda_r or not stage.needs_rate]


class Trainer(Run):
    """A training run in progress. looks: its records, the last of its stages."""

    looks: Looks

    def __init__(
        self,
        photographs: PhotographSet,
        settings: TrainSettings,
        device: str = "cpu",
        given: Given | None = None,
        stages: Sequence[Stage] = (),
    ) -> None:
        """given: a scene to continue, None to begin with points. stages: others, after those of the method.

        Raises ValueError for photographs that do not suffice for training, for a missing device, and for a stage
        without a name of its own.
        """
        self.settings, self.photographs, self.device = settings, photographs, training_device(device)
        self.given = given
        self.random = torch.Generator().manual_seed(settings.seed)
        self.noise = noise_generator(self.device, self.random, settings.seed)
        self.clock = Clock(settings.phases, settings.steps)
        self.scaffold = Scaffold(photographs, settings, self.random, self.device, given)
        self.cameras = [self.scaffold.units.camera(p.camera) for p in photographs.train]
        red, green, blue = (c / 255 for c in photographs.background)
        self.drawing = Settings(self.scaffold.low_pass, self.scaffold.near, background=(red, green, blue))
        self.looks = Looks()
        self.stages = [*method(settings), *stages, self.looks]
        self.order: list[int] = []
        self._images: dict[int, Tensor] = {}
        names = [stage.name for stage in self.stages]
        for stage in self.stages:
            if not stage.name or "/" in stage.name or names.count(stage.name) > 1:
                raise ValueError(f"a stage has the name {stage.name!r}, but each must have one of its own")
            stage.join(self)

    # --- the loop -----------------------------------------------------------------------------------------------------

    def step(self) -> None:
        """One step of training."""
        began = time.perf_counter()
        for stage in self.stages:
            stage.before_step()
        number = self._next_view()
        step, photograph = self._looked_at(number)
        for stage in self.stages:
            stage.prepare(step)
        image, volume = self._drawn(step)
        for stage in self.stages:
            image = stage.photographed(step, image)
        loss = photometric(image, photograph, self.settings.loss.ssim)
        if volume is not None:
            loss = loss + self.settings.loss.volume * volume
        for stage in self.stages:
            term = stage.loss(step)
            if term is not None:
                loss = loss + term
        loss.backward()
        for stage in self.stages:
            stage.descend(step)
        self.clock.done += 1
        for stage in self.stages:
            stage.after_step()
        self.looks.step_done(image, photograph, time.perf_counter() - began)

    def _next_view(self) -> int:
        """The photograph of a step: each comes once, in random order, then each again."""
        if not self.order:
            self.order = torch.randperm(len(self.cameras), generator=self.random).tolist()
        return self.order.pop()

    def _image(self, number: int) -> Tensor:
        """A photograph to learn from, which is kept on the device."""
        if number not in self._images:
            self._images[number] = self.pixels(self.photographs.train[number])
        return self._images[number]

    def _looked_at(self, number: int) -> tuple[Step, Tensor]:
        """A step before anything is drawn, and its photograph."""
        camera, photograph = self.cameras[number], self._image(number)
        for stage in self.stages:
            camera, photograph = stage.viewed(camera, photograph)
        rows = self.scaffold.visible(camera)
        leaves = self.scaffold.leaves(rows)
        step = Step(camera, rows, dict(leaves), photograph=number, leaves=leaves, taken=[(rows, leaves)])
        return step, photograph

    def _drawn(self, step: Step) -> tuple[Tensor, Tensor | None]:
        """The image of a step, and the mean volume of its Gaussians, None if there are none."""
        chosen, gaussians, opacity = self.scaffold.gaussians(step.rows, step.camera, step.values, step.masks)
        screen = torch.zeros(len(chosen), device=self.device, requires_grad=True)
        step.chosen, step.opacity, step.screen = chosen, opacity, screen
        drawing = behind(self.photographs, self.drawing, self.random)
        image, _, _ = draw(gaussians, step.camera, drawing, screen)
        return image, gaussians[2].prod(dim=1).mean() if len(chosen) else None

    def run(self, watch: Watch, keep: Callable[[], None] | None = None) -> bool:
        """Trains to the end, or until an interrupt; the current step is finished first (state.run_steps).

        watch: called after each step. keep: saves the state. Returns whether the training reached its end.
        """

        def step() -> None:
            self.step()
            self.looks.look()
            watch(self)

        run_steps(step, lambda: self.clock.done == self.clock.steps, keep, self.settings.looks.save_seconds)
        return self.clock.done == self.clock.steps

    @property
    def rate(self) -> Rate | None:
        """The stage that counts bits; None for an uncompressed Scaffold-GS, which has no entropy model and no masks."""
        return next(self.of(Rate), None)

    # --- results ------------------------------------------------------------------------------------------------------

    def result(self) -> Scene | Uncompressed:
        """The trained scene, as a file or folder stores it: integers, or floats without a rate.

        Stages that a file needs begin now if they have not begun. Raises ValueError for values that cannot be written.
        """
        cameras = spread_cameras([p.camera for p in self.photographs.train], STATED)
        render = render_info(self.scaffold, self.photographs)
        for stage in self.stages:
            stage.finish()
        if self.rate is None:
            return uncompressed(self.scaffold, render, cameras)
        return coded_scene(self.scaffold, self.rate, render, cameras)

    # --- the saved state ----------------------------------------------------------------------------------------------

    def fingerprint(self) -> dict[str, Any]:
        """The values that must be equal to continue: settings except steps, photographs with their sizes, and masks."""
        photographs = [[p.camera.name, p.camera.width, p.camera.height] for p in self.photographs.train]
        masks = [None if p.mask is None else crc32(p.mask.tobytes()) for p in self.photographs.train]
        settings = {name: value for name, value in document(self.settings).items() if name != "steps"}
        facts: dict[str, Any] = {"settings": settings, "photographs": photographs}
        facts |= {"masks": masks} if any(masks) else {}
        if self.given is not None:
            facts["from"] = len(self.given.cloud.positions)
        own = {*MODES, self.looks.name}
        others = [stage.name for stage in self.stages if stage.name not in own]
        return {**facts, "stages": others} if others else facts

    def state(self) -> dict[str, Any]:
        """Everything that an exact continuation needs: tensors, and values of JSON, by names with slashes."""
        values: dict[str, Any] = {
            **{f"clock/{name}": value for name, value in self.clock.state().items()},
            "order": self.order,
            **{f"scaffold/{name}": value for name, value in self.scaffold.state().items()},
        }
        for stage in self.stages:
            values |= {f"{stage.name}/{name}": value for name, value in stage.state().items()}
        values["random"] = self.random.get_state()
        if self.noise is not self.random:
            values[NOISE] = self.noise.get_state()
        return {name: value.cpu() if isinstance(value, Tensor) else value for name, value in values.items()}

    def restore(self, state: Saved) -> None:
        """Sets a new training to a saved state. Raises ValueError for values that cannot be its state."""
        self.clock.restore(state.within("clock"))
        order, views = state.value("order", list[int]), len(self.cameras)
        if len(set(order) & set(range(views))) != len(order):
            raise state.fault("order", f"is not a list of different numbers of the {views} photographs")
        self.order = order
        self.scaffold.restore(state.within("scaffold"))
        self.anchors_changed()
        for stage in self.stages:
            stage.restore(state.within(stage.name))
        state.generator("random", self.random)
        if NOISE in state.names():
            self._restore_noise(state)

    def _restore_noise(self, state: Saved) -> None:
        """Sets the device's random numbers, if the state is of a device of this kind.

        A state is valid on any device. On a device of another kind the noise restarts.
        """
        drawn = state.tensor(NOISE, (None,), torch.uint8)
        if self.noise is not self.random and drawn.shape == self.noise.get_state().shape:
            state.generator(NOISE, self.noise)
