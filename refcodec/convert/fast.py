"""A static scene (SPEC.md 9.4) from plain 3D Gaussians, without a training of the scene: transform coding.

Each Gaussian becomes an anchor at its mean. The rendering networks are linear decoders (linear.py) of the other
numbers, in steps that suit their importance. Only the entropy model is learned.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray

from ..bitstream.dimensions import RENDERING, STATIC
from ..bitstream.header import PositionGrid, RenderInfo
from ..bitstream.limits import MAIN, PROFILES
from ..bitstream.networks import Layer
from ..bitstream.positions import CELL_LEVELS
from ..bitstream.scene import Scene
from ..encoder.cloud import AnchorCloud
from ..encoder.positions import choose_grid
from ..render.camera import Camera, spread_cameras
from ..render.rasterise import Settings
from ..train.fit import FitResult, fit
from ..train.fit_input import Given
from ..train.settings import EntropySettings, FitSettings
from ..train.voxelise import short_mantissa
from .importance import COLOUR, LENGTHS, LOGIT, TURN, importance, numbers, splats_of
from .linear import Linear, hidden_units, network
from .splats import drawn

F32, F64, I64 = NDArray[np.float32], NDArray[np.float64], NDArray[np.int64]
Progress = Callable[[str, int, int], None]

# The most classes of anchors by importance. More of them save no bytes (own measurement).
CLASSES = 4
# Below this opacity, a Gaussian is not drawn (SPEC 14.5).
OPACITY_LEAST = 1 / 255
# A Gaussian is dropped if its absence costs less than this many bits: that many are saved, but absences add up.
BITS = 12
# The steps of positions, relative to those of equal slope: an error moves whole Gaussians, and derivatives of pictures
# underestimate it (own measurement).
POSITION = 0.5
# The largest steps, by kind: derivatives say nothing about larger errors.
STEP_MAX = {"lengths": 0.5, "logit": 1.5, "turn": 0.25, "colour": 1.0}
KINDS = {"lengths": LENGTHS, "logit": LOGIT, "turn": TURN, "colour": COLOUR}
# Features of slices before those of colours: the class, lengths and logit, turn.
SLICES = (1, 4, 3)
# The search for the quality: views, renderings, and the largest difference in dB that ends it. The quality falls by
# about SLOPE dB where lambda is tenfold.
JUDGES, TRIES, NEAR, SLOPE = 8, 6, 0.05, 9.0
# Neighbouring cells, nearest first, for anchors whose cell is taken.
AROUND = np.array(sorted(np.ndindex(3, 3, 3), key=lambda c: sum((i - 1) ** 2 for i in c))[1:]) - 1
MOVES = 8


@dataclass(frozen=True, eq=False)
class Measured:
    """Gaussians to code, with what errors in them cost.

    mean [n, 3], table [n, numbers] (importance.py); and the importance of each number, of means and of the table.
    """

    mean: F32
    table: F64
    by_mean: F64
    by_number: F64


@dataclass(frozen=True, eq=False)
class Coded:
    """Symbols of some Gaussians, and the networks that decode them.

    positions: float32 [n, 3], on the lattice. features: int64 [n, F]. table: the decoded numbers, [n, numbers].
    """

    positions: F32
    grid: PositionGrid
    features: I64
    networks: dict[str, list[Layer]]
    table: F64


def measured(
    arrays: Mapping[str, F32], cameras: Sequence[Camera], settings: Settings, progress: Progress
) -> Measured:
    """Returns the Gaussians that can be seen at all, measured in the pictures of some cameras.

    arrays: as splat_files.read_splats returns them.
    """
    seen = 1 / (1 + np.exp(-arrays["opacity"].astype(np.float64))) >= OPACITY_LEAST
    seen |= ~seen.any()
    chosen = {name: values[seen] for name, values in arrays.items()}
    table = numbers(chosen)
    return Measured(chosen["mean"], table, *importance(chosen["mean"], table, cameras, settings, progress))


# --- symbols ----------------------------------------------------------------------------------------------------------


def _classes(weights: Mapping[str, F64], most: int) -> I64:
    """Returns the class of each Gaussian, 0 for the most important ones, int64 [n]. weights: [n], by kind."""
    shares = [np.log2(np.maximum(w / (w.mean() or 1.0), 1e-6)) for name, w in weights.items() if name != "logit"]
    place = np.mean(shares, axis=0)
    centres = np.quantile(place, (np.arange(most, 0, -1) - 0.5) / most)
    found = np.zeros(len(place), np.int64)
    for _ in range(20):
        found = np.abs(place[:, None] - centres).argmin(axis=1)
        centres = np.array([place[found == k].mean() if (found == k).any() else c for k, c in enumerate(centres)])
    # Without the empty ones.
    return np.unique(found, return_inverse=True)[1].reshape(-1)


def _step(rate: float, weight: F64 | float) -> F64:
    """Returns the step whose squared error, step^2 / 12 weight, has the slope -rate against its bits."""
    slope: F64 = np.sqrt(6 * rate / math.log(2) / np.maximum(weight, 1e-300))
    return slope


def _lattice(given: Measured, rate: float) -> tuple[PositionGrid, F32]:
    """Returns the grid of positions, and the positions on it, float32 [n, 3], no two in a cell as far as possible."""
    mean = given.mean.astype(np.float64)
    # The few Gaussians far out do not decide where the lattice is exact.
    core = mean[np.abs(mean - np.median(mean, axis=0)).max(axis=1).argsort()[: math.ceil(0.95 * len(mean))]]
    step = float(POSITION * _step(rate, given.by_mean.mean()))
    low, high = mean.min(axis=0), mean.max(axis=0)
    reach = float(np.abs(np.stack([low, high]) - core.mean(axis=0)).max())
    # All cells are within the tree, and none is much finer than float32 at this distance from the world's origin.
    floor = max(reach / (0.4 * 2**CELL_LEVELS), float(np.abs(mean).max()) * 2.0**-21) or 1.0
    voxel = short_mantissa(min(max(step, floor), max(reach, floor)))
    grid = choose_grid(core.astype(np.float32), voxel)
    unit = grid.scale_mantissa * 2.0**grid.scale_exponent
    origin = np.array([o * 2.0 ** (grid.scale_exponent - 24) for o in grid.origin])
    exact = (mean - origin) / unit

    def rounded(cells: F64) -> I64:
        return np.rint(cells).astype(np.float16).astype(np.int64)

    cell = rounded(exact)
    # The most important ones choose first.
    order = np.argsort(-given.by_mean.sum(axis=1), kind="stable")
    cell, exact = cell[order], exact[order]
    for offset in (AROUND[i] for i in range(MOVES)):
        first = np.unique(cell, axis=0, return_index=True)[1]
        late = np.ones(len(cell), bool)
        late[first] = False
        if not late.any():
            break
        # Towards the exact position first.
        side = np.where(exact[late] >= cell[late], 1, -1)
        cell[late] = rounded(cell[late] + side * np.abs(offset))
    back = np.empty_like(cell)
    back[order] = cell
    return grid, (origin + unit * back).astype(np.float32)


def coded(given: Measured, rate: float, degree_outputs: int) -> Coded:
    """Returns the symbols at a rate: the error of pictures, mean squared, that a bit is worth.

    degree_outputs: 3 for each harmonic.
    """
    absence = given.by_number[:, LOGIT.start] * (1 + np.exp(given.table[:, LOGIT.start])) ** 2
    kept = absence >= BITS * rate
    kept |= ~kept.any()
    given = Measured(given.mean[kept], given.table[kept], given.by_mean[kept], given.by_number[kept])
    weights = {name: given.by_number[:, columns].mean(axis=1) for name, columns in KINDS.items()}
    table, n = given.table, len(given.table)
    widths = PROFILES[MAIN].render_width[1]
    most = max(k for k in range(1, CLASSES + 1) if hidden_units(k, max(6, degree_outputs)) <= widths)
    chosen = _classes(weights, most)
    classes = int(chosen.max()) + 1
    steps, basis, middle = {}, {}, {}
    for name, columns in KINDS.items():
        values, weight = table[:, columns], weights[name] + 1e-300
        each = np.array([weight[chosen == k].mean() for k in range(classes)])
        steps[name] = np.minimum(_step(rate, each), STEP_MAX[name])
        middle[name] = (values * weight[:, None]).sum(axis=0) / weight.sum()
        basis[name] = np.eye(values.shape[1])
        if name == "colour":
            centred = values - middle[name]
            _, vectors = np.linalg.eigh((centred * weight[:, None]).T @ centred / weight.sum())
            basis[name] = vectors[:, ::-1]
    # w of the quaternion is 1.
    whole = np.zeros((7, 6))
    whole[:3, :3], whole[4:, 3:] = basis["lengths"], basis["turn"]
    parts = {
        "opacity": (["logit"], basis["logit"], middle["logit"]),
        "covariance": (["lengths", "turn"], whole, np.concatenate([middle["lengths"], [1.0], middle["turn"]])),
        "colour": (["colour"], basis["colour"], middle["colour"]),
    }
    sizes = {name: KINDS_FEATURES[name] if name != "colour" else degree_outputs for name in KINDS}
    count = 1 + sum(sizes.values())
    starts = dict(zip(KINDS, np.cumsum([1, *sizes.values()])[:-1].tolist(), strict=True))
    width = hidden_units(classes, max(6, degree_outputs))
    features, decoded = np.zeros((n, count), np.int64), table.copy()
    features[:, 0] = chosen
    networks = {}
    for name in RENDERING:
        kinds, matrix, centre = parts[name]
        places = np.concatenate([np.arange(starts[k], starts[k] + sizes[k]) for k in kinds])
        each = np.concatenate([np.repeat(steps[k][:, None], sizes[k], axis=1) for k in kinds], axis=1)
        networks[name], maps = network(each, matrix, centre, places, count, width)
        outputs = np.concatenate([np.arange(KINDS[k].start, KINDS[k].start + sizes[k]) for k in kinds])
        rows = np.arange(len(matrix)) if name != "covariance" else np.array([0, 1, 2, 4, 5, 6])
        for k in range(classes):
            mine = np.flatnonzero(chosen == k)
            symbols = _symbols(table[np.ix_(mine, outputs)], maps, k, rows)
            features[np.ix_(mine, places)] = symbols
            decoded[np.ix_(mine, outputs)] = symbols @ maps.matrix[k][rows].T + maps.middle[rows]
    grid, positions = _lattice(given, rate)
    return Coded(positions, grid, features, networks, decoded)


KINDS_FEATURES = {"lengths": 3, "logit": 1, "turn": 3}


def _symbols(values: F64, maps: Linear, k: int, rows: I64) -> I64:
    """Returns the symbols of a class that are nearest to values, in least squares."""
    inverse = np.linalg.pinv(maps.matrix[k][rows])
    return np.rint((values - maps.middle[rows]) @ inverse.T).clip(-maps.most[k], maps.most[k]).astype(np.int64)


# --- quality ----------------------------------------------------------------------------------------------------------


class Judge:
    """Pictures of the given Gaussians by some cameras, to compare with."""

    def __init__(self, given: Measured, cameras: Sequence[Camera], settings: Settings) -> None:
        rows = np.unique(np.linspace(0, len(cameras) - 1, JUDGES).round().astype(int))
        self.cameras, self.settings = [cameras[i] for i in rows], settings
        self.truth = self._drawn(given.mean, given.table)

    def _drawn(self, mean: F32, table: F64) -> list[F64]:
        splats = splats_of(torch.from_numpy(mean), torch.from_numpy(table.astype(np.float32)))
        with torch.no_grad():
            images = [drawn(splats, camera, self.settings)[0] for camera in self.cameras]
        return [image.clamp(0, 1).double().numpy() for image in images]

    def psnr(self, found: Coded) -> float:
        """Returns the mean PSNR of the pictures of decoded Gaussians, in dB, at most 100."""
        pairs = zip(self._drawn(found.positions, found.table), self.truth, strict=True)
        return float(np.mean([-10 * np.log10(max(np.square(a - b).mean(), 1e-10)) for a, b in pairs]))


def search(given: Measured, psnr: float, judge: Judge, progress: Progress) -> tuple[Coded, float]:
    """Returns the symbols whose pictures have a PSNR, in dB, as nearly as a few tries find them; and their PSNR."""
    outputs = given.table.shape[1] - COLOUR.start
    # The squared error of each number is that of its step.
    rate = 10 ** (-psnr / 10) * 2 * math.log(2) / given.table.size
    tries: list[tuple[float, float]] = []
    best: tuple[Coded, float] | None = None
    for number in range(TRIES):
        found = coded(given, rate, outputs)
        reached = judge.psnr(found)
        progress("search", number + 1, TRIES)
        if best is None or abs(reached - psnr) < abs(best[1] - psnr):
            best = found, reached
        if abs(reached - psnr) <= NEAR:
            break
        tries.append((math.log10(rate), reached))
        slope = SLOPE
        if len(tries) > 1:
            (a, p), (b, q) = tries[-2:]
            slope = min(max((p - q) / ((b - a) or 1.0), SLOPE / 3), SLOPE * 3)
        rate *= 10 ** min(max((reached - psnr) / slope, -1.5), 1.5)
    assert best is not None
    return best


# --- the scene --------------------------------------------------------------------------------------------------------


def fitted(found: Coded, render: RenderInfo, cameras: Sequence[Camera], steps: int, progress: Progress) -> FitResult:
    """Returns the scene, with an entropy model of some steps of training. render_model is set here."""
    n, count = found.features.shape
    cloud = AnchorCloud(
        found.positions,
        found.features.astype(np.float32),
        np.zeros((n, 6), np.float32),
        np.zeros((n, 1, 3), np.float32),
        np.ones((n, 1), bool),
    )
    given = Given(
        cloud,
        grid=found.grid,
        networks=found.networks,
        render=replace(render, render_model=STATIC),
        cameras=tuple(spread_cameras(cameras, 16)) if cameras else (),
        base_step=(1.0, 1.0, 1.0),
    )
    colours = count - sum(SLICES)
    slices = (*SLICES, 3, *([colours - 3] if colours > 3 else []))
    settings = FitSettings(steps=steps, entropy=EntropySettings(slices=slices))
    return fit(given, settings, progress=progress)
