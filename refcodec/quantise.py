"""The encoder's choices (SPEC.md Annex B): from float attributes and given networks to a scene of integers. Informative."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from .attributes import ATTRIBUTE_SYMBOL_MAX, KINDS, Attributes
from .codec import FRAME_SHIFT_MAX, MATRIX_BOUND, TRANSLATION_BOUND, derive_steps, take_anchors
from .container import ANCHORS_OF_A_BYTE, ORIGIN_BOUND, SCALE_EXPONENT_MAX, chunk_ranges
from .conventions import Int64
from .entropy import SymbolName
from .geometry import UNIT, Frame, contract, frame_coordinates, position_integers
from .limits import MAIN
from .masks import context_count, contexts
from .networks import ACTIVATION_MAX, Layer, derive_layer
from .planes import PLANES
from .positions import (
    CELL_INDEX,
    EMPTY_MODELS,
    HALVES,
    POSITION_MODELS,
    PositionModel,
    cells,
    chunk_codes,
    code_cells,
    encode_positions,
    morton,
)
from .scene import Dimensions, Lanes, PositionGrid, RenderInfo, Scene
from .tables import SCALE_MIN, STEP_SHIFT, TOTAL, ModelSet, tables
from .weights import to_grid

F32 = NDArray[np.float32]

# SPEC 5.8: the networks that no symbol depends on.
RENDERING = ("opacity", "covariance", "colour")
# SPEC B.1: without a lattice, the largest coordinate becomes about this in fp16.
FP16_EXTENT = 1024.0
# SPEC B.2: share of the anchors, nearest to the median, that shape the frame.
INLIERS = 0.95
# SPEC B.3: chunk size that measured best, and most lanes worth having.
CHUNK_SIZE = 4096
LANES_LOG2_MOST = 6


@dataclass(frozen=True, eq=False)
class AnchorCloud:
    """A scene before quantisation. Float32: positions [N, 3] in world units; features [N, F]; scalings [N, 6], natural
    logarithms; offsets [N, K, 3], in units of exp(scalings[:3]); masks: bool [N, K], True where an offset is kept."""

    positions: F32
    features: F32
    scalings: F32
    offsets: F32
    masks: NDArray[np.bool_]


def choose_grid(positions: F32, voxel: float | None = None) -> PositionGrid:
    """SPEC B.1. With a voxel its lattice is exact in fp16 up to 2048 voxels from the origin, which lies on the lattice near
    the middle. Without one, the largest coordinate is 1024 in fp16. Raises ValueError for NaN, infinity, or a size out of range."""
    if not np.isfinite(positions).all():
        raise ValueError("a position is NaN or infinite")
    p = positions.astype(np.float64)
    low, high = (p.min(axis=0), p.max(axis=0)) if len(p) else (np.zeros(3), np.zeros(3))
    middle = (low + high) / 2
    # Far from the world's origin a unit cannot be smaller than the bound on the grid's origin allows.
    unit = voxel or max(float((high - low).max()) / 2 / FP16_EXTENT, float(np.abs(middle).max()) * 2.0**-21) or 1.0
    # 16 bits of mantissa, so that scale_mantissa * P fits 56 bits.
    fraction, exponent = math.frexp(unit)
    mantissa = round(fraction * 65536)
    if mantissa == 65536:
        mantissa, exponent = 32768, exponent + 1
    exponent -= 16
    if abs(exponent) > SCALE_EXPONENT_MAX:
        raise ValueError(f"a voxel of {unit} is out of range")
    # The origin is a whole number of units, in 2^(exponent - 24).
    step = mantissa * 2.0**exponent
    origin = tuple(round(m / step) * mantissa << 24 for m in middle.tolist())
    if max(abs(o) for o in origin) >= ORIGIN_BOUND:
        raise ValueError("the scene is too far from the world's origin for its size")
    return PositionGrid((origin[0], origin[1], origin[2]), mantissa, exponent)


def to_fp16(positions: F32, grid: PositionGrid) -> NDArray[np.float16]:
    """SPEC 6.4 backwards: the fp16 positions nearest to world positions; never -0. Raises ValueError if one overflows fp16."""
    unit = grid.scale_mantissa * 2.0**grid.scale_exponent
    origin = np.array([o * 2.0 ** (grid.scale_exponent - 24) for o in grid.origin])
    with np.errstate(over="ignore"):
        half = ((positions.astype(np.float64) - origin) / unit).astype(np.float16)
    if not np.isfinite(half).all():
        raise ValueError("a position does not fit the position grid")
    half[half == 0] = 0
    return half


def choose_frame(positions: NDArray[np.float16]) -> Frame:
    """SPEC B.2: principal axes of the 95 % of anchors nearest to the median; one unit is one standard deviation.

    A direction without extent gets the unit of the widest one (or 1, if there is none), so that any set has a frame.
    """
    p = position_integers(positions).astype(np.float64)
    if len(p) == 0:
        p = np.zeros((1, 3))
    away = np.abs(p - np.median(p, axis=0)).max(axis=1)
    inlier = away <= np.quantile(away, INLIERS)
    mean = p[inlier].mean(axis=0)
    centred = p[inlier] - mean
    variance, axes = np.linalg.eigh(centred.T @ centred / len(centred))
    order = np.argsort(variance)[::-1]
    deviation = np.sqrt(np.maximum(variance[order], 0))
    widest = deviation[0] if deviation[0] >= 1 else 1.0
    deviation = np.where(deviation < widest * 1e-6, widest, deviation)
    rows = axes[:, order].T / deviation[:, None] * UNIT
    matrix, translation, shift = np.zeros((3, 3), np.int64), np.zeros(3, np.int64), np.zeros(3, np.int64)
    for r in range(3):
        for s in range(FRAME_SHIFT_MAX, -1, -1):
            a = np.rint(rows[r] * 2.0**s)
            t = -float(rows[r] @ mean) * 2.0**s
            if np.abs(a).max() < MATRIX_BOUND and abs(t) < TRANSLATION_BOUND:
                matrix[r], translation[r], shift[r] = a, round(t), s
                break
    everything = Frame(matrix, translation, shift, np.full(3, -2 * UNIT), np.full(3, 2 * UNIT))
    w = contract(frame_coordinates(everything, position_integers(positions[inlier] if len(positions) else np.zeros((1, 3), np.float16))))
    low, high = w.min(axis=0), w.max(axis=0)
    high = np.maximum(high, low + 1)
    return replace(everything, low=low, high=high)


def choose_plane_size(anchors: int) -> int:
    """SPEC B.3: B = sqrt(N) / 5, from 8 to 128: the paper's 128 at Amsterdam's 421,600 anchors, fewer points than anchors always."""
    return int(min(max(round(math.sqrt(anchors) / 5), 8), 128))


def choose_width(anchors: int) -> int:
    """SPEC B.3: hidden units of F_h and of CARM: N / 400, from 32 to 100: fp32 weights are a part of the file that does not shrink."""
    return min(max(anchors // 400, 32), 100)


def choose_lanes(anchors: int, attribute_bits: float) -> Lanes:
    """SPEC B.3: as many lanes as cost, at 4 bytes each, at most 0.2 % of the attributes' bytes in the attributes, 0.01 % of them
    in the planes (about 0.5 % of the planes) and 0.1 % in the masks; 64 at most.

    attribute_bits: expected bits of an anchor's attributes.
    """
    total = anchors * attribute_bits / 8
    chunks = max(-(-anchors // CHUNK_SIZE), 1)

    def lanes(share: float, substreams: int) -> int:
        return min(int(math.log2(max(total * share / (4 * substreams), 1))), LANES_LOG2_MOST)

    return Lanes(plane=lanes(0.0001, PLANES), mask=min(lanes(0.001, chunks), 3), attribute=lanes(0.002, chunks))


def mask_model(masks: NDArray[np.bool_]) -> NDArray[np.uint16]:
    """SPEC B.6: the frequency of a kept offset in each context, uint16 [K (K + 1) / 2]. masks: bool [N, K]."""
    count = context_count(masks.shape[1])
    seen, kept = np.zeros(count), np.zeros(count)
    before = np.cumsum(masks, axis=1, dtype=np.int64) - masks
    for k in range(masks.shape[1]):
        context = contexts(k, before[:, k])
        seen += np.bincount(context, minlength=count)
        kept += np.bincount(context, masks[:, k], minlength=count)
    frequency = np.where(seen > 0, np.rint(kept / np.maximum(seen, 1) * TOTAL), TOTAL // 2)
    return np.clip(frequency, 1, TOTAL - 1).astype(np.uint16)


def choose_cells(positions: NDArray[np.float16]) -> int:
    """SPEC B.1: the largest cell_shift with which every position has a cell, or 40 if none will do."""
    every = int(np.bitwise_or.reduce(position_integers(positions), axis=None))
    shift = min((every & -every).bit_length() - 1, CELL_INDEX - 1) if every else 0
    return CELL_INDEX if (cells(positions, shift) < 0).any() else shift


def morton_order(positions: NDArray[np.float16]) -> Int64:
    """SPEC B.1: a stable order along the Morton curve of the positions' cells."""
    return np.argsort(morton(cells(positions, choose_cells(positions))), kind="stable")


class _Counter:
    """A coder that only counts the symbols of the tree of cells. counts: int64 [18, 16]."""

    def __init__(self) -> None:
        self.counts = np.zeros((POSITION_MODELS, HALVES), dtype=np.int64)

    def plain(self, models: ModelSet, index: Int64, counts: list[int], name: SymbolName, given: Int64 | None) -> Int64:
        assert given is not None
        np.add.at(self.counts, (index, given), 1)
        return given


def frequencies(counts: Int64, first: int) -> Int64:
    """Frequencies that sum to 2^14 for symbols from `first` on, none of them 0; what rounding leaves goes to the most frequent."""
    found = np.zeros(len(counts), dtype=np.int64)
    seen = counts[first:] if counts[first:].any() else np.ones(len(counts) - first, dtype=np.int64)
    found[first:] = np.maximum(seen * TOTAL // seen.sum(), 1)
    found[np.argmax(found)] += TOTAL - found.sum()
    return found


def position_model(positions: NDArray[np.float16], chunk_size: int) -> PositionModel:
    """SPEC B.1: cell_shift, and the observed frequencies of the chunks that can be packed."""
    cell_shift, counter = choose_cells(positions), _Counter()
    for chunk in chunk_ranges(len(positions), chunk_size):
        code = chunk_codes(positions[chunk.start : chunk.stop], cell_shift)
        if code is not None:
            code_cells(counter, tables().gauss, [], [len(chunk)], code)
    frequency = [frequencies(c, int(model in EMPTY_MODELS)) for model, c in enumerate(counter.counts)]
    return PositionModel(cell_shift, np.array(frequency, dtype=np.uint16))


def pack_positions(scene: Scene) -> Scene:
    """SPEC B.1: the scene with its anchors along the Morton curve and positions in mode 1 where
    6.10 allows it. No attribute changes but its place."""
    scene = take_anchors(scene, morton_order(scene.positions))
    model, chunks = position_model(scene.positions, scene.chunk_size), chunk_ranges(scene.anchor_count, scene.chunk_size)
    parts = encode_positions(model, scene.positions, chunks, 1 << scene.lanes.mask)
    # SPEC 6.10 asks for a byte for 16 anchors, which a scene that fills a cube may not need.
    allowed = all(len(part) * ANCHORS_OF_A_BYTE >= len(chunk) for part, chunk in zip(parts, chunks, strict=True))
    return replace(scene, position_model=model if allowed else None)


def packed(scene: Scene, positions: str | None, weights: str | None) -> Scene:
    """The scene with positions and weights each "raw" or "packed"; None: packed in Main. What is packed already stays as it is."""
    if positions == "raw":
        scene = replace(scene, position_model=None)
    elif scene.position_model is None and (positions or scene.profile == MAIN):
        scene = pack_positions(scene)
    if weights == "raw":
        return replace(scene, weight_scales=None)
    if scene.weight_scales is None and (weights or scene.profile == MAIN):
        return pack_weights(scene)
    return scene


def exact_networks(networks: Mapping[str, list[Layer]]) -> dict[str, list[Layer]]:
    """SPEC B.5: the networks with the values of F_h, SARM and CARM replaced by their integers (7.2) over a power of two.

    SPEC 7.2 gives the same outputs for them. Raises networks.BoundError.
    """
    found = dict(networks)
    for name, layers in networks.items():
        if name in RENDERING:
            continue
        derived = [derive_layer(*layer) for layer in layers]
        found[name] = [
            (
                np.ldexp(layer.weight.astype(np.float32), -layer.exponent[:, None]).astype(np.float32),
                np.ldexp(layer.bias.astype(np.float32), -layer.exponent).astype(np.float32),
            )
            for layer in derived
        ]
    return found


def rendering_exponent(weight: F32, bits: int) -> int:
    """SPEC B.5: the largest e with which no weight, times 2^e and rounded, needs more than `bits` bits, sign included; 0 for zeros."""
    largest = float(np.abs(weight).max())
    return math.floor(math.log2(((1 << (bits - 1)) - 0.5) / largest)) if largest else 0


def quantise_rendering(networks: Mapping[str, list[Layer]], bits: int) -> dict[str, list[Layer]]:
    """SPEC B.5: the networks with each layer of opacity, covariance and colour on a grid: multiples of a power of two, the least with
    which no weight needs more than `bits` bits, sign included; biases on the same grid. bits: 2 to 24."""
    found = dict(networks)
    for name in RENDERING:
        found[name] = []
        for weight, bias in networks[name]:
            e = rendering_exponent(weight, bits)
            on_grid = [np.ldexp(np.rint(np.ldexp(value, e)) + np.float32(0), -e).astype(np.float32) for value in (weight, bias)]
            found[name].append((on_grid[0], on_grid[1]))
    return found


def weight_scales(networks: Mapping[str, list[Layer]]) -> NDArray[np.uint8]:
    """SPEC B.5: the scale indices of each layer in mode 1, uint8 [layers, 3]; 0 for a raw layer."""

    def index(scale: float) -> int:
        return min(max(round(8 * math.log2(scale)) - SCALE_MIN, 0), 255) if scale else 0

    found = []
    for grid in (to_grid(layer) for layers in networks.values() for layer in layers):
        if grid is None:
            found.append((0, 0, 0))
            continue
        spread = math.sqrt(float(np.square(grid.weight, dtype=np.float64).mean()))
        found.append((index(float(np.abs(grid.difference).mean())), index(spread), index(float(np.abs(grid.bias).mean()))))
    return np.array(found, dtype=np.uint8)


def pack_weights(scene: Scene) -> Scene:
    """SPEC B.5: the scene with its weights in mode 1, those of the coding networks replaced by their integers. No symbol changes."""
    networks = exact_networks(scene.networks)
    return replace(scene, networks=networks, weight_scales=weight_scales(networks))


def carm_shifts(features: NDArray[np.int32], inputs: int) -> NDArray[np.uint8]:
    """SPEC 7.9: for each input channel of CARM the smallest shift that brings its symbols within an activation."""
    largest = np.abs(features[:, :inputs]).max(axis=0, initial=0)
    shift = [max(int(v) // (ACTIVATION_MAX + 1), 0).bit_length() for v in largest]
    return np.array(shift, dtype=np.uint8)


def symbols(values: F32, steps: NDArray[np.uint8], base_step: float) -> NDArray[np.int32]:
    """SPEC 9.2 backwards: the nearest symbols. values [n, ...], steps [n]. Raises ValueError if one does not fit its type."""
    unit = base_step * tables().step[steps].astype(np.float64) / (1 << STEP_SHIFT)
    scaled = np.rint(values.astype(np.float64) / unit.reshape(-1, *[1] * (values.ndim - 1)))
    limit = ATTRIBUTE_SYMBOL_MAX
    if not np.isfinite(scaled).all() or np.abs(scaled).max(initial=0) > limit:
        raise ValueError(f"an attribute is not finite, or more than {limit} steps from zero")
    return scaled.astype(np.int32)


def order_anchors(cloud: AnchorCloud, grid: PositionGrid) -> tuple[AnchorCloud, NDArray[np.float16]]:
    """SPEC B.1 and B.6: the anchors that keep an offset, along a Morton curve, and their fp16 positions."""
    kept = np.flatnonzero(cloud.masks.any(axis=1))
    half = to_fp16(cloud.positions[kept], grid)
    order = morton_order(half)
    chosen = kept[order]
    offsets = np.where(cloud.masks[chosen][:, :, None], cloud.offsets[chosen], np.float32(0))
    ordered = AnchorCloud(cloud.positions[chosen], cloud.features[chosen], cloud.scalings[chosen], offsets, cloud.masks[chosen])
    return ordered, half[order]


def quantise(
    cloud: AnchorCloud,
    *,
    dimensions: Dimensions,
    networks: Mapping[str, list[Layer]],
    frame: Frame,
    grid: PositionGrid,
    planes: NDArray[np.int16],
    plane_shift: int,
    carm_shift: NDArray[np.uint8],
    base_step: tuple[float, float, float],
    render: RenderInfo | None = None,
    lanes: Lanes | None = None,
    profile: int = MAIN,
    chunk_size: int = CHUNK_SIZE,
) -> Scene:
    """A scene from float attributes and given networks (SPEC B): steps follow from the networks, symbols from the steps.

    Anchors are sorted, and dropped if no offset is kept. Raises ValueError for what cannot be written.
    """
    ordered, positions = order_anchors(cloud, grid)
    count = len(positions)
    scene = Scene(
        profile=profile,
        dimensions=dimensions,
        chunk_size=chunk_size,
        lanes=lanes or choose_lanes(count, 2.0 * dimensions.attribute_width),
        base_step=base_step,
        grid=grid,
        render=render or RenderInfo(),
        frame=frame,
        plane_shift=plane_shift,
        carm_shift=carm_shift,
        networks=dict(networks),
        planes=planes,
        mask_model=mask_model(ordered.masks),
        positions=positions,
        masks=ordered.masks,
        attributes=Attributes(
            np.zeros((count, dimensions.features), np.int32),
            np.zeros((count, 6), np.int32),
            np.zeros((count, dimensions.offset_count, 3), np.int32),
            np.zeros((count, len(KINDS)), np.uint8),
        ),
    )
    steps = derive_steps(scene)
    features, scalings, offsets = (symbols(getattr(ordered, kind), steps[:, i], base_step[i]) for i, kind in enumerate(KINDS))
    return replace(scene, attributes=Attributes(features, scalings, offsets, steps))
