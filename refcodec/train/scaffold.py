"""Scaffold-GS (Lu et al. 2024): anchors on a lattice, and three networks that turn them into Gaussians for a camera."""

import math
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ..bitstream.dimensions import RENDERING
from ..formats.harmonics import DEGREE_MAX
from ..photographs.photographs import PhotographSet
from ..rendering.camera import Camera
from ..rendering.constants import ALPHA_MIN
from ..rendering.gaussians import check_view_dependent
from .continued import Beginning, beginning
from .device import Gaussians
from .fit_input import Given
from .rate_model.columns import Columns
from .rate_model.model import OFFSETS
from .rendering_networks import RenderNetworks
from .settings import CHOSEN, TrainSettings
from .spawn import spawn
from .start import LATTICE_MAX, Units, first_anchors
from .state import Saved
from .visible import visible

I64 = NDArray[np.int64]

# The tables of the anchors.
TABLES = ("features", "offsets", "scalings", "masks")


class Scaffold:
    """The anchors of a scene in training, and its rendering networks.

    columns: those of the attributes. tables: float32 [N, columns] each: features, offsets (in units of
    exp(scalings[:3])), scalings (natural logarithms of world lengths) and masks (logits). first, second: their moments
    (adam.adam_torch). lattice: int64 [N, 3], cells from the grid's origin. position: float32 [N, 3], training units.
    stretch: float32 [N], how much longer an axis of an anchor's Gaussians is than its scaling at most, in natural
    logarithms, as of the last `measure`; 0 in a view-dependent scene. within: of FirstAnchors.

    The lattice is an array. All other values are tensors on the device of the training run.
    """

    device: torch.device
    units: Units
    lattice: I64
    near: float
    low_pass: float
    columns: Columns
    tables: dict[str, torch.Tensor]
    first: dict[str, torch.Tensor]
    second: dict[str, torch.Tensor]
    networks: RenderNetworks
    position: torch.Tensor
    stretch: torch.Tensor
    within: str = "points"

    def __init__(
        self,
        photographs: PhotographSet,
        settings: TrainSettings,
        generator: torch.Generator,
        device: torch.device | str = "cpu",
        given: Given | None = None,
    ) -> None:
        """generator: of the networks' first weights, on the CPU. given: a scene to continue, or None.

        Raises ValueError without points, and for a scene that cannot be trained.
        """
        self.device = torch.device(device)
        if given is not None:
            self._go_on(beginning(given, photographs, settings), settings, generator)
            return
        start = first_anchors(photographs, settings)
        self.units, self.lattice, self.near, self.within = start.units, start.lattice, settings.start.near, start.within
        self.low_pass = settings.low_pass
        n = len(self.lattice)
        self.columns = Columns(settings.entropy.slices, OFFSETS)
        self.tables = {name: torch.zeros(n, self._width(name), device=self.device) for name in TABLES}
        self.first, self.second = ({name: torch.zeros_like(t) for name, t in self.tables.items()} for _ in range(2))
        self.tables["features"][:, :3] = torch.from_numpy(start.colours).float()
        self.tables["scalings"][:] = torch.from_numpy(np.log(start.sizes)).float()[:, None]
        self.tables["masks"].fill_(settings.masks.start)
        degree = None
        if settings.static:
            degree = DEGREE_MAX if settings.degree == CHOSEN else settings.degree
        self.networks = RenderNetworks(self.columns, generator, degree=degree).to(self.device)
        self.place()

    def _go_on(self, first: Beginning, settings: TrainSettings, generator: torch.Generator) -> None:
        """Takes the anchors and networks of a scene."""
        given, self.near = first.given, settings.start.near
        check_view_dependent(given.render)
        self.low_pass = given.render.low_pass
        self.units, self.lattice = first.units, first.lattice
        self.columns = Columns(settings.entropy.slices, given.cloud.masks.shape[1])
        self.tables = {name: self._moved(first.tables[name]) for name in TABLES}
        self.first, self.second = ({name: torch.zeros_like(t) for name, t in self.tables.items()} for _ in range(2))
        assert given.networks is not None
        self.networks = RenderNetworks(self.columns, generator, len(given.networks[RENDERING[0]][0][1]))
        self.networks.take(given.networks, self.units.length / given.render.distance_unit)
        self.networks.to(self.device)
        self.place()

    @property
    def count(self) -> int:
        """N."""
        return len(self.lattice)

    def _width(self, table: str) -> int:
        """How many columns a table has."""
        return {**self.columns.widths, "masks": self.columns.offsets}[table]

    def place(self) -> None:
        """Sets the positions; must be called after the lattice has changed."""
        self.position = self._moved(self.lattice * self.units.cell)
        self.measure()

    def _moved(self, values: NDArray[Any]) -> Tensor:
        """Values as float32 on the training's device."""
        return torch.from_numpy(values.astype(np.float32)).to(self.device)

    def leaves(self, rows: Tensor) -> dict[str, Tensor]:
        """Values of some anchors, as tensors of their own with gradients."""
        return {name: table.index_select(0, rows).requires_grad_() for name, table in self.tables.items()}

    def visible(self, camera: Camera) -> Tensor:
        """The anchors that a camera, in training units, may see: int64 [n], ascending (visible.visible)."""
        tables = self.tables
        if self.networks.degree is not None:
            scalings = tables["scalings"].clone()
            scalings[:, 3:] += self.stretch[:, None]
            tables = {**tables, "scalings": scalings}
        return visible(self.position, tables, self.units.length, camera, self.near)

    @torch.no_grad()
    def measure(self) -> None:
        """Sets `stretch`, which the networks of a static scene determine."""
        self.stretch = torch.zeros(self.count, device=self.device)
        if self.networks.degree is not None:
            _, covariance, _ = self.networks(self.tables["features"])
            self.stretch = covariance.reshape(self.count, -1, 7)[:, :, :3].amax(dim=(1, 2))

    def views(self, cameras: list[Camera]) -> Tensor:
        """How often each anchor is visible, over the mean of all: float32 [N], the weight in the masks' rule."""
        count = torch.zeros(self.count, device=self.device)
        for camera in cameras:
            count[self.visible(camera)] += 1
        return count / count.mean().clamp_min(1e-6)

    def gaussians(
        self, rows: Tensor, camera: Camera, values: dict[str, Tensor], masks: Tensor | None
    ) -> tuple[Tensor, Gaussians, Tensor]:
        """SPEC 14.3 or 14.6 in training units: the Gaussians of the anchors `rows`, with these values and masks.

        Returns the offsets that are drawn, int64 indices into [n, K]; their Gaussians; all opacities [n, K].
        """
        position, centre, static = self.position[rows], self._moved(camera.centre), self.networks.degree is not None
        inputs = values["features"]
        if not static:
            away = position - centre
            distance = away.norm(dim=1, keepdim=True).clamp_min(1e-12)
            inputs = torch.cat([inputs, away / distance, distance], dim=1)
        opacity, covariance, colour = self.networks(inputs)
        if masks is not None:
            opacity = opacity * masks
        flat = opacity.reshape(-1)
        chosen = torch.nonzero(flat.detach() > (ALPHA_MIN if static else 0))[:, 0]
        scalings = values["scalings"] - math.log(self.units.length)
        arrays = position, values["offsets"], scalings, covariance, colour
        mean, quaternion, lengths, rgb = spawn(chosen, self.columns.offsets, *arrays, centre if static else None)
        return chosen, (mean, quaternion, lengths, flat[chosen], rgb), opacity

    def keep(self, rows: I64) -> None:
        """Removes all other anchors. `place` must be called afterwards."""
        index = torch.from_numpy(rows).to(self.device)
        for table in (self.tables, self.first, self.second):
            for name in table:
                table[name] = table[name][index]
        self.lattice = self.lattice[rows]

    def add(self, lattice: I64, born: dict[str, Tensor]) -> None:
        """Adds anchors at cells [n, 3] with values [n, columns]. `place` must be called afterwards."""
        self.lattice = np.concatenate([self.lattice, lattice])
        for name, table in born.items():
            self.tables[name] = torch.cat([self.tables[name], table])
            for moments in (self.first, self.second):
                moments[name] = torch.cat([moments[name], torch.zeros_like(table)])

    def state(self) -> dict[str, Any]:
        """Tables, moments, the lattice and the networks with the steps of their grids, for a saved training."""
        tables = (("tables", self.tables), ("first", self.first), ("second", self.second))
        tensors = {f"{kind}.{name}": value for kind, named in tables for name, value in named.items()}
        networks = {f"networks.{name}": value for name, value in self.networks.state_dict().items()}
        return {**tensors, **networks, "lattice": torch.from_numpy(self.lattice), "stretch": self.stretch}

    def restore(self, state: Saved) -> None:
        """Restores the values of `state`. Raises ValueError."""
        self.lattice = state.tensor("lattice", (None, 3), torch.int64, -LATTICE_MAX, LATTICE_MAX).numpy()
        for kind, tables in (("tables", self.tables), ("first", self.first), ("second", self.second)):
            for name in TABLES:
                # The second moments are means of squares, thus at least 0.
                low, shape = 0 if kind == "second" else -math.inf, (self.count, self._width(name))
                tables[name] = state.tensor(f"{kind}.{name}", shape, low=low).to(self.device)
        state.module("networks.", self.networks)
        self.place()
        self.stretch = state.tensor("stretch", (self.count,)).to(self.device)
