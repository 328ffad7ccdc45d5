"""A file of plain Gaussians as a static scene, without pictures: each Gaussian is an anchor (SPEC.md 9.4).

The numbers of a Gaussian are rounded to steps, and the entropy model is fitted to the symbols. The rendering networks
are linear: a hidden unit is a feature plus a constant that keeps it positive. Features are

- the principal components of the harmonics of all Gaussians: they are orthonormal, so that equal errors cost the same;
- the logit of the opacity;
- the vector part of the quaternion over its scalar part. Axes are permuted so that the scalar part is largest.

Scalings are the logarithms of the lengths, and the offset is what fp16 leaves of the mean.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..bitstream.cameras import NamedCamera
from ..bitstream.dimensions import RENDERING
from ..bitstream.header import PositionGrid, RenderInfo
from ..bitstream.networks import ACTIVATION_MAX, Layer
from ..bitstream.scene import Scene
from ..bitstream.splat import OUTPUT_BITS
from ..encoder.cloud import AnchorCloud
from ..encoder.positions import choose_grid
from ..train.fit import Progress, fit
from ..train.fit_input import Given
from ..train.settings import EntropySettings, FitSettings
from .splat_arrays import Arrays

F64 = NDArray[np.float64]

# The steps of step 1: of harmonics, logits, vector parts of quaternions and logarithms of lengths. A step of positions
# is this share of the longest axis that is shorter than those of nine in ten Gaussians. For playbot_lod3, a bit of each
# kind is then worth the same.
HARMONICS, LOGIT, TURN, LENGTH, POSITION, SMALL = 0.12, 0.3, 0.035, 0.17, 0.08, 0.1
# fp16 has all integers up to this one. The share of coordinates on each side that may be beyond, and fp16's range.
FP16_INTEGERS, OUTSIDE, FP16_MOST = 2048, 0.01, 60000
# How far Gaussians may move from their corner, in neighbours.
NEIGHBOURS = 16
# Gaussians whose opacity is below 1/255 are invisible (SPEC 14.5).
LOGIT_LEAST = math.log(1 / 254)
# Opacities above alpha_max make no difference.
LOGIT_MOST = 5.0
# The fit of the entropy model, which has no planes: they save 0.5 % of a file, and take as long again.
STEPS, BATCH = 600, 2048


def fast(
    arrays: Arrays,
    render: RenderInfo,
    step: float = 1.0,
    cameras: Sequence[NamedCamera] = (),
    progress: Progress | None = None,
) -> Scene:
    """Returns a static scene of Gaussians.

    arrays: of read_splats. render: the scene's render information, of a static scene. step: a factor of all steps; a
    larger one makes the file smaller and less accurate. cameras: those that the scene states. Raises ValueError for
    Gaussians that no file can hold.
    """
    arrays = {name: values[arrays["opacity"] >= LOGIT_LEAST] for name, values in arrays.items()}
    if not len(arrays["mean"]):
        raise ValueError("none of its Gaussians is visible")
    lengths, turn = _turned(arrays["scale"].astype(np.float64), arrays["quaternion"].astype(np.float64))
    harmonics = np.concatenate([arrays["base"][:, None], arrays["rest"]], axis=1, dtype=np.float64)
    width = harmonics.shape[1] * 3
    middle, basis = _components(harmonics.reshape(-1, width))
    values = np.concatenate(
        [(harmonics.reshape(-1, width) - middle) @ basis, arrays["opacity"][:, None].clip(max=LOGIT_MOST), turn], axis=1
    )
    steps = step * np.array([*[HARMONICS] * width, LOGIT, *[TURN] * 3])
    # A feature is the symbol itself, and its middle is 0.
    centre = np.rint((values.max(axis=0) + values.min(axis=0)) / 2 / steps)
    most = ACTIVATION_MAX // 2
    features = (np.rint(values / steps) - centre).clip(-most, most)
    # A hidden unit uses its whole range, so that the weights that read it are small.
    gain = 2.0 ** np.floor(np.log2(most / np.abs(features).max(axis=0).clip(1)))
    networks = _networks(basis, middle, steps / gain, centre * gain, gain)
    small = step * POSITION * math.exp(float(np.quantile(lengths.max(axis=1), SMALL)))
    grid, positions = _lattice(arrays["mean"].astype(np.float64), small)
    cloud = AnchorCloud(
        positions.astype(np.float32),
        features.astype(np.float32),
        np.concatenate([np.zeros_like(lengths), lengths], axis=1).astype(np.float32),
        (arrays["mean"] - positions).astype(np.float32)[:, None],
        np.ones((len(positions), 1), bool),
    )
    given = Given(
        cloud,
        grid=grid,
        networks=networks,
        render=render,
        cameras=tuple(cameras),
        base_step=(1.0, float(np.float32(step * LENGTH)), float(np.float32(small))),
    )
    settings = FitSettings(steps=STEPS, batch=BATCH, entropy=EntropySettings(channels=0))
    return fit(given, settings, progress=progress).scene


def _lattice(mean: F64, step: float) -> tuple[PositionGrid, F64]:
    """Returns a grid, and the corner of its lattice that is nearest to each mean, [N, 3].

    step: of positions. The lattice is as fine, or as fine as fp16 allows for nearly all Gaussians. It is coarser for
    those that are far outside.
    """
    low, high = np.quantile(mean, [OUTSIDE, 1 - OUTSIDE], axis=0)
    voxel = max(step, float((high - low).max()) / (2 * FP16_INTEGERS), float(np.ptp(mean, axis=0).max()) / FP16_MOST)
    grid = choose_grid(mean.astype(np.float32), voxel)
    unit = grid.scale_mantissa * 2.0**grid.scale_exponent
    origin = np.array(grid.origin, np.float64) * 2.0 ** (grid.scale_exponent - 24)
    corners = _distinct(np.rint((mean - origin) / unit).astype(np.float16))
    return grid, origin + corners.astype(np.float64) * unit


def _distinct(corners: NDArray[np.float16]) -> NDArray[np.float16]:
    """Returns corners of which each has few Gaussians, [N, 3], because packed positions are distinct (SPEC 5.14).

    All but the first of a corner move to its neighbours, ever farther away. Offsets undo this.
    """
    found = corners.copy()
    random = np.random.default_rng(0)
    for reach in range(1, NEIGHBOURS):
        _, first = np.unique(found, axis=0, return_index=True)
        moved = np.setdiff1d(np.arange(len(found)), first)
        if not len(moved):
            break
        away = random.integers(-reach, reach + 1, (len(moved), 3))
        found[moved] = corners[moved] + away * np.maximum(np.spacing(np.abs(corners[moved])), np.float16(1))
    return found + np.float16(0)


def _components(values: F64) -> tuple[F64, F64]:
    """Returns the mean of rows, and their principal components as columns, the largest first."""
    middle = values.mean(axis=0)
    _, basis = np.linalg.eigh((values - middle).T @ (values - middle))
    return middle, basis[:, ::-1]


def _turned(lengths: F64, quaternion: F64) -> tuple[F64, F64]:
    """Returns equal Gaussians: their lengths [N, 3], and the vector part of their quaternions over the scalar one.

    Of the 24 rotations that permute the axes, the one whose product has the largest scalar part is taken. Thus the
    results are between -1 and 1.
    """
    q = quaternion / np.linalg.norm(quaternion, axis=1, keepdims=True)
    best = np.zeros((len(q), 4))
    order = np.zeros((len(q), 3), np.int64)
    for turn, axes in _permutations():
        # The scalar part of q * turn.
        scalar = q[:, 0] * turn[0] - q[:, 1:] @ turn[1:]
        better = np.abs(scalar) > np.abs(best[:, 0])
        vector = q[:, :1] * turn[1:] + turn[0] * q[:, 1:] + np.cross(q[:, 1:], turn[1:])
        best[better] = np.concatenate([scalar[:, None], vector], axis=1)[better]
        order[better] = axes
    return np.take_along_axis(lengths, order, axis=1), best[:, 1:] / best[:, :1]


def _permutations() -> list[tuple[F64, list[int]]]:
    """Returns the 24 rotations of a cube: a unit quaternion, and the axis that becomes each axis."""
    found = []
    for axes in itertools.permutations(range(3)):
        for signs in itertools.product((1, -1), repeat=3):
            matrix = np.zeros((3, 3))
            matrix[list(axes), range(3)] = signs
            if np.linalg.det(matrix) > 0:
                # Half turns have no scalar part, and the eigenvector of 1 is the axis of every turn.
                angle = math.acos(max(min((np.trace(matrix) - 1) / 2, 1.0), -1.0))
                skew = np.array([matrix[2, 1] - matrix[1, 2], matrix[0, 2] - matrix[2, 0], matrix[1, 0] - matrix[0, 1]])
                if np.linalg.norm(skew) < 1e-9:
                    values, vectors = np.linalg.eigh(matrix)
                    axis = vectors[:, np.argmax(values)]
                else:
                    axis = skew / np.linalg.norm(skew)
                found.append((np.array([math.cos(angle / 2), *(math.sin(angle / 2) * axis)]), list(axes)))
    return found


def _networks(basis: F64, middle: F64, steps: F64, centre: F64, gain: F64) -> dict[str, list[Layer]]:
    """Returns the rendering networks, which take features back to the numbers of a Gaussian.

    basis [C, C], middle [C]: of the harmonics. steps, centre: [F], of the hidden units, each of which is gain [F] times
    its feature.
    """
    width, count = len(middle), len(steps)
    outputs = {
        "opacity": (np.eye(1, count, width), np.zeros(1)),
        # The scalar part of the quaternion is 1.
        "covariance": (
            np.concatenate([np.zeros((4, count)), np.eye(3, count, width + 1)]),
            np.array([0.0, 0, 0, 1, 0, 0, 0]),
        ),
        "colour": (np.concatenate([basis, np.zeros((width, count - width))], axis=1), middle),
    }
    # This makes a hidden unit positive: from 1 to ACTIVATION_MAX.
    shift = (ACTIVATION_MAX + 1) / 2
    networks: dict[str, list[Layer]] = {}
    for name in RENDERING:
        matrix, constant = outputs[name]
        weight = matrix * steps * 2.0**OUTPUT_BITS
        bias = constant * 2.0**OUTPUT_BITS + weight @ (centre - shift)
        first = np.diag(gain).astype(np.float32), np.full(count, shift, np.float32)
        networks[name] = [first, (weight.astype(np.float32), bias.astype(np.float32))]
    return networks
