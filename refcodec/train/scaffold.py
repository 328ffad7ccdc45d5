"""Scaffold-GS (Lu et al. 2024): anchors on a lattice, each with a feature, offsets and scalings, and three networks that make Gaussians
of them for a camera. Growing and pruning follow where the image asks for more.

Training works in units of its own, in which the scene has a size of about one, so that nothing depends on the unit of the photographs'
cameras: Units says what they are in the world, and so does the file, by its distance_unit and its scalings.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from torch import Tensor, nn
from torch.nn import functional

from ..bitstream.header import PositionGrid
from ..bitstream.networks import Layer
from ..encoder.positions import choose_grid
from ..encoder.weights import rendering_exponent
from ..photographs.photographs import PhotographSet
from ..render.camera import Camera
from .rate_model import grid_through
from .spawn import Spawn
from .voxelise import default_voxel, short_mantissa

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

FEATURES, OFFSETS, SCALINGS, RENDER_WIDTH = 50, 10, 6, 50
# Columns of each table of the anchors.
COLUMNS = {"features": FEATURES, "offsets": 3 * OFFSETS, "scalings": SCALINGS, "masks": OFFSETS}
# Edges of the lattices on which anchors grow, in cells of the finest; they begin on the second.
GROWTH_EDGES = (4, 2, 1)
START_EDGE = 2
# Scaffold-GS: the gradient of the projected centre, in normalised device units, above which an offset grows; and the least opacity, summed
# over an anchor's offsets, of one that stays.
GROWTH_GRADIENT, OPACITY_MIN = 2e-4, 0.005
# Times that an offset, or an anchor, was seen before it is judged.
OFFSET_VIEWS, ANCHOR_VIEWS = 10, 25
# Deviations at which an alpha of one has fallen to 1/255; what reaches are multiplied by, for values that rounding moves; pixels around
# an image, for the low-pass filter.
EXTENT, REACH, EDGE = 3.33, 1.05, 4.0
# Nearest depth drawn, in training units.
NEAR = 0.02
# A mask's logit in the beginning: a share of 0.73.
MASK_START = 1.0
# fp16 is exact for integers up to 2^11 (SPEC 6.4).
_LATTICE_MAX = 60000


@dataclass(frozen=True, eq=False)
class Units:
    """What training units are: grid: the lattice's cells in the world (SPEC 6.4); origin: float64 [3], world; length: of a training
    unit, in the world; cell: edge of the lattice, in training units."""

    grid: PositionGrid
    origin: F64
    length: float
    cell: float

    def camera(self, camera: Camera) -> Camera:
        """A camera of the world in training units."""
        return replace(camera, translation=(camera.translation + camera.rotation @ self.origin) / self.length)


def scene_length(photographs: PhotographSet) -> float:
    """The median distance of the cameras from the median of the points: about one scene, whatever its unit. An f32, as SPEC 5.5 has it."""
    middle = np.median(photographs.points, axis=0)
    away = [float(np.linalg.norm(p.camera.centre - middle)) for p in photographs.train]
    return float(np.float32(np.median(away))) or 1.0


def choose_voxel(points: F64, anchors: int) -> float:
    """The edge of voxels of which the points fill about `anchors`; fewer if there are fewer points."""
    extent = float(np.ptp(points, axis=0).max()) or 1.0
    low, high = 1e-5 * extent, extent
    for _ in range(40):
        middle = math.sqrt(low * high)
        if len(np.unique(np.round(points / middle), axis=0)) > anchors:
            low = middle
        else:
            high = middle
    return high


def lattice_positions(lattice: I64) -> NDArray[np.float16]:
    """SPEC 6.4: cells as fp16, which is exact up to 2048 and coarser beyond."""
    return np.clip(lattice, -_LATTICE_MAX, _LATTICE_MAX).astype(np.float16)


class RenderNetworks(nn.Module):
    """SPEC 14.3's three networks of one hidden layer each, as torch starts linear layers. Inputs: feature, direction, distance."""

    def __init__(self, generator: torch.Generator) -> None:
        super().__init__()
        self.inputs = FEATURES + 4
        outputs = {"opacity": OFFSETS, "covariance": 7 * OFFSETS, "colour": 3 * OFFSETS}
        for name, width in outputs.items():
            for layer, (fan_in, out) in enumerate(((self.inputs, RENDER_WIDTH), (RENDER_WIDTH, width))):
                bound = 1 / math.sqrt(fan_in)
                weight, bias = (
                    nn.Parameter((torch.rand(shape, generator=generator) * 2 - 1) * bound)
                    for shape in ((out, fan_in), (out,))
                )
                self.register_parameter(f"{name}_{layer}_weight", weight)
                self.register_parameter(f"{name}_{layer}_bias", bias)
                self.register_buffer(f"{name}_{layer}_step", torch.ones(()))
        self.gridded = False

    def _values(self) -> dict[str, Tensor]:
        """The parameters, each layer's on its grid if there is one."""
        p: dict[str, Tensor] = dict(self.named_parameters())
        if not self.gridded:
            return p
        return {
            name: grid_through(value, self.get_buffer(f"{name.rpartition('_')[0]}_step")) for name, value in p.items()
        }

    @torch.no_grad()
    def set_grid(self, bits: int) -> None:
        """From now on the weights and biases of each layer are multiples of a power of two, quantise.rendering_exponent's."""
        for name, value in self.named_parameters():
            layer, _, kind = name.rpartition("_")
            if kind == "weight":
                self.get_buffer(f"{layer}_step").fill_(2.0 ** -rendering_exponent(value.numpy(), bits))
        self.gridded = True

    def forward(self, inputs: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """inputs [n, 54]. Opacities before masks [n, K], covariance [n, 7 K], colour [n, 3 K] before its logistic function."""
        p = self._values()
        names = ("opacity", "covariance", "colour")
        weight, bias = (torch.cat([p[f"{name}_0_{kind}"] for name in names]) for kind in ("weight", "bias"))
        hidden = functional.relu(functional.linear(inputs, weight, bias)).split(RENDER_WIDTH, dim=1)
        opacity, covariance, colour = (
            functional.linear(h, p[f"{name}_1_weight"], p[f"{name}_1_bias"])
            for h, name in zip(hidden, names, strict=True)
        )
        return torch.tanh(opacity), covariance, colour

    def layers(self) -> dict[str, list[Layer]]:
        """SPEC 5.8's layers."""
        p = {name: value.detach().numpy().copy() for name, value in self._values().items()}
        return {
            name: [(p[f"{name}_{i}_weight"], p[f"{name}_{i}_bias"]) for i in range(2)]
            for name in ("opacity", "covariance", "colour")
        }


class Scaffold:
    """The anchors of a scene in training, and its rendering networks.

    tables: float32 [N, columns] each: features, offsets (in units of exp(scalings[:3])), scalings (natural logarithms of world lengths),
    masks (logits). first, second: their moments (adam_rows). lattice: int64 [N, 3], cells from the grid's origin;
    position: float32 [N, 3], training units.
    """

    def __init__(self, photographs: PhotographSet, anchors: int, generator: torch.Generator) -> None:
        """anchors: about how many there are at first, or 0 for voxels of the points' median distance. Raises ValueError without points."""
        if not len(photographs.points):
            raise ValueError("there are no points to begin with")
        points, colours = photographs.points, photographs.colours
        length = scene_length(photographs)
        voxel = choose_voxel(points, anchors) if anchors else default_voxel(points.astype(np.float32))
        cell = short_mantissa(voxel / START_EDGE)
        grid = choose_grid(points.astype(np.float32), cell)
        origin = np.array(grid.origin, np.float64) * 2.0 ** (grid.scale_exponent - 24)
        self.units = Units(grid, origin, length, grid.scale_mantissa * 2.0**grid.scale_exponent / length)
        away = (points - origin) / (self.units.cell * length)
        lattice = np.unique(np.round(away / START_EDGE).astype(np.int64), axis=0) * START_EDGE
        self.lattice = np.unique(lattice_positions(lattice).astype(np.int64), axis=0)
        n = len(self.lattice)
        self.tables = {name: torch.zeros(n, columns) for name, columns in COLUMNS.items()}
        self.first, self.second = ({name: torch.zeros_like(t) for name, t in self.tables.items()} for _ in range(2))
        # Each anchor begins with the colour of the points around it, and with the distance of its neighbours as its size.
        tree = cKDTree(self.lattice)
        distance = tree.query(self.lattice, min(4, n))[0].reshape(n, -1)[:, 1:]
        spread = np.sqrt((distance**2).mean(axis=1)) if distance.shape[1] else np.ones(n)
        spread = np.clip(spread, np.median(spread) * 0.1, np.quantile(spread, 0.99))
        near = cKDTree(away).query(self.lattice, min(4, len(points)))[1].reshape(n, -1)
        self.tables["features"][:, :3] = torch.from_numpy(colours[near].mean(axis=1) / 255 * 2 - 1).float()
        size = np.log(np.maximum(spread, 0.5) * self.units.cell * length)
        self.tables["scalings"][:] = torch.from_numpy(size).float()[:, None]
        self.tables["masks"].fill_(MASK_START)
        self.networks = RenderNetworks(generator)
        self.forget()

    @property
    def count(self) -> int:
        """N."""
        return len(self.lattice)

    def forget(self) -> None:
        """Starts the statistics of growing and pruning anew; to be called when the anchors have changed."""
        n = self.count
        self.position = torch.from_numpy((self.lattice * self.units.cell).astype(np.float32))
        # Sums of gradients of the projected centres and how often each was drawn; sums of opacities and how often each anchor was seen.
        self.gradient, self.drawn = np.zeros((n, OFFSETS), np.float32), np.zeros((n, OFFSETS), np.float32)
        self.opacity, self.seen = np.zeros(n, np.float32), np.zeros(n, np.float32)

    def visible(self, camera: Camera) -> Tensor:
        """The anchors that have a Gaussian which a camera, in training units, may see: int64 [n], ascending.

        None is left out that could be drawn: an anchor reaches as far as its farthest offset and the longest axes of its Gaussians.
        """
        rotation = torch.from_numpy(camera.rotation.astype(np.float32))
        p = self.position @ rotation.T + torch.from_numpy(camera.translation.astype(np.float32))
        lengths = torch.exp(self.tables["scalings"] - math.log(self.units.length))
        reach = self.tables["offsets"].reshape(-1, OFFSETS, 3).abs().amax(dim=1).mul_(lengths[:, :3]).norm(dim=1)
        reach = REACH * (reach + EXTENT * lengths[:, 3:].amax(dim=1))
        depth = p[:, 2]
        inside = depth > NEAR - reach
        for axis, size, focal, middle in (
            (0, camera.width, camera.fx, camera.cx),
            (1, camera.height, camera.fy, camera.cy),
        ):
            # A sphere against the planes through the eye and the image's edges, some pixels farther out.
            half, skew = (size / 2 + EDGE) / focal, (size / 2 - middle) / focal
            away = (p[:, axis] - skew * depth).abs() - half * depth
            inside &= away < reach * math.sqrt(1 + (half + abs(skew)) ** 2)
        return torch.nonzero(inside)[:, 0]

    def views(self, cameras: list[Camera]) -> Tensor:
        """How often each anchor is visible, over the mean of all: float32 [N], the frequency of the masks' rule."""
        count = torch.zeros(self.count)
        for camera in cameras:
            count[self.visible(camera)] += 1
        return count / count.mean().clamp_min(1e-6)

    def gaussians(
        self, rows: Tensor, camera: Camera, features: Tensor, offsets: Tensor, scalings: Tensor, masks: Tensor | None
    ) -> tuple[Tensor, tuple[Tensor, Tensor, Tensor, Tensor, Tensor], Tensor]:
        """SPEC 14.3 in training units: what a camera sees of the anchors `rows`, whose attributes are given, [n, ...].

        Returns the offsets that are drawn, int64 indices into [n, K]; their mean, quaternion, lengths, opacity and colour; all
        opacities [n, K].
        """
        position = self.position[rows]
        away = position - torch.from_numpy(camera.centre.astype(np.float32))
        distance = away.norm(dim=1, keepdim=True).clamp_min(1e-12)
        opacity, covariance, colour = self.networks(torch.cat([features, away / distance, distance], dim=1))
        if masks is not None:
            opacity = opacity * masks
        flat = opacity.reshape(-1)
        chosen = torch.nonzero(flat.detach() > 0)[:, 0]
        local = scalings - math.log(self.units.length)
        mean, quaternion, lengths, rgb = Spawn.apply(chosen, OFFSETS, position, offsets, local, covariance, colour)
        return chosen, (mean, quaternion, lengths, flat[chosen], rgb), opacity

    def observe(
        self, rows: NDArray[np.int64], chosen: NDArray[np.int64], opacity: Tensor, screen: NDArray[np.float32]
    ) -> None:
        """Adds a step's statistics: opacity [n, K] of the anchors `rows`; screen: Gradients.screen of the drawn offsets `chosen`."""
        anchor, offset = rows[chosen // OFFSETS], chosen % OFFSETS
        drawn = screen > 0
        self.gradient[anchor[drawn], offset[drawn]] += screen[drawn]
        self.drawn[anchor[drawn], offset[drawn]] += 1
        self.opacity[rows] += opacity.detach().clamp_min(0).sum(dim=1).numpy()
        self.seen[rows] += 1

    def keep(self, rows: NDArray[np.int64]) -> None:
        """Leaves these anchors alone."""
        index = torch.from_numpy(rows)
        for table in (self.tables, self.first, self.second):
            for name in table:
                table[name] = table[name][index]
        self.lattice = self.lattice[rows]

    def grow(self, most: int, generator: torch.Generator) -> None:
        """Scaffold-GS: new anchors where offsets have large gradients, on coarser lattices for larger ones; transparent anchors go.
        most: anchors that there may be."""
        mean = self.gradient / np.maximum(self.drawn, 1)
        judged = self.drawn >= OFFSET_VIEWS
        spread = np.exp(self.tables["scalings"].numpy()[:, None, :3] - math.log(self.units.length)) / self.units.cell
        centre = self.lattice[:, None] + self.tables["offsets"].numpy().reshape(-1, OFFSETS, 3) * spread
        centre, flat = centre.reshape(-1, 3), (mean * judged).reshape(-1)
        found, owners = [self.lattice], []
        sizes = []
        for level, edge in enumerate(GROWTH_EDGES):
            lucky = torch.rand(len(flat), generator=generator).numpy() > 0.5 ** (level + 1)
            grows = (flat > GROWTH_GRADIENT * 2**level) & lucky & (np.abs(centre).max(axis=1) < _LATTICE_MAX)
            if not grows.any():
                continue
            cells, first = np.unique(np.round(centre[grows] / edge).astype(np.int64), axis=0, return_index=True)
            taken = {tuple(c) for c in np.round(np.concatenate(found) / edge).astype(np.int64).tolist()}
            free = np.array([tuple(c) not in taken for c in cells.tolist()], bool)
            found.append(cells[free] * edge)
            owners.append(np.flatnonzero(grows)[first[free]] // OFFSETS)
            sizes.append(np.full(int(free.sum()), edge))
        stays = np.flatnonzero(~((self.seen > ANCHOR_VIEWS) & (self.opacity < OPACITY_MIN * self.seen)))
        new = lattice_positions(np.concatenate([np.zeros((0, 3), np.int64), *found[1:]])).astype(np.int64)
        owner = np.concatenate([np.zeros(0, np.int64), *owners])
        size = np.concatenate([np.zeros(0), *sizes])
        room = max(most - len(stays), 0)
        if room < len(new):
            chosen = torch.randperm(len(new), generator=generator).numpy()[:room]
            new, owner, size = new[chosen], owner[chosen], size[chosen]
        born = {name: table[torch.from_numpy(owner)].clone() for name, table in self.tables.items()}
        born["offsets"].zero_()
        born["scalings"][:] = torch.from_numpy(np.log(size * self.units.cell * self.units.length)).float()[:, None]
        born["masks"].fill_(MASK_START)
        self.keep(stays)
        self.lattice = np.concatenate([self.lattice, new])
        for name, table in born.items():
            self.tables[name] = torch.cat([self.tables[name], table])
            for moments in (self.first, self.second):
                moments[name] = torch.cat([moments[name], torch.zeros_like(table)])
        self.forget()
