"""The start of training: its units, its lattice, and the first anchors on it.

Training has its own units, in which the scene has a size of about one. Thus nothing depends on the unit of the cameras.
`Units` relates them to the world. The file states them by its distance_unit and its scalings.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ..bitstream.header import PositionGrid
from ..encoder.positions import choose_grid
from ..photographs.photographs import PhotographSet
from ..rendering.camera import Camera
from .behind import points_behind
from .hull import carved
from .settings import TrainSettings
from .voxelise import default_voxel, short_mantissa

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

# Random points for each anchor that is requested: enough for every voxel of the surface to get some.
POINTS_EACH = 4
# Cells of the lattice that fp16 can reach.
LATTICE_MAX = 60000


@dataclass(frozen=True, eq=False)
class Units:
    """The training units.

    grid: the lattice's cells in the world (SPEC 6.4). origin: of the lattice, float64 [3], world. length: of a training
    unit, in the world. cell: edge of the lattice, in training units.
    """

    grid: PositionGrid
    origin: F64
    length: float
    cell: float

    def camera(self, camera: Camera) -> Camera:
        """A camera of the world in training units."""
        return replace(camera, translation=(camera.translation + camera.rotation @ self.origin) / self.length)


@dataclass(frozen=True, eq=False)
class FirstAnchors:
    """The anchors of the beginning. within: given "points", a "hull" (hull.py), or a "cube", and must find the scene.

    lattice: int64 [N, 3], cells. colours: [N, 3], from -1 to 1. sizes: [N], world.
    """

    units: Units
    lattice: I64
    colours: F64
    sizes: F64
    within: str


def scene_length(photographs: PhotographSet) -> float:
    """The median distance of the cameras from the median of the points: about one scene, regardless of its unit.

    It is a number of float32, as SPEC 5.5 has it.
    """
    middle = np.median(photographs.points, axis=0)
    away = [float(np.linalg.norm(p.camera.centre - middle)) for p in photographs.train]
    return float(np.float32(np.median(away))) or 1.0


def choose_voxel(points: F64, anchors: int) -> float:
    """The edge of voxels of which the points fill about `anchors`.

    If there are fewer points, it is the median distance of neighbours.
    """
    if len(np.unique(points, axis=0)) <= anchors:
        return default_voxel(points.astype(np.float32))
    extent = float(np.ptp(points, axis=0).max()) or 1.0
    low, high = 1e-5 * extent, extent
    for _ in range(40):
        middle = math.sqrt(low * high)
        if len(np.unique(np.round(points / middle), axis=0)) > anchors:
            low = middle
        else:
            high = middle
    return high


def asked_for(photographs: PhotographSet, settings: TrainSettings) -> int:
    """The requested number of first anchors, which is approximate; 0: one per voxel.

    Photographs of more pixels show more of a scene, and the number of random points is free. Given points are few: if
    most of them became anchors, the lattice would be too fine for the file.
    """
    start = settings.start
    if start.anchors or not start.least or not photographs.random:
        return start.anchors or start.least
    return max(min(photographs.pixels // start.pixels, settings.growth.most), start.least)


def lattice_positions(lattice: I64) -> NDArray[np.float16]:
    """SPEC 6.4: cells as fp16, which is exact up to 2048 and coarser beyond."""
    return np.clip(lattice, -LATTICE_MAX, LATTICE_MAX).astype(np.float16)


def first_anchors(photographs: PhotographSet, settings: TrainSettings) -> FirstAnchors:
    """Scaffold-GS: an anchor in each voxel that has points. Raises ValueError without points.

    An anchor's colour is that of the points around it, its size the distance of its neighbours. Random points are
    drawn again within the visual hull (hull.carved). Given points get others behind them (behind.points_behind).
    """
    if not len(photographs.points):
        raise ValueError("there are no points to begin with")
    start, anchors = settings.start, asked_for(photographs, settings)
    points, seen, cells, within = photographs.points, photographs.colours, start.cells, "points"
    if photographs.random:
        points, seen = carved(photographs, max(start.drawn, POINTS_EACH * anchors), settings.seed)
        cells, within = start.random_cells, "cube" if points is photographs.points else "hull"
    length = scene_length(photographs)
    voxel = start.voxel or (choose_voxel(points, anchors) if anchors else default_voxel(points.astype(np.float32)))
    grid = choose_grid(points.astype(np.float32), short_mantissa(voxel / cells))
    if photographs.opaque and not photographs.random and start.behind > 1:
        given = anchors or len(points)
        most = min(given, max(settings.growth.most - given, 0))
        more = points_behind(photographs, start.behind, most, settings.seed)
        points, seen = np.concatenate([points, more[0]]), np.concatenate([seen, more[1]])
    origin = np.array(grid.origin, np.float64) * 2.0 ** (grid.scale_exponent - 24)
    units = Units(grid, origin, length, grid.scale_mantissa * 2.0**grid.scale_exponent / length)
    away = (points - origin) / (units.cell * length)
    lattice = np.unique(np.round(away / cells).astype(np.int64), axis=0) * cells
    lattice = np.unique(lattice_positions(lattice).astype(np.int64), axis=0)
    n = len(lattice)
    distance = cKDTree(lattice).query(lattice, min(start.neighbours + 1, n))[0].reshape(n, -1)[:, 1:]
    spread = np.sqrt((distance**2).mean(axis=1)) if distance.shape[1] else np.ones(n)
    spread = np.clip(spread, np.median(spread) * start.smallest, np.quantile(spread, start.largest))
    near = cKDTree(away).query(lattice, min(start.colours, len(points)))[1].reshape(n, -1)
    colours = seen[near].mean(axis=1) / 255 * 2 - 1
    sizes = np.maximum(spread, start.least_cells) * units.cell * length
    return FirstAnchors(units, lattice, colours, sizes, within)
