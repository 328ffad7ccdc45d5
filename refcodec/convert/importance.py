"""The importance of each number of a Gaussian: what an error in it costs in pictures."""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from ..formats.packing import logistic
from ..formats.splats import Splats
from ..rendering.camera import Camera
from ..rendering.gaussians import static_shapes
from ..rendering.rasterise import Settings, draw, rasterise_backward

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]

# The columns of a table of numbers, [n, 7 + 3 H] for H harmonics: logarithms of the lengths, the logit of the opacity,
# x, y, z of a quaternion whose w is 1, and red, green and blue of each harmonic.
LENGTHS, LOGIT, TURN, COLOUR = slice(0, 3), slice(3, 4), slice(4, 7), slice(7, None)
# Gaussians of a block, whose temporary arrays stay in the cache.
BLOCK = 1 << 14
# Random pictures of signs, for each camera. One costs a million Gaussians 10 % of their bytes (own measurement).
PROBES, SIGNS = 2, np.array([-1, 1], np.float32)
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


def numbers(splats: Splats) -> F32:
    """Returns the table of numbers of Gaussians, float32 [n, 7 + 3 H].

    Of the 24 equal choices of a Gaussian's axes, it has the one whose rotation is the smallest: x, y and z are then
    below 1, and lengths are those along the world's axes, nearly.
    """
    turns, axes = _axis_turns()
    table = np.empty((len(splats.mean), COLOUR.start + splats.base.shape[1] * (1 + splats.rest.shape[1])), np.float32)
    for begin in range(0, len(table), BLOCK):
        rows = slice(begin, begin + BLOCK)
        part, own = Splats(*(values[rows] for values in vars(splats).values())), table[rows]
        quaternion = part.unit_quaternions()
        # The rotation part w of the product with a turn is a scalar product.
        chosen = np.abs(quaternion @ (turns * (1, -1, -1, -1)).T).argmax(axis=1)
        turned = _product(quaternion, turns[chosen])
        own[:, LENGTHS] = np.take_along_axis(part.scale, axes[chosen], axis=1)
        own[:, LOGIT.start], own[:, TURN] = part.opacity, turned[:, 1:] / turned[:, :1]
        own[:, COLOUR] = part.coefficients.reshape(len(own), -1)
    return table


def splats_of(mean: F32, table: F32) -> Splats:
    """Returns Gaussians of a table of numbers, mostly as views. mean: [n, 3]. table: float32 [n, 7 + 3 H]."""
    colour = table[:, COLOUR].reshape(len(table), (table.shape[1] - COLOUR.start) // 3, 3)
    quaternion = np.concatenate([np.ones_like(table[:, :1]), table[:, TURN]], axis=1)
    return Splats(mean, colour[:, 0], colour[:, 1:], table[:, LOGIT.start], table[:, LENGTHS], quaternion)


def own_importance(table: F32) -> F64:
    """Returns the importance in a picture that a Gaussian fills: [n, 6], as importance, and that of its absence.

    An error matters in relation to the Gaussian's own size, and by the square of its opacity. A view along an axis
    shows the other two: the area that a thin axis has counts as little as it is.
    """
    alpha = logistic(table[:, LOGIT.start].astype(np.float64))
    lengths = np.exp(table[:, LENGTHS].astype(np.float64))
    first, second, third = np.maximum(-np.sort(-lengths, axis=1).T, THIN * lengths.max(axis=1))
    shown = alpha**2 * SQUARE * CONTRAST

    def turned(long: F64, short: F64, area: F64 | float) -> F64:
        """A turn in the plane of two axes moves their ends across."""
        moved: F64 = area * (long**2 - short**2) ** 2 / (long**3 * short)
        return moved

    turns = turned(first, second, 1) + turned(first, third, third / second) + turned(second, third, third / first)
    columns = (
        shown * (1 / first**2 + 1 / (first * second) + 1 / (first * third)) / 3,
        shown / 2 * (1 + (second + third) / first) / 3,
        (alpha * (1 - alpha)) ** 2 * SQUARE * CONTRAST,
        4 * shown * turns / 3,
        alpha**2 * SQUARE * HARMONIC,
        shown,
    )
    return np.stack(columns, axis=1)


def importance(
    splats: Splats, cameras: Sequence[Camera], settings: Settings, progress: Callable[[str, int, int], None]
) -> F32:
    """Returns the importance of a number of each kind: of means, lengths, the logit, the turn and colours, [n, 5].

    It is the mean over pixels, channels and cameras of the squared derivative of a pixel. Backward passes of random
    signs estimate it: the expectation of the squared sum of derivatives with these signs is the sum of their squares.
    All pictures that show Gaussians count alike, as in a mean of PSNR: each is divided by the sum of its colours.
    """
    random, squares, totals = np.random.default_rng(0), np.zeros((len(splats.mean), 5), np.float32), list[float]()
    shapes = static_shapes(splats)
    _, _, lengths, opacity = shapes
    own = np.empty_like(squares)
    for number, camera in enumerate(cameras, start=1):
        drawing = draw(splats, camera, settings, shapes)
        for probe in range(PROBES):
            slopes = rasterise_backward(drawing, random.choice(SIGNS, drawing.image.shape))
            share = 1 / (drawing.image.size * PROBES)
            for begin in range(0, len(own), BLOCK):
                rows = slice(begin, begin + BLOCK)
                logit = (slopes.opacity[rows] * opacity[rows] * (1 - opacity[rows]))[:, None]
                parts = slopes.mean[rows], slopes.scale[rows] * lengths[rows], logit, slopes.quaternion[rows, 1:]
                for i, part in enumerate((*parts, slopes.colour[rows])):
                    square = np.square(part, dtype=np.float64) @ np.full(part.shape[1], share / part.shape[1])
                    own[rows, i] = square + own[rows, i] if probe else square
        # The mean of the squares of all harmonics is that of any direction.
        own[:, -1] *= HARMONIC
        totals.append(float(own[:, -1].sum(dtype=np.float64)))
        own /= np.float32(totals[-1] or 1)
        squares += own
        progress("measure", number, len(cameras))
    return squares * np.float32(sum(totals) / (len(cameras) * sum(total > 0 for total in totals) or 1))
