"""A plain 3DGS trainer: refcodec's photographs, rasteriser, loss and saved state, 3DGS's parameters and density."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from refcodec.convert.drawing import drawn
from refcodec.files.interrupts import on_interrupt
from refcodec.formats.harmonics import REST, ZERO
from refcodec.photographs.photographs import PhotographSet
from refcodec.rendering.rasterise import Settings
from refcodec.train.adam import ADAM_EPSILON
from refcodec.train.losses import photometric
from refcodec.train.optimisers import learning_rate, moments, restore_moments
from refcodec.train.settings_file import document
from refcodec.train.start import scene_length
from refcodec.train.state import Saved
from refcodec.train.views import pixels

from .density import Density
from .settings import SplatSettings

# The tensors of the Gaussians, in the order of the optimiser.
NAMES = ("mean", "base", "rest", "opacity", "scale", "quaternion")


def view_settings(photographs: PhotographSet, settings: SplatSettings) -> Settings:
    """Returns the rendering settings of a scene."""
    near = settings.begin.near * scene_length(photographs)
    red, green, blue = photographs.background
    return Settings(settings.low_pass, near, background=(red / 255, green / 255, blue / 255))


class SplatTrainer:
    """A training run in progress (a Savable of refcodec.train.state).

    splats: its Gaussians. done: finished steps. seconds: processor time of all steps except the first, which compiles.
    loss: of the last step.
    """

    def __init__(self, photographs: PhotographSet, settings: SplatSettings) -> None:
        """Initialises the Gaussians from the points of the photographs. Raises ValueError without points."""
        if not len(photographs.points):
            raise ValueError("there are no points to begin with")
        self.photographs, self.settings = photographs, settings
        self.random = torch.Generator().manual_seed(settings.seed)
        self.view = view_settings(photographs, settings)
        centres = np.stack([p.camera.centre for p in photographs.train])
        away = np.linalg.norm(centres - centres.mean(axis=0), axis=1).max()
        # A single camera has no extent.
        self.extent = settings.extent * float(away) or scene_length(photographs)
        self.images: dict[int, Tensor] = {}
        self.done, self.seconds, self.loss = 0, 0.0, math.nan
        self.order: list[int] = []
        self._take(self._first())
        self.density = Density(settings.density, self.extent, self.count)

    @property
    def count(self) -> int:
        """The number of Gaussians."""
        return len(self.splats["mean"])

    def _first(self) -> dict[str, Tensor]:
        """Returns 3DGS's first Gaussians: round, sized by the distance of neighbours, in the colours of the points."""
        begin = self.settings.begin
        most = max(int(begin.share * self.settings.density.most), 1)
        rows = torch.randperm(len(self.photographs.points), generator=self.random)[:most].sort().values.numpy()
        points = self.photographs.points[rows]
        n = len(points)
        distance = cKDTree(points).query(points, min(begin.neighbours + 1, n))[0].reshape(n, -1)[:, 1:]
        size = np.sqrt((distance**2).mean(axis=1)) if distance.shape[1] else np.full(n, 0.01 * self.extent)
        # 3DGS's least squared distance, for points that coincide.
        scale = np.log(np.maximum(size, math.sqrt(1e-7))).astype(np.float32)
        base = ((self.photographs.colours[rows] / 255 - 0.5) / ZERO).astype(np.float32)
        return {
            "mean": torch.from_numpy(points.astype(np.float32)),
            "base": torch.from_numpy(base),
            "rest": torch.zeros(n, REST[self.settings.degree], 3),
            "opacity": torch.full((n,), _logit(begin.opacity)),
            "scale": torch.from_numpy(scale)[:, None].repeat(1, 3),
            "quaternion": torch.tensor([1.0, 0, 0, 0]).repeat(n, 1),
        }

    def _take(self, splats: dict[str, Tensor]) -> None:
        """Replaces the Gaussians, and resets the optimiser."""
        self.splats = {name: splats[name].clone().requires_grad_() for name in NAMES}
        groups = [{"params": [self.splats[name]], "lr": 0.0} for name in NAMES]
        self.optimiser = torch.optim.Adam(groups, eps=ADAM_EPSILON, fused=True)

    # --- a step -------------------------------------------------------------------------------------------------------

    def step(self) -> None:
        """Runs one training step."""
        began = time.process_time()
        settings, share = self.settings, self.done / self.settings.steps
        for name, group in zip(NAMES, self.optimiser.param_groups, strict=True):
            rate = learning_rate(getattr(settings.rates, name), share)
            group["lr"] = rate * (self.extent if name == "mean" else 1)
        if not self.order:
            self.order = torch.randperm(len(self.photographs.train), generator=self.random).tolist()
        number = self.order.pop()
        screen = torch.zeros(self.count, requires_grad=True)
        camera = self.photographs.train[number].camera
        image, _, radius = drawn(self.splats, camera, self.view, self._degree(share), screen)
        loss = photometric(image, self._image(number), settings.ssim)
        loss.backward()
        self.optimiser.step()
        self.optimiser.zero_grad(set_to_none=True)
        self.done += 1
        self.loss = float(loss.detach())
        if share < settings.density.end and screen.grad is not None:
            self.density.note(screen.grad, radius)
            self._densify()
        # The first step compiles.
        self.seconds += time.process_time() - began if self.done > 1 else 0.0

    def _degree(self, share: float) -> int:
        """Returns the highest degree of harmonics in use at a share of the steps."""
        every = self.settings.degree_share
        return self.settings.degree if not every else min(int(share / every), self.settings.degree)

    def _image(self, number: int) -> Tensor:
        if number not in self.images:
            self.images[number] = pixels(self.photographs.train[number])
        return self.images[number]

    def _densify(self) -> None:
        """Applies density control after this step, if it is due."""
        density = self.settings.density
        if self.done % density.period == 0 and self.done > density.begin * self.settings.steps:
            self._change(self.done > density.reset_period)
        if self.done % density.reset_period == 0:
            self._reset()

    def _change(self, large: bool) -> None:
        change = self.density.change(self.splats, large, self.random)
        shrink = self.settings.density.shrink
        # Unused harmonics have no moments.
        before = {
            name: self.optimiser.state[self.splats[name]] for name in NAMES if self.splats[name] in self.optimiser.state
        }
        self._take({name: change.values(name, self.splats[name].detach(), shrink) for name in NAMES})
        for name, state in before.items():
            found = {key: change.moments(state[key]) for key in ("exp_avg", "exp_avg_sq")}
            self.optimiser.state[self.splats[name]] = {"step": state["step"], **found}
        self.density.begin(self.count)

    @torch.no_grad()
    def _reset(self) -> None:
        opacity = self.splats["opacity"]
        opacity.clamp_(max=_logit(self.settings.density.reset_opacity))
        for key in ("exp_avg", "exp_avg_sq"):
            self.optimiser.state[opacity][key].zero_()

    def run(self, watch: Callable[[SplatTrainer], None], save: Callable[[], None] | None = None) -> bool:
        """Trains to the end, or until an interrupt (Ctrl-C), after which it finishes the current step.

        watch: called after each step. save: called regularly, and when training ends early. Returns whether training is
        complete.
        """
        stop = threading.Event()
        saved = time.monotonic()
        with on_interrupt(lambda *_: stop.set()):
            while self.done < self.settings.steps and not stop.is_set():
                self.step()
                watch(self)
                if save and (stop.is_set() or time.monotonic() - saved > self.settings.save_seconds):
                    save()
                    saved = time.monotonic()
        return self.done == self.settings.steps

    def result(self) -> dict[str, Tensor]:
        """Returns the Gaussians, except those that density control would prune for their opacity."""
        kept = torch.sigmoid(self.splats["opacity"].detach()) >= self.settings.density.opacity
        return {name: self.splats[name].detach()[kept] for name in NAMES}

    # --- the saved state ----------------------------------------------------------------------------------------------

    def fingerprint(self) -> dict[str, Any]:
        """As Savable."""
        photographs = [[p.camera.name, p.camera.width, p.camera.height] for p in self.photographs.train]
        return {"settings": document(self.settings), "photographs": photographs}

    def state(self) -> dict[str, Any]:
        """As Savable."""
        density = {f"density/{name}": getattr(self.density, name) for name in ("gradient", "seen")}
        return {
            **{f"splats/{name}": self.splats[name].detach() for name in NAMES},
            **moments(self.optimiser),
            **density,
            "done": self.done,
            "seconds": self.seconds,
            "order": self.order,
            "random": self.random.get_state(),
        }

    def restore(self, state: Saved) -> None:
        """As Savable."""
        count = len(state.tensor("splats/opacity", (None, *self.splats["opacity"].shape[1:])))
        shapes = {name: (count, *self.splats[name].shape[1:]) for name in NAMES}
        self._take({name: state.tensor(f"splats/{name}", shape) for name, shape in shapes.items()})
        restore_moments(self.optimiser, state)
        for name in ("gradient", "seen"):
            setattr(self.density, name, state.tensor(f"density/{name}", (count,), low=0))
        self.done, self.seconds = state.integer("done", 0, self.settings.steps), state.real("seconds", 0)
        views = len(self.photographs.train)
        self.order = [int(number) for number in state.numbers("order")]
        if any(not 0 <= number < views for number in self.order):
            raise state.fault("order", f"has a number that is not from 0 to {views - 1}")
        state.generator("random", self.random)


def _logit(share: float) -> float:
    return math.log(share / (1 - share))
