"""A static scene (SPEC.md 9.4) from plain 3D Gaussians, without a training of the scene: transform coding.

Each Gaussian becomes an anchor at its mean. The rendering networks are linear decoders (linear.py) of the other
numbers, in steps that suit their importance. Only the entropy model is learned.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..bitstream.dimensions import RENDERING, SCALINGS, STATIC, layers_of
from ..bitstream.header import PositionGrid, RenderInfo
from ..bitstream.limits import MAIN, PROFILES
from ..bitstream.networks import Layer, derive_layer
from ..bitstream.positions import CELL_LEVELS
from ..bitstream.scene import Scene
from ..bitstream.splat import OUTPUT_BITS
from ..encoder.cloud import AnchorCloud
from ..encoder.layers import coarse_layers
from ..encoder.positions import choose_grid
from ..encoder.quantise import packed
from ..formats.packing import along_curve, logistic, opacities
from ..formats.splats import Splats, rows_of
from ..rendering.camera import Camera, spread_cameras
from ..rendering.constants import ALPHA_MIN
from ..rendering.gaussians import static_shapes
from ..rendering.rasterise import Settings, draw, settings_of
from ..train.fit import fit
from ..train.fit_input import Given
from ..train.settings import EntropySettings, FitSettings
from .importance import BLOCK, COLOUR, LENGTHS, LOGIT, TURN, importance, numbers, own_importance, splats_of
from .linear import FAR, hidden_units, network
from .views import JUDGES, TEST, TRAIN

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I64 = NDArray[np.int64]
Progress = Callable[[str, int, int], None]

# The most classes of anchors by importance. More of them save no bytes (own measurement).
CLASSES = 4
# Larger logits give nearly the same pictures, as an opacity at a pixel is at most alpha_max (SPEC 14.5). Importance is
# measured with logits up to the second bound, because opacities at that maximum have no derivative.
LOGIT_MAX, LOGIT_MEASURED = 8.0, 4.0
# A Gaussian is dropped if its absence costs less than this many bits: that many are saved, but absences add up.
BITS = 4
# What a picture from near counts, relative to the mean of those by cameras.
NEAR_SHARE = 0.2
# The steps of positions, relative to those of equal slope (own measurement): the mean importance of a position is that
# of a few thin Gaussians, for which derivatives overestimate a large error.
POSITION = 1.5
# The steps of each kind, relative to those of equal slope (own measurement): errors of lengths and opacities add up
# where Gaussians overlap.
BALANCE = {"lengths": 0.7, "logit": 0.6, "turn": 1.0, "colour": 1.0}
# The largest steps, by kind: derivatives say nothing about larger errors.
STEP_MAX = {"lengths": 0.5, "logit": 1.5, "turn": 0.25, "colour": 1.0}
# The smallest weight, which keeps quotients finite.
TINY = 1e-300
KINDS: dict[str, slice] = {"lengths": LENGTHS, "logit": LOGIT, "turn": TURN, "colour": COLOUR}
KIND_NAMES = list(KINDS)
# The columns that each rendering network decodes. The covariance network also has w, which is 1.
OUTPUTS: dict[str, tuple[slice, ...]] = {"opacity": (LOGIT,), "covariance": (LENGTHS, TURN), "colour": (COLOUR,)}
# Features of slices before those of colours: the class, lengths and logit, turn.
SLICES = (1, 4, 3)
COLOURS = (3, 3, 6, 12, 24)
# The share of weights of 0 from which on the smallest scale is the best one.
SPARSE = 0.5
# The search for the quality: cameras, tries, and the largest difference in dB that ends it. The quality falls by
# about SLOPE dB where lambda is tenfold.
TRIES, TOLERANCE, SLOPE = 6, 0.1, 9.0
# Positions: the share of means that choose the middle of the lattice, bits of its unit, the share of taken cells that
# makes it finer, and the moves out of a taken cell, which are tried in this order.
INLIERS, VOXEL_BITS, CROWDED = 0.95, 4, 0.1
# The largest coordinate of the lattice in cells. A Gaussian beyond has an offset of at most so many units.
END, OFFSET_MOST = 0.4 * 2**CELL_LEVELS, 1 << 13
# Odd numbers, of which products with the bits of means tell these apart.
ODD = 0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9
AROUND, DISTANCES = [np.array(step) for step in sorted(np.ndindex(2, 2, 2), key=sum)[1:]], (1, -1, 2, -2, 3, -3)
# The entropy model: steps of training, and what differs from a fit of longer training.
STEPS, BATCH, LEARNING_RATE, PLANE_PERIOD = 600, 2048, 0.02, 8
# The most hidden units. A million Gaussians take 0.5 % more bytes than by 100, and a fifth less time of decoding.
WIDTH = 48
# Scenes of so many anchors have layers, and at least so many lanes of attributes (as a base-2 logarithm): both cost
# them less than 0.3 % bytes (own measurement).
LARGE, LANES = 100_000, 5
# Bits by which its weights are coarser than its integers. They save 0.6 to 1 % of a file (own measurement).
COARSER = 3
# Cameras around the Gaussians that measure, and the sides of their images in pixels.
VIEWS, SIDE = 32, 400
# The most Gaussians of a class that decide where its symbols are.
SAMPLE = 1 << 16
# The default quality in dB.
PSNR = 46.0


@dataclass(frozen=True, eq=False)
class Measured:
    """Gaussians to code, with what errors in them cost.

    mean: float32 [n, 3]. table: float32 [n, numbers] (importance.py). by_mean [n], by_kind [n, 4]: the importance of a
    number of each kind, of the mean and of KINDS, float32. absence: the squared error of pictures by the absence of
    each Gaussian, float32 [n].
    """

    mean: F32
    table: F32
    by_mean: F32
    by_kind: F32
    absence: F32

    def of(self, rows: NDArray[np.bool_]) -> Measured:
        """Returns some of the Gaussians, without a copy if these are all."""
        return self if rows.all() else Measured(*(values[rows] for values in vars(self).values()))


@dataclass(frozen=True, eq=False)
class Coded:
    """Symbols of some Gaussians, and the networks that decode them.

    positions: float32 [n, 3], on the lattice. offsets: int64 [n, 3], and the exponent of their unit, int64 [n], which
    are 0 but for the few Gaussians beyond the lattice. mean: float32 [n, 3], of both (SPEC 9.4). features: int16
    [n, F]. table: the decoded numbers, float32 [n, numbers].
    """

    positions: F32
    offsets: I64
    exponent: I64
    mean: F32
    grid: PositionGrid
    features: NDArray[np.int16]
    networks: dict[str, list[Layer]]
    table: F32


@dataclass(frozen=True)
class Fast:
    """A converted scene.

    psnr: of its pictures, dB. faint, dropped: the numbers of Gaussians that no picture can show, and whose absence
    costs less than their bits. whole: whether its entropy model is trained to the end.
    """

    scene: Scene
    psnr: list[float]
    faint: int
    dropped: int
    whole: bool


def measured(held: list[Splats], cameras: Sequence[Camera], settings: Settings, progress: Progress) -> Measured:
    """Returns the Gaussians that can be seen at all, measured in the pictures of some cameras. held: as for converted.

    Neighbours are together, which is fast for drawing.
    """
    splats = held.pop()
    shown = opacities(splats) >= ALPHA_MIN
    order = along_curve(splats.mean)
    chosen = rows_of(splats, order[shown[order] | ~shown.any()])
    del splats
    table, mean = numbers(chosen), chosen.mean
    del chosen
    column, logit = LOGIT.start, KIND_NAMES.index("logit") + 1
    own = np.minimum(table[:, column], LOGIT_MAX)
    table[:, column] = np.minimum(own, LOGIT_MEASURED)
    pictures = importance(splats_of(mean, table), cameras, settings, progress)
    measured, exact = logistic(table[:, column].astype(np.float64)), logistic(own.astype(np.float64))
    table[:, column] = own
    # A pixel is linear in an opacity.
    absence = pictures[:, logit] / (1 - measured) ** 2
    pictures[:, logit] *= (exact * (1 - exact) / (measured * (1 - measured))) ** 2
    # The picture that all Gaussians fill evenly stands for those that somebody may take from near.
    weights = np.concatenate([pictures, absence[:, None]], axis=1, dtype=np.float32)
    for begin in range(0, len(table), BLOCK):
        rows = slice(begin, begin + BLOCK)
        weights[rows] += own_importance(table[rows]) * (NEAR_SHARE / len(table))
    return Measured(mean, table, weights[:, 0], weights[:, 1:-1], weights[:, -1])


# --- symbols ----------------------------------------------------------------------------------------------------------


def _classes(weights: Mapping[str, F64], most: int) -> I64:
    """Returns the class of each Gaussian, 0 for the most important ones, int64 [n]. weights: [n], by kind."""
    shares = [np.log2(np.maximum(w / (w.mean() or 1.0), 1e-6)) for name, w in weights.items() if name != "logit"]
    place = np.mean(shares, axis=0)
    centres = np.quantile(place, (np.arange(most, 0, -1) - 0.5) / most)
    nearest = np.zeros(len(place), np.int64)
    for _ in range(20):
        nearest = np.abs(place[:, None] - centres).argmin(axis=1)
        centres = np.array([place[nearest == k].mean() if (nearest == k).any() else c for k, c in enumerate(centres)])
    # Without the empty ones.
    return np.unique(nearest, return_inverse=True)[1].reshape(-1)


def _step(error_per_bit: float, weight: F64 | float) -> F64:
    """Returns the step whose squared error, step^2 / 12 weight, has the slope -error_per_bit against its bits."""
    step: F64 = np.sqrt(6 * error_per_bit / math.log(2) / np.maximum(weight, TINY))
    return step


def _lattice(given: Measured, error_per_bit: float) -> tuple[PositionGrid, F32]:
    """Returns the grid of positions, and the positions on its lattice, float32 [n, 3].

    The few Gaussians far out, such as a sky, do not make the lattice coarser: they get positions at its ends. No two
    positions are equal, as far as possible: a chunk of equal ones cannot be packed (SPEC 6.11).
    """
    mean = given.mean.astype(np.float64)
    # The few Gaussians far out do not decide where fp16 is exact, either.
    away = np.abs(mean - np.median(mean, axis=0)).max(axis=1)
    core = mean[away <= np.quantile(away, INLIERS)]
    reach = float((core.max(axis=0) - core.min(axis=0)).max()) / 2
    # All cells are within the tree. Multiples of a mantissa of VOXEL_BITS bits are exact in float32.
    least = max(reach / END, float(np.abs(core).max()) * 2.0 ** (VOXEL_BITS - 24)) or 1.0
    voxel = min(max(float(POSITION * _step(error_per_bit, given.by_mean.mean())), least), max(reach, least))
    # A finer lattice does not separate equal means. Their bits, times odd numbers, tell means apart.
    bits = given.mean.view(np.uint32).astype(np.uint64) @ np.array(ODD, np.uint64)
    crowded = CROWDED + 1 - len(np.unique(bits)) / len(mean)
    # The most important ones choose first.
    order = np.argsort(-given.by_mean, kind="stable")
    while True:
        fraction, exponent = math.frexp(voxel)
        grid = choose_grid(
            core.astype(np.float32), math.ldexp(math.ceil(fraction * 2**VOXEL_BITS), exponent - VOXEL_BITS)
        )
        unit = grid.scale_mantissa * 2.0**grid.scale_exponent
        origin = np.array([o * 2.0 ** (grid.scale_exponent - 24) for o in grid.origin])
        exact = ((mean[order] - origin) / unit).clip(-END, END)
        cell = _rounded(exact)
        if (np.diff(np.sort(_keys(cell))) == 0).sum() / len(cell) <= crowded or voxel / 2 < least:
            break
        voxel /= 2
    # Towards the exact position first.
    home, side = cell.copy(), np.where(exact >= cell, 1, -1)
    # fp16 has 11 bits.
    side <<= np.maximum(np.frexp(cell.astype(np.float64))[1] - 11, 0)
    taken, first = np.unique(_keys(cell), return_index=True)
    late = np.setdiff1d(np.arange(len(cell)), first, assume_unique=True)
    for far, step in product(DISTANCES, AROUND):
        if not len(late):
            break
        moved = _rounded(home[late] + far * side[late] * step)
        keys, first = np.unique(_keys(moved), return_index=True)
        place = np.searchsorted(taken, keys)
        free = taken[np.minimum(place, len(taken) - 1)] != keys
        cell[late[first[free]]] = moved[first[free]]
        taken, late = np.insert(taken, place[free], keys[free]), np.delete(late, first[free])
    back = np.empty_like(cell)
    back[order] = cell
    return grid, (origin + unit * back).astype(np.float32)


def _rounded(cells: F64) -> I64:
    """Returns the nearest integers that fp16 holds."""
    return np.rint(cells).astype(np.float16).astype(np.int64)


def _keys(cell: I64) -> I64:
    """Returns a number for each cell, int64 [n]. cell: int64 [n, 3]."""
    keys: I64 = (cell + (1 << 17)) @ (1, 1 << 20, 1 << 40)
    return keys


def coded(given: Measured, error_per_bit: float) -> Coded:
    """Returns the symbols for a slope of distortion and rate: the mean squared error of a picture that a bit is worth.

    Raises ValueError for numbers that no network of SPEC 7.2 decodes.
    """
    kept = given.absence >= BITS * error_per_bit
    given = given.of(kept | ~kept.any())
    table, (n, numbers_count) = given.table, given.table.shape
    weights = {name: given.by_kind[:, i].astype(np.float64) + TINY for i, name in enumerate(KINDS)}
    most = PROFILES[MAIN].render_width[1]
    widest = max(numbers_count - COLOUR.start, 6)
    chosen = _classes(weights, max(k for k in range(1, CLASSES + 1) if hidden_units(k, widest) <= most))
    classes = int(chosen.max()) + 1
    blocks = [slice(begin, begin + BLOCK) for begin in range(0, n, BLOCK)]
    # Of each column: a step for each class, [C, numbers], and a middle. Columns of a kind have equal steps.
    steps, middle, basis = np.empty((classes, numbers_count)), np.empty(numbers_count), np.eye(numbers_count)
    for name, columns in KINDS.items():
        weight = weights[name]
        each = np.array([weight[chosen == k].mean() for k in range(classes)])
        steps[:, columns] = np.minimum(BALANCE[name] * _step(error_per_bit, each), STEP_MAX[name])[:, None]
        middle[columns] = weight @ table[:, columns] / weight.sum()
    spread, weight = np.zeros((numbers_count, numbers_count)), weights["colour"]
    for rows in blocks:
        centred = table[rows] - middle
        spread += (centred * weight[rows, None]).T @ centred
    basis[COLOUR, COLOUR] = np.linalg.eigh(spread[COLOUR, COLOUR] / weight.sum())[1][:, ::-1]
    # The largest number of a class is within the reach of its features.
    peaks, turns = np.zeros(steps.shape), np.empty(steps.shape, complex)

    def by_class() -> Iterator[tuple[int, NDArray[np.int64]]]:
        for rows in blocks:
            for k in range(classes):
                yield k, rows.start + np.flatnonzero(chosen[rows] == k)

    for k, own in by_class():
        far = np.abs((table[own] - middle) @ basis)
        peaks[k] = np.maximum(peaks[k], far.max(axis=0, initial=0))
    steps = np.maximum(steps, peaks / (FAR - 1))
    for k in range(classes):
        some = np.flatnonzero(chosen == k)
        some = some[:: -(-len(some) // SAMPLE)]
        turns[k] = np.exp(2j * np.pi * ((table[some] - middle) @ basis) / steps[k]).sum(axis=0)
    # Many Gaussians may have one number, such as an opacity. Symbols of each class meet the most frequent ones, as
    # equal errors would add up in a picture.
    middles = middle + np.angle(turns) / (2 * np.pi) * steps @ basis.T
    features, decoded = np.empty((n, numbers_count + 1), np.int16), np.empty_like(table)
    features[:, 0] = chosen
    networks = {}
    for name, parts in OUTPUTS.items():
        wide = np.concatenate([np.arange(numbers_count)[part] for part in parts])
        given_maps = steps[:, wide], basis[np.ix_(wide, wide)], middles[:, wide]
        layers, maps = network(*given_maps, wide + 1, numbers_count + 1, hidden_units(classes, widest))
        for k, own in by_class():
            mine = np.ix_(own, wide)
            symbols = maps.symbols(table[mine], k)
            decoded[mine] = maps.numbers(symbols, k)
            features[np.ix_(own, wide + 1)] = symbols
        networks[name] = _with_w(layers) if name == "covariance" else layers
    grid, positions = _lattice(given, error_per_bit)
    rest = given.mean.astype(np.float64) - positions
    unit, longest = grid.scale_mantissa * 2.0**grid.scale_exponent, np.abs(rest).max(axis=1)
    # Equal means are a few voxels from theirs.
    far = longest > 2 * max(DISTANCES) * unit
    exponent = np.where(far, np.ceil(np.log(np.maximum(longest, unit) / OFFSET_MOST)), 0).astype(np.int64)
    offsets = np.where(far[:, None], np.rint(rest / np.exp(exponent)[:, None]), 0).astype(np.int64)
    mean = (positions + offsets * np.exp(exponent)[:, None]).astype(np.float32)
    return Coded(positions, offsets, exponent, mean, grid, features, networks, decoded)


def _with_w(layers: list[Layer]) -> list[Layer]:
    """Returns the covariance network with an output for w of the quaternion, which is 1."""
    first, (weight, bias) = layers
    return [first, (np.insert(weight, 3, 0, axis=0), np.insert(bias, 3, 2.0**OUTPUT_BITS))]


# --- quality ----------------------------------------------------------------------------------------------------------


class Judge:
    """Pictures of the given Gaussians by some cameras, to compare with."""

    cameras: Sequence[Camera]
    settings: Settings
    truth: list[F32]

    def __init__(self, given: Measured, cameras: Sequence[Camera], settings: Settings) -> None:
        self.cameras, self.settings = cameras, settings
        self.truth = self._drawn(given.mean, given.table)

    def _drawn(self, mean: F32, table: F32) -> list[F32]:
        splats = splats_of(mean, table)
        shapes = static_shapes(splats)
        return [draw(splats, camera, self.settings, shapes).image.clip(0, 1) for camera in self.cameras]

    def psnr(self, coded: Coded) -> list[float]:
        """Returns the PSNR of each picture of decoded Gaussians, in dB, at most 100."""
        pairs = zip(self._drawn(coded.mean, coded.table), self.truth, strict=True)
        return [float(-10 * np.log10(max(np.square(a - b, dtype=np.float64).mean(), 1e-10))) for a, b in pairs]


def search(given: Measured, psnr: float, judge: Judge, progress: Progress) -> tuple[Coded, list[float]]:
    """Returns the symbols whose pictures have a mean PSNR, in dB, as nearly as a few tries find them.

    Also returns the PSNR of each picture.
    """
    # The squared error of each number is that of its step.
    error_per_bit = 10 ** (-psnr / 10) * 2 * math.log(2) / given.table.size
    tries: list[tuple[float, float]] = []
    best: tuple[Coded, list[float]] | None = None
    for number in range(TRIES):
        tried = coded(given, error_per_bit)
        each = judge.psnr(tried)
        reached = float(np.mean(each))
        progress("search", number + 1, TRIES)
        if best is None or abs(reached - psnr) < abs(np.mean(best[1]) - psnr):
            # What was drawn needs memory.
            best = replace(tried, table=tried.table[:0]), each
        del tried
        if abs(reached - psnr) <= TOLERANCE:
            break
        tries.append((math.log10(error_per_bit), reached))
        slope = SLOPE
        if len(tries) > 1:
            (a, p), (b, q) = tries[-2:]
            slope = min(max((p - q) / ((b - a) or 1.0), SLOPE / 3), SLOPE * 3)
        error_per_bit *= 10 ** min(max((reached - psnr) / slope, -1.5), 1.5)
    assert best is not None
    return best


# --- the scene --------------------------------------------------------------------------------------------------------


def converted(
    held: list[Splats],
    cameras: Mapping[str, Sequence[Camera]],
    render: RenderInfo,
    stated: int,
    psnr: float,
    steps: int = STEPS,
    progress: Progress | None = None,
) -> Fast:
    """Returns a static scene of Gaussians, whose pictures have nearly a PSNR, in dB, to theirs.

    held: the Gaussians, which are taken out of this list, as their memory is needed. cameras: those that measure, and
    those that judge (views.py). stated: how many of them the scene states. steps: of the training of the entropy model,
    which an interrupt ends early. Raises ValueError for Gaussians that cannot be coded.
    """
    show = progress or (lambda stage, done, total: None)
    settings, given_count = settings_of(render), len(held[0].mean)
    given = measured(held, cameras[TRAIN], settings, show)
    judges = cameras[TEST] or cameras[TRAIN]
    rows = np.unique(np.linspace(0, len(judges) - 1, JUDGES).round().astype(int))
    symbols, reached = search(given, psnr, Judge(given, [judges[i] for i in rows], settings), show)
    measured_count, (n, count) = len(given.mean), symbols.features.shape
    # The fit needs memory, too.
    del given
    scalings = np.repeat([symbols.exponent, np.zeros(n)], SCALINGS // 2, axis=0).T.astype(np.float32)
    # These features and offsets are integers, of few bytes each.
    features: Any = symbols.features
    offsets: Any = symbols.offsets[:, None]
    clouds = [AnchorCloud(symbols.positions, features, scalings, offsets, np.ones((n, 1), bool))]
    grid, networks = symbols.grid, symbols.networks
    del symbols, scalings, features, offsets
    static, shown = replace(render, render_model=STATIC), tuple(spread_cameras(cameras[TRAIN], stated))
    entropy = EntropySettings(slices=_slices(count), width=WIDTH)
    learning = FitSettings(
        steps=steps, batch=BATCH, network_learning_rate=LEARNING_RATE, plane_period=PLANE_PERIOD, entropy=entropy
    )
    # The last ones are the steps of features, scalings and offsets.
    result = fit(Given(clouds.pop(), None, grid, networks, static, shown, (1.0, 1.0, 1.0)), learning, progress=show)
    faint, dropped = given_count - measured_count, measured_count - n
    return Fast(_packed(result.scene), reached, faint, dropped, result.report["steps"] == steps)


def _coarser(networks: dict[str, list[Layer]]) -> dict[str, list[Layer]]:
    """Returns the networks, those of the entropy model with weights of fewer bits than SPEC 7.2 allows."""
    coarser = dict(networks)
    for name in [name for name in networks if name not in RENDERING]:
        coarser[name] = []
        for layer in networks[name]:
            exponent = derive_layer(*layer).exponent - COARSER
            # +0 removes -0, which cannot be packed.
            values = [np.ldexp(np.rint(np.ldexp(v.T, exponent)) + np.float32(0), -exponent).T for v in layer]
            coarser[name].append((values[0], values[1]))
    return coarser


def _slices(count: int) -> tuple[int, ...]:
    """Returns the slices of the features: those of colours are longer and longer, as these matter less and less."""
    ends = np.cumsum([0, *SLICES, *COLOURS]).clip(max=count)
    return tuple(width for width in np.diff(ends).tolist() if width)


def _packed(scene: Scene) -> Scene:
    """Returns the scene with packed positions and weights, of which most of the rendering networks' are 0.

    Scales for these rendering networks are smaller than the root of the mean square (SPEC B.5): their few other weights
    are escapes.
    """
    large = scene.anchor_count >= LARGE
    layers = coarse_layers(scene) if large else None
    scene = packed(replace(scene, networks=_coarser(scene.networks)), None, None, layers)
    assert scene.weight_scales is not None
    scales = scene.weight_scales.copy()
    for number, (name, _, _) in enumerate(layers_of(scene.dimensions)):
        network, _, layer = name.partition(".")
        if network in RENDERING and (scene.networks[network][int(layer)][0] == 0).mean() > SPARSE:
            scales[number, 1] = 0
    lanes = replace(scene.lanes, attribute=max(scene.lanes.attribute, LANES if large else 0))
    return replace(scene, weight_scales=scales, lanes=lanes)
