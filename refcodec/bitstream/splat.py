"""Clause 9.4: the plain Gaussians of a static scene, in integers up to their last rounding."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from .conventions import F32, Int64, round_to_f32
from .dimensions import RENDERING
from .networks import ACTIVATION_MAX, IntNetwork, Layer, derive_networks

# SPEC 2.5 and 9.4
OUTPUT_BITS, SCALING_BITS = 12, 16
SCALING_BOUND = 27 << SCALING_BITS
EXP2 = (1073741824, 744260848, 257945537, 59571654, 10398739, 1330132, 234908)
LOG2_E = 1549082005
# SPEC 9.4: the numbers of a Gaussian. LENGTHS are the logarithms of axis lengths, LOGIT is that of the opacity.
MEAN, LENGTHS, QUATERNION, LOGIT, HARMONICS = slice(0, 3), slice(3, 6), slice(6, 10), 10, slice(11, None)
# Anchors whose Gaussians are computed at once, by all threads.
SPLAT_ANCHORS = 16384
# The order of the kernel.
COLUMNS = MEAN, LENGTHS, QUATERNION, slice(LOGIT, LOGIT + 1), HARMONICS


# The integer rendering networks of a static scene, by name.
Rendering = Mapping[str, IntNetwork]


def derive_rendering(networks: Mapping[str, list[Layer]]) -> Rendering:
    """SPEC 9.4: returns the integer rendering networks of a static scene, by name. Raises BoundError."""
    return derive_networks({name: networks[name] for name in RENDERING}, names=RENDERING)


def _fixed(values: F32, bits: int, bound: int) -> Int64:
    """Returns the values in 2^-bits, rounded half up and limited to -bound to bound."""
    limit = bound / 2.0**bits + 1
    # Exact in float64: a 24-bit significand below 2^24, times a power of two, plus 1/2.
    scaled = np.floor(np.clip(values.astype(np.float64), -limit, limit) * 2.0**bits + 0.5)
    fixed: Int64 = np.clip(scaled, -bound, bound).astype(np.int64)
    return fixed


def exponential(t: Int64) -> tuple[Int64, Int64]:
    """SPEC 9.4, EXPONENTIAL: returns (m, n), where exp(t / 2^SCALING_BITS) is nearly m * 2^n. |t| <= SCALING_BOUND."""
    y = t * LOG2_E
    fraction = (y & ((1 << 46) - 1)) >> 16
    m = np.full_like(y, EXP2[-1])
    for coefficient in EXP2[-2::-1]:
        m = coefficient + (m * fraction >> 30)
    return m, (y >> 46) - 30


# SPEC 9.4
def splat(
    networks: Rendering, positions: F32, features: F32, scalings: F32, offsets: F32, masks: NDArray[np.bool_]
) -> F32:
    """SPEC 9.4, SPLAT: returns the Gaussians of some anchors, float32 [kept offsets, 11 + colour_outputs].

    networks: the result of derive_rendering. positions, features, scalings, offsets: the values of the anchors, as in
    Reconstruction. masks: bool [n, K].
    """
    count, k = masks.shape
    inputs = _fixed(features, 0, ACTIVATION_MAX)
    outputs = (networks[name](inputs).astype(np.int64) for name in RENDERING)
    opacity, covariance, colour = (each.reshape(count, k, each.shape[1] // k) for each in outputs)
    anchor, offset = np.nonzero(masks)
    s = _fixed(scalings, SCALING_BITS, SCALING_BOUND)[anchor]
    c = covariance[anchor, offset]
    m, n = exponential(s[:, :3])
    # A significand of 24 bits, as an integer.
    significand, exponent = np.frexp(offsets[anchor, offset].astype(np.float64))
    own = np.ldexp(significand, 24).astype(np.int64)
    # SPEC 9.2: an offset is zero or at least 2^-64, so that no product is subnormal.
    shift = np.ldexp((own * m).astype(np.float32), n + exponent - 24)
    # Exact in float64 or rounded to more than twice the bits of a float32, and thus rounded once. -0 becomes +0.
    mean = (positions[anchor].astype(np.float64) + shift.astype(np.float64)).astype(np.float32) + np.float32(0)
    quaternion = c[:, 3:]
    quaternion[~quaternion.any(axis=1)] = [1 << OUTPUT_BITS, 0, 0, 0]
    others = np.concatenate([quaternion, opacity[anchor, offset], colour[anchor, offset]], axis=1)
    lengths = s[:, 3:] + (c[:, :3] << (SCALING_BITS - OUTPUT_BITS))
    return np.concatenate(
        [mean, round_to_f32(lengths, -SCALING_BITS), round_to_f32(others, -OUTPUT_BITS)], axis=1, dtype=np.float32
    )
