"""A plain 3DGS trainer: refcodec's photographs, rasteriser and loss, with 3DGS's parameters and density control.

3DGS is Kerbl et al., "3D Gaussian Splatting for Real-Time Radiance Field Rendering" (2023), with the values of its
published code, whose training runs have 30,000 steps. Its step numbers are shares of the steps here, so that a short
training has the same order of events.
"""

import math
import time
from dataclasses import dataclass

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from refcodec.bitstream.cameras import rotation_matrix
from refcodec.convert.drawing import Tensors, drawn
from refcodec.formats.harmonics import REST, ZERO
from refcodec.photographs.photographs import PhotographSet
from refcodec.rendering.rasterise import Settings
from refcodec.train.adam import ADAM_EPSILON
from refcodec.train.losses import photometric
from refcodec.train.optimisers import learning_rate
from refcodec.train.settings import Decay
from refcodec.train.start import scene_length
from refcodec.train.views import behind, pixels

# The learning rates of the Gaussians' tensors, in the order of the optimiser; that of means is multiplied by the extent
# of the scene. Some begin higher than in 3DGS, for short training runs, and end at its values.
LEARNING_RATES = {
    "mean": Decay(6.4e-4, 1.6e-6),
    "base": Decay(0.01, 0.0025),
    "rest": Decay(5e-4, 1.25e-4),
    "opacity": Decay(0.05, 0.05),
    "scale": Decay(0.02, 0.005),
    "quaternion": Decay(0.004, 0.001),
}
# The share of 1 - SSIM in the loss, and the initial opacity; both are 3DGS's.
SSIM, OPACITY = 0.2, 0.1
# The nearest depth that is drawn, in scene lengths, and what is added to both variances of a Gaussian in an image, in
# square pixels: those of refcodec's trainer. 3DGS adds 0.3.
NEAR, LOW_PASS = 0.02, 0.1
# 3DGS's density control. The extent of a scene is 1.1 times the largest distance of a camera from their middle. The
# limit of 20 pixels for radii in an image is omitted: it has no effect in 3DGS, which resets the radii first (issue 643
# of its repository), and with an effective limit 10,000 steps lost 5 dB on a scene at 200 pixels.
EXTENT = 1.1
# Shares of the steps at which it begins and ends, and steps between two changes, and between two resets of opacities.
BEGIN, END, PERIOD, RESET_PERIOD = 1 / 60, 0.5, 100, 3000
# A Gaussian is cloned or split from this mean gradient of its projected mean on, in loss / normalised device unit. It
# is split if it is longer than DENSE extents, into CHILDREN whose lengths are divided by SHRINK. One is pruned below
# this opacity, and after the first reset if it is longer than LARGEST extents.
GRADIENT, DENSE, CHILDREN, SHRINK = 2e-4, 0.01, 2, 1.6
PRUNED, RESET, LARGEST = 0.005, 0.01, 0.1


@dataclass(frozen=True)
class SplatSettings:
    """A training run. most: the largest number of Gaussians. size: longest side of photographs. degree: of harmonics.

    3DGS has harmonics of degree 3.
    """

    most: int
    steps: int
    size: str
    seed: int
    degree: int = 1


@dataclass(frozen=True, eq=False)
class Change:
    """A change of the Gaussians: the kept ones, then clones, then children.

    rows: the index of each before the change. kept: the number of kept ones. moved: [children, 3], the offset of a
    child's mean from its parent's, in world units.
    """

    rows: Tensor
    kept: int
    moved: Tensor

    def values(self, name: str, table: Tensor) -> Tensor:
        """Returns a tensor of the Gaussians after the change."""
        values, children = table[self.rows], len(self.rows) - len(self.moved)
        if name == "mean":
            values[children:] += self.moved
        if name == "scale":
            values[children:] -= math.log(SHRINK)
        return values

    def moments(self, table: Tensor) -> Tensor:
        """Returns a moment of Adam after the change, which is 0 for new Gaussians."""
        values = table[self.rows]
        values[self.kept :] = 0
        return values


@torch.no_grad()
def change(splats: Tensors, gradient: Tensor, most: int, extent: float, large: bool, random: torch.Generator) -> Change:
    """Returns 3DGS's change of the Gaussians (section 5), within a largest number.

    If more would be cloned and split than it allows, those with the largest gradients are.

    Args:
        splats: the Gaussians.
        gradient: float32 [N], mean lengths of the projected means' gradients.
        most: the largest number of Gaussians.
        extent: of the scene, in world units.
        large: whether large Gaussians are pruned, too.
        random: draws the places of children.
    """
    length = splats["scale"].exp().amax(dim=1)
    dead = torch.sigmoid(splats["opacity"]) < PRUNED
    if large:
        dead |= length > LARGEST * extent
    grows, splits = (gradient >= GRADIENT) & ~dead, length > DENSE * extent
    # A clone adds one Gaussian, a split one less than its children. The larger number always keeps the limit.
    room = max(most - int((~dead).sum()), 0) // (CHILDREN - 1)
    if int(grows.sum()) > room:
        order = torch.where(grows, gradient, -1.0).argsort(descending=True, stable=True)
        grows = torch.zeros_like(grows)
        grows[order[:room]] = True
    split = torch.nonzero(grows & splits)[:, 0].repeat(CHILDREN)
    # A sample of each parent's distribution.
    lengths = splats["scale"][split].exp()
    along = torch.randn(lengths.shape, generator=random) * lengths
    quaternion = torch.nn.functional.normalize(splats["quaternion"][split]).double().numpy()
    rotation = torch.from_numpy(rotation_matrix(quaternion).astype(np.float32))
    moved = (rotation @ along[:, :, None])[:, :, 0]
    kept = torch.nonzero(~dead & ~(grows & splits))[:, 0]
    return Change(torch.cat([kept, torch.nonzero(grows & ~splits)[:, 0], split]), len(kept), moved)


def view_settings(photographs: PhotographSet) -> Settings:
    """Returns the rendering settings of a scene."""
    red, green, blue = photographs.background
    return Settings(LOW_PASS, NEAR * scene_length(photographs), background=(red / 255, green / 255, blue / 255))


class SplatTrainer:
    """A training run in progress.

    splats: its Gaussians. done: finished steps. seconds: processor time of all steps except the first, which compiles.
    """

    def __init__(self, photographs: PhotographSet, settings: SplatSettings) -> None:
        """Initialises the Gaussians from the points of the photographs. Raises ValueError without points."""
        if not len(photographs.points):
            raise ValueError("there are no points to begin with")
        self.photographs, self.settings, self.view = photographs, settings, view_settings(photographs)
        self.random = torch.Generator().manual_seed(settings.seed)
        centres = np.stack([p.camera.centre for p in photographs.train])
        away = float(np.linalg.norm(centres - centres.mean(axis=0), axis=1).max())
        # A single camera has no extent.
        self.extent = EXTENT * away or scene_length(photographs)
        self.images: dict[int, Tensor] = {}
        self.order: list[int] = []
        self.done, self.seconds = 0, 0.0
        self._take(self._first())

    @property
    def count(self) -> int:
        """The number of Gaussians."""
        return len(self.splats["mean"])

    def _first(self) -> dict[str, Tensor]:
        """Returns 3DGS's first Gaussians: round, sized by the distance of neighbours, in the colours of the points."""
        most = max(self.settings.most // 2, 1)
        rows = torch.randperm(len(self.photographs.points), generator=self.random)[:most].sort().values.numpy()
        points = self.photographs.points[rows]
        n = len(points)
        distance = cKDTree(points).query(points, min(4, n))[0].reshape(n, -1)[:, 1:]
        size = np.sqrt((distance**2).mean(axis=1)) if distance.shape[1] else np.full(n, 0.01 * self.extent)
        # 3DGS's least squared distance, for points that coincide.
        scale = np.log(np.maximum(size, math.sqrt(1e-7))).astype(np.float32)
        base = ((self.photographs.colours[rows] / 255 - 0.5) / ZERO).astype(np.float32)
        return {
            "mean": torch.from_numpy(points.astype(np.float32)),
            "base": torch.from_numpy(base),
            "rest": torch.zeros(n, REST[self.settings.degree], 3),
            "opacity": torch.full((n,), math.log(OPACITY / (1 - OPACITY))),
            "scale": torch.from_numpy(scale)[:, None].repeat(1, 3),
            "quaternion": torch.tensor([1.0, 0, 0, 0]).repeat(n, 1),
        }

    def _take(self, splats: Tensors) -> None:
        """Replaces the Gaussians, and resets the optimiser and the statistics of density control."""
        self.splats = {name: splats[name].clone().requires_grad_() for name in LEARNING_RATES}
        groups = [{"params": [value], "lr": 0.0} for value in self.splats.values()]
        self.optimiser = torch.optim.Adam(groups, eps=ADAM_EPSILON, fused=True)
        # Sums of the lengths of the projected means' gradients, and the number of steps that drew each.
        self.gradient, self.seen = torch.zeros(self.count), torch.zeros(self.count)

    def step(self) -> None:
        """Runs one training step."""
        began, share = time.process_time(), self.done / self.settings.steps
        for (name, decay), group in zip(LEARNING_RATES.items(), self.optimiser.param_groups, strict=True):
            group["lr"] = learning_rate(decay, share) * (self.extent if name == "mean" else 1)
        if not self.order:
            self.order = torch.randperm(len(self.photographs.train), generator=self.random).tolist()
        number = self.order.pop()
        if number not in self.images:
            self.images[number] = pixels(self.photographs.train[number])
        screen = torch.zeros(self.count, requires_grad=True)
        # One more degree is in use after each 30th of the steps.
        degree = min(int(share / (1 / 30)), self.settings.degree)
        view = behind(self.photographs, self.view, self.random)
        image, _, radius = drawn(self.splats, self.photographs.train[number].camera, view, degree, screen)
        photometric(image, self.images[number], SSIM).backward()
        self.optimiser.step()
        self.optimiser.zero_grad(set_to_none=True)
        self.done += 1
        if share < END and screen.grad is not None:
            self.gradient += torch.where(radius > 0, screen.grad, 0)
            self.seen += radius > 0
            if self.done % PERIOD == 0 and self.done > BEGIN * self.settings.steps:
                self._change()
            if self.done % RESET_PERIOD == 0:
                self._reset()
        # The first step compiles.
        self.seconds += time.process_time() - began if self.done > 1 else 0.0

    def _change(self) -> None:
        mean, large = self.gradient / self.seen.clamp_min(1), self.done > RESET_PERIOD
        made = change(self.splats, mean, self.settings.most, self.extent, large, self.random)
        before = {name: self.optimiser.state.get(value) for name, value in self.splats.items()}
        self._take({name: made.values(name, value.detach()) for name, value in self.splats.items()})
        # Unused harmonics have no moments.
        for name, state in ((name, state) for name, state in before.items() if state):
            kept = {key: made.moments(state[key]) for key in ("exp_avg", "exp_avg_sq")}
            self.optimiser.state[self.splats[name]] = {"step": state["step"], **kept}

    @torch.no_grad()
    def _reset(self) -> None:
        opacity = self.splats["opacity"]
        opacity.clamp_(max=math.log(RESET / (1 - RESET)))
        for key in ("exp_avg", "exp_avg_sq"):
            self.optimiser.state[opacity][key].zero_()

    def run(self) -> dict[str, Tensor]:
        """Trains to the end. Returns the Gaussians, except those that density control would prune for their opacity."""
        while self.done < self.settings.steps:
            self.step()
        kept = torch.sigmoid(self.splats["opacity"].detach()) >= PRUNED
        return {name: value.detach()[kept] for name, value in self.splats.items()}
