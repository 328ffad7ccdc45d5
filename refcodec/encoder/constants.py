"""Saves bytes of small scenes: removes the hyperprior, so that F_h is a row of constants, and uses raw positions.

Planes, F_h, the frame and the model of packed positions have a size that is independent of the number of anchors
(SPEC.md 11.1, B.3). No value changes.
"""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..bitstream.codec import Coding, derive_steps, emit
from ..bitstream.conventions import Int64
from ..bitstream.dimensions import SCALINGS
from ..bitstream.entropy import placed
from ..bitstream.limits import PROFILES
from ..bitstream.planes import no_planes
from ..bitstream.scene import Scene
from ..bitstream.tables import PRECISION, SCALE_END, SCALE_MIN, tables
from .weights import pack_weights

# The number of anchors from which the constants are chosen. More of them hardly change a constant.
MOST = 8192
# The model of packed positions has 580 bytes, raw positions have 6 per anchor. For more anchors raw is never smaller.
FEW = 1024
# The moves of a mean (in 1/16 step) and of a scale index (in 1/8 octave), in the order of the search.
MOVES = (32, 16, 8, 4, 2, 1)
# The largest scale index tried: sixteen octaves above the table.
SCALE_MOST = SCALE_END + 8 * 16


def code_length(mean: Int64, scale: Int64, symbols: Int64) -> float:
    """SPEC 8.5 and 8.6: returns the bits of attribute symbols, int64 [n], under the shipped models.

    mean: in 1/16 of a step. scale: scale indices. Both are int64 [n]. The bits of a symbol are those of its model's
    frequency, its raw bits, and the bits of its escape, if any.
    """
    models = tables().gauss
    model, index, away, raw = placed(models, mean, scale, symbols)
    radius = models.radius.take(model)
    escaped = index > 2 * radius
    at = models.offset.take(model) + index
    frequency = models.upper.take(at).astype(np.float64) - models.lower.take(at)
    excess = np.abs(away[escaped]) - radius[escaped]
    escapes = float((2 + 2 * np.floor(np.log2(excess))).sum())
    return float((PRECISION - np.log2(frequency)).sum()) + float(raw.sum()) + escapes


def choose_constants(symbols: Int64, mean: Int64, scale: Int64) -> tuple[int, int]:
    """Returns the mean and the scale index that code some symbols of one channel with nearly the fewest bits.

    symbols: int64 [n]. mean, scale: int64 [n], the outputs of CARM. The search starts at the symbols' mean and
    deviation, and moves one of the two while that saves bits. Then it tries each mean within half a step and each scale
    within half an octave, because the tables are not a smooth function of them.
    """
    if not len(symbols):
        return 0, 0
    rest = symbols - mean / 16
    spread = np.log2(max(float(rest.std()), 2.0**-5)) - float(scale.mean()) / 8
    chosen = (round(16 * float(rest.mean())), round(8 * spread))
    best = code_length(mean + chosen[0], scale + chosen[1], symbols)

    def better(moves: Iterable[tuple[int, int]]) -> bool:
        """Makes the best of some moves. Returns whether one saved bits."""
        nonlocal chosen, best
        first = chosen
        for by_mean, by_scale in moves:
            tried = first[0] + by_mean, first[1] + by_scale
            if SCALE_MIN - SCALE_MOST <= tried[1] <= SCALE_MOST:
                bits = code_length(mean + tried[0], scale + tried[1], symbols)
                if bits < best:
                    chosen, best = tried, bits
        return chosen != first

    for move in MOVES:
        while better(((move, 0), (-move, 0), (0, move), (0, -move))):
            pass
    better((by, 0) for by in range(-8, 9))
    better((0, by) for by in range(-4, 5))
    return chosen


def with_constants(scene: Scene, slices: tuple[int, ...]) -> Scene | None:
    """Returns the scene without planes, frequencies and hidden layers of F_h, or None if that would change a value.

    All symbols are kept, and the steps too, which must be the same for all anchors. slices: those of the scene, which
    keeps its CARM, or a single one without CARM. Raises ValueError for others.
    """
    d, a, count = scene.dimensions, scene.attributes, scene.anchor_count
    if slices not in (d.slices, (d.features,)):
        raise ValueError(f"slices {slices} are neither the scene's nor a single one")
    if not d.has_frame or not count or (a.steps != a.steps[0]).any():
        return None
    alone = len(slices) == 1
    dimensions = replace(
        d,
        slices=slices,
        plane_channels=0,
        frequency_count=0,
        plane_size=0,
        hyper_width=(),
        sarm_width=(),
        carm_width=() if alone else d.carm_width,
    )
    rows = np.unique(np.linspace(0, count - 1, min(count, MOST)).astype(np.int64))
    means, scales = _constants(scene, rows, alone)
    bias = np.concatenate([means, scales, a.steps[0]]).astype(np.float32)
    networks = {**scene.networks, "hyper": [(np.zeros((len(bias), 0), np.float32), bias)]}
    coded = replace(
        scene,
        dimensions=dimensions,
        frame=None,
        plane_shift=0,
        carm_shift=np.zeros(0, np.uint8) if alone else scene.carm_shift,
        networks={name: networks[name] for name in dimensions.network_shapes()},
        planes=no_planes(),
        weight_forms=None,
        position_forms=None,
    )
    if scene.weight_scales is not None:
        coded = pack_weights(replace(coded, weight_scales=None))
    assert np.array_equal(derive_steps(coded), a.steps)
    return coded


def _constants(scene: Scene, rows: Int64, alone: bool) -> tuple[list[int], list[int]]:
    """Returns the means and the scale indices of all channels. alone: without CARM."""
    d, a = scene.dimensions, scene.attributes
    features, masks = a.features[rows].astype(np.int64), scene.masks[rows]
    change = np.zeros((2, len(rows), d.features), np.int64)
    if not alone:
        model, done = Coding(scene).model, d.slices[0]
        for index, columns in enumerate(d.slices[1:], start=1):
            correction = np.split(model.carm_correction(index, features[:, :done]), 2, axis=1)
            change[:, :, done : done + columns] = np.stack(correction)
            done += columns
    nothing = np.zeros(len(rows), np.int64)
    columns_of: list[tuple[NDArray[np.int64], Int64, Int64]] = [
        *((features[:, i], change[0, :, i], change[1, :, i]) for i in range(d.features)),
        *((a.scalings[rows, i].astype(np.int64), nothing, nothing) for i in range(SCALINGS)),
    ]
    for k in range(d.offset_count):
        kept = a.offsets[rows][masks[:, k], k].astype(np.int64)
        columns_of += [(kept[:, axis], nothing[: len(kept)], nothing[: len(kept)]) for axis in range(3)]
    chosen = [choose_constants(*column) for column in columns_of]
    return [mean for mean, _ in chosen], [scale for _, scale in chosen]


def smallest(scene: Scene, positions: str | None = None) -> Scene:
    """Returns the scene unchanged, without a hyperprior, or also with raw positions, whichever has the smallest file.

    Positions, masks, attributes and rendering networks do not change, so the scene looks the same. A scene whose steps
    depend on the anchor keeps its hyperprior. positions: "packed" to keep packed positions.
    """
    d = scene.dimensions
    choices = [d.slices]
    if len(d.slices) > 1 and d.features <= PROFILES[scene.profile].slice_width[1]:
        choices.append((d.features,))
    scenes = [scene, *(made for made in (with_constants(scene, slices) for slices in choices) if made is not None)]
    if positions is None and scene.anchor_count <= FEW:
        scenes += [replace(one, position_model=None, position_forms=None) for one in scenes if one.position_model]
    return scenes[0] if len(scenes) == 1 else min(scenes, key=lambda one: len(emit(one)))
