"""The planes of the hyperprior as pictures, channel by channel."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...bitstream.planes import PLANES, assemble_planes
from .measures import Measures
from .pictures import png

F64 = NDArray[np.float64]

# The most pixels along a side of a picture. A pixel of a larger plane is the mean of several points.
_SIDE = 192
# The share of symbols within the scale of greys.
_HELD = 0.995


@dataclass(frozen=True)
class Plane:
    """A plane. symbols: int16 [ch, s, s]. bits: float64 [ch], the code length of each channel.

    most: the symbol at the end of the scale of greys. join: points along a side of a pixel. pictures: PNG, one for each
    channel.
    """

    symbols: NDArray[np.int16]
    bits: F64
    most: int
    join: int
    pictures: list[bytes]


def planes(measures: Measures) -> list[Plane]:
    """Returns both planes, or nothing if the file has none."""
    assert measures.scene is not None
    channels = measures.scene.dimensions.plane_channels
    if not channels:
        return []
    bits = measures.tallies["planes"].channel_bits.reshape(PLANES, channels)
    first, second = assemble_planes(measures.scene.planes)
    return [_plane(first, bits[0]), _plane(second, bits[1:].sum(axis=0))]


def _plane(symbols: NDArray[np.int16], bits: F64) -> Plane:
    magnitude = np.sort(np.abs(symbols), axis=None)
    most = max(1, int(magnitude[int(_HELD * (len(magnitude) - 1))]))
    join = -(-symbols.shape[1] // _SIDE)
    greys = [np.clip(_means(channel, join) / most, -1, 1) for channel in symbols]
    pictures = [png(np.floor(127.5 + 127.5 * grey).astype(np.uint8), grey=True) for grey in greys]
    return Plane(symbols, bits, most, join, pictures)


def _means(symbols: NDArray[np.int16], join: int) -> F64:
    """Returns the means of blocks of join x join points. Those at the ends may be smaller."""
    edges = np.arange(0, len(symbols), join)
    total = np.add.reduceat(np.add.reduceat(symbols.astype(np.float64), edges, axis=0), edges, axis=1)
    size = np.minimum(len(symbols) - edges, join)
    return np.asarray(total / (size[:, None] * size[None]))
