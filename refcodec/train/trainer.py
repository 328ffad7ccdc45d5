"""Training: photographs to a scene, by Scaffold-GS and CAT-3DGS Pro's rate-distortion optimisation.

The loss of a step is L_Scaffold + lambda_r L_rate + lambda_m L_m (the paper's equation 4). One loop calls the stages of
the method in turn. Each stage reads from the phases of the settings when it is active; the loop does not know them.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from ..bitstream.scene import Scene
from ..files.interrupts import on_interrupt
from ..folder.uncompressed import Uncompressed
from ..photographs.photographs import PhotographSet
from ..rendering.camera import STATED, spread_cameras
from .device import noise_generator, training_device
from .estimate import coded_bytes, likely_bytes, uncompressed_bytes
from .export import coded_scene, render_info, uncompressed
from .fit_input import Given
from .looks import Looks
from .losses import photometric
from .pace import Pace
from .scaffold import Scaffold
from .schedule import Clock
from .settings import TrainSettings
from .settings_file import document
from .stage import Stage, Step
from .stages.averaging import Averaging
from .stages.grids import Grids
from .stages.growth import Growth
from .stages.learning import Learning
from .stages.masks import Masks
from .stages.quantisation import Quantisation
from .stages.rate import Rate
from .state import Saved
from .views import Views

Watch = Callable[["Trainer"], None]
# The name of the device's random numbers in a saved state.
NOISE = "noise"


class Trainer:
    """A training run in progress.

    stages: those of the method, in the order in which the loop calls them. rate: the stage that counts bits; None for
    an uncompressed Scaffold-GS, which has neither masks nor an entropy model.

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
    views: Views
    looks: Looks

    def __init__(
        self,
        photographs: PhotographSet,
        settings: TrainSettings,
        device: str = "cpu",
        given: Given | None = None,
    ) -> None:
        """given: a scene to continue, None to begin with points.

        Raises ValueError for photographs that do not suffice for training, and for a missing device.
        """
        self.settings, self.photographs, self.device = settings, photographs, training_device(device)
        self.given = given
        self.random = torch.Generator().manual_seed(settings.seed)
        self.noise = noise_generator(self.device, self.random, settings.seed)
        self.clock = Clock(settings.phases, settings.steps)
        self.scaffold = Scaffold(photographs, settings, self.random, self.device, given)
        self.stages: list[Stage] = []
        self.views = Views(photographs, self.scaffold, self.stages)
        pace = Pace(self.clock, bool(settings.rate.lambda_r))
        self.looks = Looks(settings.looks, self.views, self.estimate, self.clock, pace)
        self.rate: Rate | None = None
        self.stages += self._compose()
        self.order: list[int] = []

    def _compose(self) -> list[Stage]:
        """The stages of the method that the settings select."""
        settings, scaffold, clock, random = self.settings, self.scaffold, self.clock, self.random
        start = settings.masks.start
        growth = Growth(settings.growth, start, scaffold, clock, random, self._anchors_changed, self.photographs.pixels)
        always = [growth, Learning(settings.learning, scaffold, clock)]
        if not settings.rate.lambda_r:
            return [*always, Averaging(scaffold, None, clock), self.looks]
        masks = Masks(
            settings.masks, settings.rate.lambda_r, scaffold, self.views.cameras, clock, self._anchors_changed
        )
        quantisation = Quantisation(settings.quantisation, scaffold, clock, self.noise)
        self.rate = Rate(settings, scaffold, masks, quantisation, clock, random)
        grids = Grids(settings, scaffold, self.rate, self.views, self.estimate, clock)
        averaging = Averaging(scaffold, self.rate, clock)
        return [masks, self.rate, quantisation, grids, *always, averaging, self.looks]

    def _anchors_changed(self) -> None:
        for stage in self.stages:
            stage.anchors_changed()

    # --- the loop -----------------------------------------------------------------------------------------------------

    def step(self) -> None:
        """One step of training."""
        began = time.perf_counter()
        for stage in self.stages:
            stage.begin()
        number = self._next_view()
        step, photograph = self._looked_at(number), self.views.image(number)
        for stage in self.stages:
            stage.prepare(step)
        image, volume = self._drawn(step)
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
            stage.end()
        self.looks.step_done(image, photograph, time.perf_counter() - began)

    def _next_view(self) -> int:
        """The photograph of a step: each comes once, in random order, then each again."""
        if not self.order:
            self.order = torch.randperm(len(self.views.cameras), generator=self.random).tolist()
        return self.order.pop()

    def _looked_at(self, number: int) -> Step:
        camera = self.views.cameras[number]
        rows = self.scaffold.visible(camera)
        leaves = self.scaffold.leaves(rows)
        return Step(camera, rows, dict(leaves), leaves=leaves, taken=[(rows, leaves)])

    def _drawn(self, step: Step) -> tuple[Tensor, Tensor | None]:
        """The image of a step, and the mean volume of its Gaussians, None if there are none."""
        chosen, gaussians, opacity = self.scaffold.gaussians(step.rows, step.camera, step.values, step.masks)
        screen = torch.zeros(len(chosen), device=self.device, requires_grad=True)
        step.chosen, step.opacity, step.screen = chosen, opacity, screen
        image = self.views.drawn(gaussians, step.camera, screen)
        return image, gaussians[2].prod(dim=1).mean() if len(chosen) else None

    def run(self, watch: Watch, save: Callable[[], None] | None = None) -> bool:
        """Trains to the end, or until an interrupt; the current step is finished first.

        An interrupt is one of the signals of files.interrupts, such as Ctrl-C.

        watch: called after each step. save: called from time to time, and after the last step. Returns whether the
        training reached its end.
        """
        stop = threading.Event()
        saved = time.monotonic()
        with on_interrupt(lambda *_: stop.set()):
            while self.clock.done < self.clock.steps and not stop.is_set():
                self.step()
                self.looks.look()
                watch(self)
                late = time.monotonic() - saved > self.settings.looks.save_seconds
                if save and (late or stop.is_set() or self.clock.done == self.clock.steps):
                    save()
                    saved = time.monotonic()
        return self.clock.done == self.clock.steps

    # --- results ------------------------------------------------------------------------------------------------------

    def estimate(self) -> dict[str, float]:
        """Bytes of each part of the file as they are now: estimate.coded_bytes, or likely_bytes before the rate.

        Of an uncompressed scene they are those of its float32 numbers.
        """
        if self.rate is None:
            return uncompressed_bytes(self.scaffold)
        if self.rate.model is None:
            return likely_bytes(self.scaffold, self.settings.rate.lambda_r)
        return coded_bytes(self.scaffold, self.rate)

    def result(self) -> Scene | Uncompressed:
        """The trained scene, as a file or folder stores it: integers, or floats without a rate.

        Stages that a file needs begin now if they have not begun. Raises ValueError for values that cannot be written.
        """
        cameras = spread_cameras([p.camera for p in self.photographs.train], STATED)
        render = render_info(self.scaffold, self.photographs)
        if self.rate is None:
            return uncompressed(self.scaffold, render, cameras)
        for stage in self.stages:
            stage.finish()
        return coded_scene(self.scaffold, self.rate, render, cameras)

    # --- the saved state ----------------------------------------------------------------------------------------------

    def fingerprint(self) -> dict[str, Any]:
        """The values that must be equal to continue: settings except steps, and photographs with their sizes."""
        photographs = [[p.camera.name, p.camera.width, p.camera.height] for p in self.photographs.train]
        settings = {name: value for name, value in document(self.settings).items() if name != "steps"}
        facts = {"settings": settings, "photographs": photographs}
        return facts if self.given is None else {**facts, "from": len(self.given.cloud.positions)}

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
        order, views = state.value("order"), len(self.views.cameras)
        right = isinstance(order, list) and all(type(n) is int and 0 <= n < views for n in order)
        if not right or len(set(order)) != len(order):
            raise state.fault("order", f"is not a list of different numbers of the {views} photographs")
        self.order = order
        self.scaffold.restore(state.within("scaffold"))
        self._anchors_changed()
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
