"""Rendering networks of a static scene that are linear decoders, and the symbols for them.

An anchor has one Gaussian and one feature for each of its numbers, or for each combination of its colours. Feature 0 is
the class of the anchor, from 0 to CLASSES - 1, which selects the steps of the others: the anchors of class 0 matter
most, and have the smallest steps. Each hidden unit belongs to a feature and a class k. Its value is the feature plus
MIDDLE for anchors of class k, 0 for lower classes, and ACTIVATION_MAX for higher ones.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..bitstream.networks import ACCUMULATOR_BOUND, ACTIVATION_MAX, EXPONENT_MAX, WEIGHT_MAX, Layer
from ..bitstream.splat import OUTPUT_BITS

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

MIDDLE = 512
# The largest distance of a hidden unit from MIDDLE.
FAR = MIDDLE - 1
# The largest step of a hidden unit, of which the first one is taken that suits SPEC 7.2, which bounds a row's weights.
# Gains keep larger steps of features below it. A number then reaches at least FAR times half of it from its middle,
# divided by the ratio of two steps.
STEP_MAX = (1 / 8, 1 / 16, 1 / 32, 1 / 64)


@dataclass(frozen=True, eq=False)
class Linear:
    """The linear maps from the features of some numbers to these numbers, one for each class.

    matrix: [C, numbers, features]. middle: [C, numbers]. most: the largest magnitude of a feature, int64 [C, features].
    """

    matrix: F64
    middle: F64
    most: I64

    def symbols(self, numbers: F64, k: int) -> I64:
        """Returns the features [n, features] that are nearest to numbers [n, numbers] of class k, in least squares."""
        exact = (numbers - self.middle[k]) @ np.linalg.pinv(self.matrix[k]).T
        return np.rint(exact).clip(-self.most[k], self.most[k]).astype(np.int64)

    def numbers(self, symbols: I64, k: int) -> F64:
        """Returns what the network makes of features of class k, before its rounding."""
        numbers: F64 = symbols @ self.matrix[k].T + self.middle[k]
        return numbers


def network(steps: F64, basis: F64, middle: F64, inputs: I64, count: int, width: int) -> tuple[list[Layer], Linear]:
    """Returns a rendering network, and what its integers compute.

    steps: [C, m], of each class and feature. basis: [numbers, m]. middle: [C, numbers]. inputs: the m features, of
    `count`. width: of the hidden layer, at least hidden_units. Raises ValueError for numbers beyond SPEC 7.2.
    """
    classes, m = steps.shape
    for most in STEP_MAX:
        gain = 2.0 ** np.ceil(np.log2(np.maximum(steps / most, 1)))
        maps = (steps / gain)[:, None, :] * basis * 2.0**OUTPUT_BITS
        rows = [_row(maps[:, r], middle[:, r] * 2.0**OUTPUT_BITS, width) for r in range(len(basis))]
        fitting = [row for row in rows if row]
        if len(fitting) == len(rows):
            break
    else:
        what = f"sizes, colours or harmonics of some Gaussians, up to {np.abs(middle).max():.3g}, are too far from"
        raise ValueError(f"{what} those of the others: remove them in an editor of splats, or convert without --fast")
    first, bias = np.zeros((width, count), np.float32), np.zeros(width, np.float32)
    for k in range(classes):
        units = np.arange(k * m, (k + 1) * m)
        first[units, inputs], first[units, 0] = gain[k], ACTIVATION_MAX
        bias[units] = MIDDLE - ACTIVATION_MAX * k
        if k:
            # ACTIVATION_MAX in each class from k on; and 1 in class k, 2 in the next one, and so on.
            large = classes * m + 2 * (k - 1)
            first[large, 0], bias[large] = ACTIVATION_MAX, -ACTIVATION_MAX * (k - 1)
            first[large + 1, 0], bias[large + 1] = 1, 1 - k
    last, end = np.array([weight for weight, _ in fitting]), np.array([own for _, own in fitting])
    matrix = last[:, : classes * m].reshape(len(basis), classes, m).transpose(1, 0, 2) * gain[:, None, :]
    # With all other features 0.
    hidden = (np.arange(classes)[:, None] * first[:, 0].astype(np.float64) + bias).clip(0, ACTIVATION_MAX)
    own = hidden @ last.T + end
    layers = [(first, bias), (last.astype(np.float32), end.astype(np.float32))]
    return layers, Linear(matrix * 2.0**-OUTPUT_BITS, own * 2.0**-OUTPUT_BITS, _most(gain))


def _most(gain: F64) -> I64:
    """Returns the largest magnitudes of features for which units of other classes stay at their ends."""
    most = FAR // gain
    for k in range(len(gain)):
        for other in range(len(gain)):
            if other != k:
                most[k] = np.minimum(most[k], (ACTIVATION_MAX * abs(k - other) - MIDDLE) // gain[other])
    return most.astype(np.int64)


def hidden_units(classes: int, m: int) -> int:
    """Returns the number of hidden units of a network for m features."""
    return classes * m + 2 * (classes - 1)


def _row(maps: F64, middle: F64, width: int) -> tuple[F64, float] | None:
    """Returns the weights and the bias of an output, on the finest grid that SPEC 7.2 allows, None if there is none.

    maps: [C, m]. middle: [C].
    """
    classes, m = maps.shape
    for exponent in range(EXPONENT_MAX, -1, -1):
        integers = np.rint(np.ldexp(maps, exponent))
        weight = np.zeros(width)
        weight[: classes * m] = integers.reshape(-1)
        each, before, middles = integers.sum(axis=1), 0.0, np.rint(np.ldexp(middle, exponent))
        for k in range(1, classes):
            # The constant parts of the units of class k - 1, now at their end, and of class k, at their middle.
            constant = (ACTIVATION_MAX - MIDDLE) * each[k - 1] + MIDDLE * each[k] - (middles[k] - middles[k - 1])
            large = np.rint(constant / ACTIVATION_MAX)
            at = classes * m + 2 * (k - 1)
            rest = ACTIVATION_MAX * large - constant
            weight[at : at + 2], before = (-large, rest - before), rest
        bias = middles[0] - MIDDLE * each[0]
        reach = np.abs(weight).sum() * ACTIVATION_MAX + abs(bias) + 2.0**exponent
        if np.abs(weight).max() <= WEIGHT_MAX and reach < ACCUMULATOR_BOUND:
            # +0 removes -0, which cannot be packed.
            return np.ldexp(weight, -exponent) + 0.0, float(np.ldexp(bias, -exponent)) + 0.0
    return None
