"""SPZ files: Gaussians in fixed point, stored attribute by attribute, compressed with gzip.

The format is that of Niantic's library (https://github.com/nianticlabs/spz), version 3. Its axes point right, up and
back. Those of PLY files point right, down and forward, so y and z change their signs.
"""

from __future__ import annotations

import gzip
import re
import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..files.outputs import Kind
from .splats import Packed, Splats, logits, nearest_bytes, opacities, smaller_components, with_largest

MAGIC, _VERSION = b"NGSP", 3
# The gzip time marks the file as written by refcodec. It is unused otherwise, and constant for reproducible bytes.
_STAMP = b"C3GS"
SPZ = Kind("an SPZ file that refcodec wrote", re.compile(rb"\x1f\x8b\x08\x00" + _STAMP))

# Positions have 24 bits. Steps below 2^-20 would exceed the precision of float32.
_POSITION_MOST, _FRACTION_MOST = (1 << 23) - 1, 20
# Opacities o are stored as 255 o, coefficients c of degree 0 as 255 (0.15 c + 0.5), scales s as 16 (s + 10).
COLOUR, SCALE, SCALE_LEAST = 0.15, 16, -10
# Other coefficients c are stored as 128 c + 128 in a byte. They are from -1 to 1. An encoder sets the lowest bits to 0,
# which gzip compresses. On photographs, files of 7 bits lose 0.01 dB, of 6 up to 0.06, and with the 5 bits of degree 1
# and the 4 of the others of Niantic's library up to 0.9 (benchmarks/RESULTS.md, closed studies).
_HARMONIC = 128
BITS_LEAST, BITS, BITS_MOST = 4, 7, 8
# A step of positions is at most this share of the longest axis of nine in ten Gaussians. It loses nothing visible. In
# scenes of an ordinary size it is 2^-12, as in Niantic's library.
_STEP_SHARE, _QUANTILE = 1 / 64, 0.1
# Components of quaternions have a sign and nine bits. All but the largest are at most the square root of 1/2.
_COMPONENT = 511 * np.sqrt(2)
# The signs of x, y and z, and of the harmonics besides the first, when y and z are negated.
_AXES = np.array([1, -1, -1])
HARMONIC_SIGNS = np.array([-1, -1, 1, -1, 1, 1, -1, 1, -1, 1, -1, -1, 1, -1, 1])


def spz_file(splats: Splats, bits: int = BITS) -> Packed:
    """Returns the file. splats: at least one. bits: of each coefficient of degree 1 and more, BITS_LEAST to BITS_MOST.

    Raises ValueError for positions of 2^23 or more, which the format cannot hold.
    """
    fraction = _fraction(splats)
    fixed = np.rint(splats.mean.astype(np.float64) * _AXES * 2.0**fraction)
    fixed = np.clip(fixed, -_POSITION_MOST, _POSITION_MOST).astype("<i4")
    alpha = nearest_bytes(opacities(splats) * 255)
    base = nearest_bytes((COLOUR * splats.base + 0.5) * 255)
    scale = nearest_bytes((splats.scale - SCALE_LEAST) * SCALE)
    # The library orders components x, y, z, w.
    largest, others = smaller_components(splats.unit_quaternions()[:, [1, 2, 3, 0]] * np.append(_AXES, 1))
    magnitude = np.minimum(np.floor(_COMPONENT * np.abs(others) + 0.5), 511).astype("<u4")
    turns = HARMONIC_SIGNS[: splats.rest.shape[1], None]
    step = 1 << (BITS_MOST - bits)
    rest = nearest_bytes(step * np.rint(_HARMONIC / step * splats.rest * turns) + _HARMONIC)
    parts = (
        # The lowest three bytes of each position, the lowest first.
        fixed.view(np.uint8).reshape(-1, 3, 4)[:, :, :3],
        *(alpha, base, scale),
        _packed(largest, others < 0, magnitude),
        rest,
    )
    head = MAGIC + struct.pack("<IIBBBB", _VERSION, len(fixed), splats.degree, fraction, 0, 0)
    data = gzip.compress(head + b"".join(map(_raw, parts)), mtime=int.from_bytes(_STAMP, "little"))
    read = with_largest(largest, np.where(others < 0, -1, 1) * magnitude / _COMPONENT)
    held = (
        fixed * _AXES / 2.0**fraction,
        (base / 255 - 0.5) / COLOUR,
        (rest.astype(np.float64) - _HARMONIC) / _HARMONIC * turns,
        logits(alpha / 255),
        scale / SCALE + SCALE_LEAST,
        (read * np.append(_AXES, 1))[:, [3, 0, 1, 2]],
    )
    return Packed(data, Splats(*(values.astype(np.float32) for values in held)))


def _raw(values: NDArray[Any]) -> bytes:
    return values.tobytes()


def _fraction(splats: Splats) -> int:
    """Returns the number of fractional bits of positions: those of a fine step, or fewer if the largest has no more."""
    largest = float(np.abs(splats.mean).max())
    if largest > _POSITION_MOST:
        raise ValueError(f"a position is at {largest:.6g}, but SPZ positions are below 2^23")
    most = min(_FRACTION_MOST, 22 - int(np.floor(np.log2(max(largest, 1.0)))))
    axis = float(np.quantile(splats.scale.max(axis=1), _QUANTILE)) / np.log(2)
    return int(np.clip(np.ceil(-np.log2(_STEP_SHARE) - axis), 0, most))


def _packed(largest: NDArray[np.int64], negative: NDArray[np.bool_], magnitude: NDArray[np.uint32]) -> NDArray[Any]:
    """Returns 32 bits for each quaternion: the index of the largest component, then the others, the first one highest.

    negative, magnitude: [n, 3], of the others.
    """
    packed = largest.astype("<u4")
    for sign, value in zip(negative.T, magnitude.T, strict=True):
        packed = (packed << np.uint32(10)) | (sign.astype("<u4") << np.uint32(9)) | value
    return packed.astype("<u4")
