"""The importance of each number of a Gaussian: what an error in it costs in pictures."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ..formats.splats import Splats
from ..rendering.camera import Camera
from ..rendering.rasterise import Settings
from .drawing import drawn

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]

# The columns of a table of numbers, [n, 7 + 3 H] for H harmonics: logarithms of the lengths, the logit of the opacity,
# x, y, z of a quaternion whose w is 1, and red, green and blue of each harmonic.
LENGTHS, LOGIT, TURN, COLOUR = slice(0, 3), slice(3, 4), slice(4, 7), slice(7, None)
# Random pictures of signs, for each camera.
PROBES = 2
# Of a Gaussian that fills a picture: the squared contrast to what is behind it, the mean square of exp(-r^2 / 2) over
# its pixels, and the mean square of a harmonic over directions. The least axis is this share of the longest one: a
# thinner one is below a pixel.
CONTRAST, SQUARE, HARMONIC, THIN = 0.1, 0.5, 1 / (4 * np.pi), 0.02


def _product(a: F64, b: F64) -> F64:
    """Returns the products of quaternions [..., 4]."""
    (aw, ax, ay, az), (bw, bx, by, bz) = np.moveaxis(a, -1, 0), np.moveaxis(b, -1, 0)
    return np.stack(
        [
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ],
        axis=-1,
    )


def _axis_turns() -> tuple[F64, NDArray[np.int64]]:
    """Returns the 24 rotations that permute the axes: quaternions, and for each new axis the old one, [24, 3]."""
    half = np.sqrt(0.5)
    turns = [np.array([1.0, 0, 0, 0])]
    for turn in turns:
        for i in range(3):
            quarter = np.zeros(4)
            quarter[[0, 1 + i]] = half
            new = _product(turn, quarter)
            if all(abs(new @ old) < 0.99 for old in turns):
                turns.append(new)
    axes = []
    for turn in turns:
        vectors = np.concatenate([np.zeros((3, 1)), np.eye(3)], axis=1)
        moved = _product(_product(turn[None], vectors), turn[None] * (1, -1, -1, -1))[:, 1:]
        axes.append(np.abs(moved).argmax(axis=1))
    return np.array(turns), np.array(axes)


def numbers(splats: Splats) -> F64:
    """Returns the table of numbers of Gaussians, float64 [n, 7 + 3 H].

    Of the 24 equal choices of a Gaussian's axes, it has the one whose rotation is the smallest: x, y and z are then
    below 1, and lengths are those along the world's axes, nearly.
    """
    count, quaternion = len(splats.mean), splats.unit_quaternions()
    turns, axes = _axis_turns()
    # The rotation part w of the product with a turn is a scalar product.
    chosen = np.abs(quaternion @ (turns * (1, -1, -1, -1)).T).argmax(axis=1)
    turned = _product(quaternion, turns[chosen])
    lengths = np.take_along_axis(splats.scale.astype(np.float64), axes[chosen], axis=1)
    colour = np.concatenate([splats.base, splats.rest.reshape(count, -1)], axis=1)
    own = turned[:, 1:] / turned[:, :1]
    return np.concatenate([lengths, splats.opacity[:, None], own, colour], axis=1, dtype=np.float64)


def tensors_of(mean: Tensor, table: Tensor) -> dict[str, Tensor]:
    """Returns Gaussians as drawing.Tensors. mean: [n, 3]. table: [n, 7 + 3 H]."""
    colour = table[:, COLOUR].reshape(len(table), -1, 3)
    return {
        "mean": mean,
        "base": colour[:, 0],
        "rest": colour[:, 1:],
        "opacity": table[:, LOGIT.start],
        "scale": table[:, LENGTHS],
        "quaternion": torch.cat([torch.ones_like(table[:, :1]), table[:, TURN]], dim=1),
    }


def own_importance(table: F64) -> tuple[F64, F64, F64]:
    """Returns the importance in a picture that a Gaussian fills: of means [n, 3], of the table, and of absence [n].

    An error matters in relation to the Gaussian's own size, and by the square of its opacity. A view along an axis
    shows the other two: the area that a thin axis has counts as little as it is.
    """
    alpha = 1 / (1 + np.exp(-table[:, LOGIT]))
    lengths = np.exp(table[:, LENGTHS])
    lengths = np.maximum(lengths, THIN * lengths.max(axis=1, keepdims=True))
    first, second, third = -np.sort(-lengths, axis=1).T[:, :, None]
    seen = alpha**2 * SQUARE * CONTRAST

    def turned(long: F64, short: F64, area: F64) -> F64:
        """A turn in the plane of two axes moves their ends across."""
        moved: F64 = area * (long**2 - short**2) ** 2 / (long**3 * short)
        return moved

    by_number = np.empty_like(table)
    by_number[:, LENGTHS] = seen / 2 * (1 + (second + third) / first) / 3
    by_number[:, LOGIT] = (alpha * (1 - alpha)) ** 2 * SQUARE * CONTRAST
    turns = turned(first, second, np.ones_like(first)) + turned(first, third, third / second)
    by_number[:, TURN] = 4 * seen * (turns + turned(second, third, third / first)) / 3
    by_number[:, COLOUR] = alpha**2 * SQUARE * HARMONIC
    by_mean = np.repeat(seen * (1 / first**2 + 1 / (first * second) + 1 / (first * third)) / 3, 3, axis=1)
    return by_mean, by_number, seen[:, 0]


def importance(
    mean: F32, table: F64, cameras: Sequence[Camera], settings: Settings, progress: Callable[[str, int, int], None]
) -> tuple[F64, F64]:
    """Returns the importance of each number: of means [n, 3], and of the table [n, 7 + 3 H].

    It is the mean over pixels, channels and cameras of the squared derivative of a pixel. Backward passes of random
    signs estimate it: the expectation of the squared sum of derivatives with these signs is the sum of their squares.
    """
    generator = torch.Generator().manual_seed(0)
    values = [torch.from_numpy(v.astype(np.float32)).requires_grad_() for v in (mean, table)]
    squares = [np.zeros(v.shape) for v in values]
    for number, camera in enumerate(cameras, start=1):
        image, _, _ = drawn(tensors_of(*values), camera, settings)
        for probe in range(PROBES):
            signs = torch.randint(0, 2, image.shape, generator=generator).float() * 2 - 1
            slopes = torch.autograd.grad(image, values, signs, retain_graph=probe + 1 < PROBES)
            for i, slope in enumerate(slopes):
                squares[i] += slope.double().numpy() ** 2 / (image.numel() * PROBES * len(cameras))
        progress("measure", number, len(cameras))
    return squares[0], squares[1]
