"""Fits one set of Gaussians to the view-dependent Gaussians of a scene.

The networks of a scene give opacity, lengths, rotation and colour for each view. An ordinary Gaussian has one of each,
and harmonics for its colour. They are fitted in three steps:

1. Each view is drawn. The derivative of the image's sum with respect to a Gaussian's colour is its blending weight: the
   sum over all pixels of its alpha times the transmittance before it. It measures how much of the view depends on the
   Gaussian.
2. Opacity and covariance are means over the views. The mean of covariances is that of their logarithms, which keeps
   volumes. The harmonics are a regression of the colours, weighted by the blending weights. A small ridge determines
   coefficients that the views do not.
3. The images are linear in the coefficients of the harmonics. Thus all coefficients together are improved by
   least squares on the images, with conjugate gradients. This corrects in colour the error of a single opacity and
   covariance for all views.

The Gaussians are drawn with the filter of viewers, which need not be that of the scene.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ..bitstream.batches import Progress
from ..bitstream.cameras import rotation_matrix
from ..bitstream.header import RenderInfo
from ..bitstream.reconstruction import Reconstruction
from ..formats.harmonics import harmonics
from ..formats.packing import OPACITY_LEAST, logits, opacities
from ..formats.splats import Splats
from ..rendering.camera import Camera
from ..rendering.gaussians import Gaussians, gaussians
from ..rendering.rasterise import Settings, draw, rasterise, rasterise_backward, settings_of
from ..rendering.view import View
from . import VIEWERS

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

# A Gaussian is dropped if its blending weight is below this, in pixels, in every view.
SEEN = 0.1
# The ridge of the regression, relative to the sum of the weights.
_RIDGE = 1e-4
# The number of anchors whose equations are solved together. Degree 3 takes 2.5 KB for each of their Gaussians.
_GROUP = 4096
# The shortest length, so that the logarithm is finite.
_LENGTH_LEAST = 1e-20


@dataclass(frozen=True)
class Fitted:
    """The result of a fit. splats: the Gaussians. of: the number that the masks of the scene keep."""

    splats: Splats
    of: int


def fit(view: View, cameras: Sequence[Camera], degree: int, iterations: int, progress: Progress) -> Fitted:
    """Returns Gaussians that look like a scene from the given cameras.

    degree: of the harmonics, 0 to 3. iterations: of the least squares on the images. Raises ValueError if no camera
    sees a Gaussian, and as rasterise.
    """
    weights = _blending_weights(view, cameras, progress)
    seen = np.maximum.reduce(weights) >= SEEN
    if not seen.any():
        raise ValueError("no camera sees a Gaussian")
    splats = _regression(view, cameras, weights, seen, degree, progress)
    splats = _least_squares(view, splats, cameras, iterations, progress)
    return Fitted(splats, int(view.masks.sum()))


def viewed(info: RenderInfo) -> Settings:
    """Returns the render settings of a viewer that shows the splats of a scene."""
    return replace(settings_of(info), low_pass=VIEWERS)


def agreement(view: View, splats: Splats, cameras: Sequence[Camera], progress: Progress) -> float:
    """Returns the mean over cameras of the PSNR in dB of Gaussians, as viewers draw them, to the drawn scene.

    It is infinite if all images are the same. Raises ValueError as rasterise.
    """
    settings, decibels = viewed(view.info), []
    for number, camera in enumerate(cameras):
        progress("measure", number, len(cameras))
        right, image = view.blended(camera), draw(splats, camera, settings).image
        error = np.mean((np.clip(right, 0, 1).astype(np.float64) - np.clip(image, 0, 1)) ** 2)
        decibels.append(-10 * math.log10(error) if error else math.inf)
    progress("measure", len(cameras), len(cameras))
    return sum(decibels) / len(decibels)


def _seen_by(view: View, values: Reconstruction, masks: NDArray[np.bool_], camera: Camera) -> Gaussians:
    return gaussians(values, masks, view.networks, camera, view.info.distance_unit)


def _blending_weights(view: View, cameras: Sequence[Camera], progress: Progress) -> list[F32]:
    """Returns the blending weights of all offsets of all anchors in each view, float32 [N * K] each, in pixels."""
    settings, count = settings_of(view.info), view.masks.shape[1]
    listed = []
    for number, camera in enumerate(cameras):
        progress("views", number, len(cameras))
        g = _seen_by(view, view.values, view.masks, camera)
        drawn = rasterise(g.mean, g.quaternion, g.lengths, g.opacity, g.colour, camera, settings)
        weights = np.zeros(view.masks.size, np.float32)
        # All three channels have the same derivative.
        weights[g.anchor * count + g.offset] = rasterise_backward(drawn, np.ones_like(drawn.image)).colour[:, 0]
        listed.append(weights)
    progress("views", len(cameras), len(cameras))
    return listed


def _regression(
    view: View, cameras: Sequence[Camera], weights: list[F32], seen: NDArray[np.bool_], degree: int, progress: Progress
) -> Splats:
    """Returns the visible Gaussians, each fitted by itself. seen: bool [N * K]."""
    count, anchors = view.masks.shape[1], len(view.masks)
    parts = []
    for begin in range(0, anchors, _GROUP):
        progress("regression", begin, anchors)
        group = slice(begin, begin + _GROUP)
        v = view.values
        values = Reconstruction(v.positions[group], v.features[group], v.scalings[group], v.offsets[group])
        place = slice(begin * count, (begin + _GROUP) * count)
        sums = _Sums(np.flatnonzero(seen[place]), degree)
        for camera, weight in zip(cameras, weights, strict=True):
            visible = _seen_by(view, values, view.masks[group], camera)
            sums.add(visible, visible.anchor * count + visible.offset, weight[place], camera)
        parts.append(sums.splats())
    progress("regression", anchors, anchors)
    return Splats(*map(np.concatenate, zip(*(vars(part).values() for part in parts), strict=True)))


class _Sums:
    """Weighted sums over views of the properties of n Gaussians, and their normal equations."""

    def __init__(self, members: I64, degree: int) -> None:
        """members: the numbers of their offsets in a group, ascending."""
        n, size = len(members), (degree + 1) ** 2
        self._members, self._degree = members, degree
        self._weight, self._area, self._opacity = np.zeros(n), np.zeros(n), np.zeros(n)
        self._covariance = np.zeros((n, 3, 3))
        self._mean = np.zeros((n, 3), np.float32)
        self._left, self._right = np.zeros((n, size, size)), np.zeros((n, size, 3))

    def add(self, visible: Gaussians, offset: I64, weights: F32, camera: Camera) -> None:
        """Adds a view. offset: int64, that of each visible Gaussian within the group. weights: of all offsets of it."""
        chosen = np.isin(offset, self._members) & (weights[offset] > 0)
        at = np.searchsorted(self._members, offset[chosen])
        weight = weights[offset[chosen]].astype(np.float64)
        opacity, mean = visible.opacity[chosen].astype(np.float64), visible.mean[chosen]
        # Weight divided by opacity does not favour views in which the Gaussian is more opaque.
        area = weight / np.maximum(opacity, OPACITY_LEAST)
        axes = rotation_matrix(visible.quaternion[chosen].astype(np.float64))
        lengths = 2 * np.log(np.maximum(visible.lengths[chosen].astype(np.float64), _LENGTH_LEAST))
        basis = harmonics(mean, camera.centre, self._degree)
        self._mean[at] = mean
        self._weight[at] += weight
        self._area[at] += area
        self._opacity[at] += area * opacity
        self._covariance[at] += weight[:, None, None] * (axes * lengths[:, None, :]) @ axes.transpose(0, 2, 1)
        weighted = weight[:, None] * basis
        self._left[at] += weighted[:, :, None] * basis[:, None, :]
        self._right[at] += weighted[:, :, None] * (visible.colour[chosen].astype(np.float64) - 0.5)[:, None, :]

    def splats(self) -> Splats:
        """Returns the means and the solutions."""
        weight = self._weight[:, None, None]
        ridge = _RIDGE * np.eye(self._left.shape[1])
        # The ridge does not pull the mean colour to grey.
        ridge[0, 0] = 0
        solved = np.linalg.solve(self._left / weight + ridge, self._right / weight)
        values, axes = np.linalg.eigh(self._covariance / weight)
        axes[np.linalg.det(axes) < 0, :, 0] *= -1
        return Splats(
            self._mean,
            solved[:, 0].astype(np.float32),
            solved[:, 1:].astype(np.float32),
            logits(self._opacity / self._area).astype(np.float32),
            (values / 2).astype(np.float32),
            Rotation.from_matrix(axes).as_quat(scalar_first=True).astype(np.float32),
        )


def _least_squares(
    view: View, splats: Splats, cameras: Sequence[Camera], iterations: int, progress: Progress
) -> Splats:
    """Returns the Gaussians with improved coefficients.

    The coefficients are refined by conjugate gradient steps on the normal equations of the images.
    """
    settings, degree = viewed(view.info), splats.degree
    geometry = splats.mean, splats.quaternion, np.exp(splats.scale), opacities(splats)
    black = replace(settings, background=(0.0, 0.0, 0.0))
    solution = splats.coefficients.astype(np.float64)
    stages = iterations + 1

    def through(coefficients: F64, target: Callable[[Camera], F32] | None, stage: int) -> F64:
        """Returns the images of coefficients, or the residual to a target, mapped back to coefficients."""
        out = np.zeros_like(coefficients)
        for number, camera in enumerate(cameras):
            progress("images", stage * len(cameras) + number, stages * len(cameras))
            basis = harmonics(splats.mean, camera.centre, degree)
            colour = np.einsum("nk,nkc->nc", basis, coefficients) + (0.5 if target else 0)
            drawn = rasterise(*geometry, colour, camera, settings if target else black)
            image = target(camera) - drawn.image if target else drawn.image
            out += basis[:, :, None] * rasterise_backward(drawn, image).colour[:, None, :]
        return out

    if iterations:
        residual = through(solution, view.draw, 0)
        step, square = residual.copy(), float((residual**2).sum())
        for number in range(iterations):
            carried = through(step, None, number + 1)
            curvature = float((step * carried).sum())
            if curvature <= 0:
                # The fit has converged.
                break
            solution += square / curvature * step
            residual -= square / curvature * carried
            last, square = square, float((residual**2).sum())
            step = residual + square / last * step
        progress("images", stages * len(cameras), stages * len(cameras))
    return replace(splats, base=solution[:, 0].astype(np.float32), rest=solution[:, 1:].astype(np.float32))
