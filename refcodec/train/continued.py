"""Training that continues from an existing scene instead of points."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..encoder.positions import choose_grid
from ..encoder.sizes import choose_slices
from ..photographs.photographs import PhotographSet
from ..statuses import UsageError, refusing
from .fit_input import Given, read_given
from .settings import PHASES, Phase, TrainSettings
from .settings_file import varied
from .start import LATTICE_MAX, Units, lattice_positions, scene_length
from .voxelise import default_voxel, short_mantissa

# The anchors of a trained scene are where they should be. The rate counts nearly from the beginning.
CONTINUED = (
    Phase("start", 0.0, {"masks": "on"}),
    Phase("rate", 0.02, {"rate": "on", "quantisation": "noise"}),
    Phase("rounding", 0.4, {"quantisation": "round"}),
    Phase("integers", 0.7, {"rate": "integers"}),
    Phase("weights", 0.8, {"weights": "grid"}),
    Phase("averaging", 0.9, {"averaging": "on"}),
)
# The logit of a masked offset: a share that is below any epsilon, whatever views see its anchor.
MASKED = -16.0
# The lattice of anchors without one is finer by this factor than the distance of neighbours.
FINER = 32
# An anchor is on the lattice if it is this near to a corner, in cells.
NEAR = 0.01
# Anchors are far out at so many times the distance within which this share of them is. Cells beyond LATTICE_MAX that
# are drawn in, because the mantissa of a cell is short.
FAR, SHARE, NEAR_END = 100, 0.95, 100


class BeginningError(ValueError):
    """A scene from which training cannot continue, regardless of the photographs."""


def read_beginning(folder: Path) -> Given:
    """Returns the scene to continue from. Raises UsageError if it is not a scene folder."""
    if not folder.is_dir():
        raise UsageError(f"{folder} is not a scene folder: training can continue only from one")
    with refusing(f"cannot continue training from {folder}"):
        return read_given(folder)


@dataclass(frozen=True, eq=False)
class Beginning:
    """The values from which training continues.

    lattice: int64 [N, 3]. tables: float32 [N, columns], as those of Scaffold; masks are logits. given: the scene.
    """

    units: Units
    lattice: NDArray[np.int64]
    tables: Mapping[str, NDArray[np.float32]]
    given: Given


def continued_settings(given: Given, settings: TrainSettings) -> TrainSettings:
    """Returns the settings of a training run from a scene: slices of its features, and no growth.

    Phases that the user has set do not change. Raises ValueError for values that cannot be trained.
    """
    slices = choose_slices(given.cloud.features.shape[1], settings.entropy.slices)
    continued = varied(settings, {"entropy.slices": slices})
    return replace(continued, phases=CONTINUED) if settings.phases == PHASES else continued


def beginning(given: Given, photographs: PhotographSet, settings: TrainSettings) -> Beginning:
    """Returns the anchors of a scene on a lattice, in the units of a training run.

    Of anchors in one cell the first is taken. Those farther out than fp16 reaches, such as a wrong one, are left out.
    Raises BeginningError.
    """
    cloud = given.cloud
    if given.networks is None or not len(cloud.positions):
        raise BeginningError("it has no anchors, or no rendering networks")
    if not settings.rate.lambda_r and not cloud.masks.all():
        raise BeginningError("it has masks, which a training with lambda 0 does not have")
    points = cloud.positions.astype(np.float64)
    length = scene_length(replace(photographs, points=points))
    grid = choose_grid(cloud.positions, _cell(given))
    cell = grid.scale_mantissa * 2.0**grid.scale_exponent
    origin = np.array(grid.origin, np.float64) * 2.0 ** (grid.scale_exponent - 24)
    exact = np.round((points - origin) / cell).astype(np.int64)
    reached = np.flatnonzero((np.abs(exact) <= LATTICE_MAX + NEAR_END).all(axis=1))
    lattice, rows = np.unique(lattice_positions(exact[reached]).astype(np.int64), axis=0, return_index=True)
    rows = reached[rows]
    tables = {
        "features": cloud.features[rows],
        "offsets": cloud.offsets[rows].reshape(len(rows), -1),
        "scalings": cloud.scalings[rows],
        "masks": np.where(cloud.masks[rows], settings.masks.start, MASKED).astype(np.float32),
    }
    return Beginning(Units(grid, origin, length, cell / length), lattice, tables, given)


def _cell(given: Given) -> float:
    """Returns the edge of the lattice's cells, in world units."""
    positions = given.cloud.positions
    away = np.abs(positions.astype(np.float64) - np.median(positions, axis=0)).max(axis=1)
    # One anchor far out does not make all cells coarse.
    extent = min(float(away.max()), FAR * float(np.quantile(away, SHARE)))
    voxel = given.voxel
    if given.grid is not None:
        unit = given.grid.scale_mantissa * 2.0**given.grid.scale_exponent
        away = (positions - np.array(given.grid.origin) * 2.0 ** (given.grid.scale_exponent - 24)) / unit
        voxel = unit if np.abs(away - np.rint(away)).max() < NEAR else None
    least = short_mantissa(math.nextafter(extent / LATTICE_MAX, math.inf)) if extent else 0.0
    return max(voxel or short_mantissa(default_voxel(positions) / FINER), least)
