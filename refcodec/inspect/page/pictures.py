"""Pictures in the format PNG, without a library: anchors as points, planes, and the scales of colours and greys."""

import struct
import zlib
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...bitstream.planes import PLANES, assemble_planes
from .measures import F64, SceneMeasures

Bytes2 = NDArray[np.uint8]

# From few to many. All of them are visible on the dark ground of a picture.
_STOPS = [(66, 72, 160), (52, 110, 170), (38, 145, 150), (60, 180, 115), (150, 210, 60), (253, 231, 37)]
# Index 0 of a picture with colours is its ground.
GROUND = (18, 20, 24)
COLOURS = 255
# Columns and rows of a picture of anchors, and the empty rows that it has above and below.
SIDE = 440
_MARGIN = 12
# The most pixels along a side of a picture of a plane. A pixel of a larger one is the mean of several points.
_PLANE_SIDE = 192
# The share of symbols within the scale of greys.
_HELD = 0.995


def palette() -> Bytes2:
    """Returns the ground and the colours of the scale after it, uint8 [256, 3]."""
    stops = np.array(_STOPS, dtype=np.float64)
    at = np.linspace(0, len(stops) - 1, COLOURS)
    ramp = np.stack([np.interp(at, np.arange(len(stops)), stops[:, i]) for i in range(3)], axis=1)
    return np.concatenate([[GROUND], np.floor(ramp + 0.5)]).astype(np.uint8)


def png(pixels: Bytes2, grey: bool = False) -> bytes:
    """Returns a picture as PNG. pixels: uint8 [rows, columns], indices of `palette`, or greys from 0 to 255."""
    rows, columns = pixels.shape
    head = struct.pack(">IIBBBBB", columns, rows, 8, 0 if grey else 3, 0, 0, 0)
    # Each row begins with the number of its filter, where 0 stands for no filter.
    lines = np.concatenate([np.zeros((rows, 1), np.uint8), pixels], axis=1)
    colours = [] if grey else [(b"PLTE", palette().tobytes())]
    parts = [(b"IHDR", head), *colours, (b"IDAT", zlib.compress(lines.tobytes(), 9)), (b"IEND", b"")]
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data)) for kind, data in parts
    )


def ramp(grey: bool = False) -> bytes:
    """Returns the scale of colours or greys as a PNG of one row."""
    return png(np.arange(0 if grey else 1, 256, dtype=np.uint8)[None], grey)


@dataclass(frozen=True)
class AnchorView:
    """Anchors in a picture. name: of the view. points: float64 [n, 2], columns and rows, 0 to SIDE. seen: bool [n]."""

    name: str
    points: F64
    seen: NDArray[np.bool_]


def drawn(view: AnchorView, values: F64, low: float, high: float) -> bytes:
    """Returns a view as PNG, SIDE pixels wide, without the empty rows above and below.

    A pixel has the colour of the mean of the anchors on it. values: float64 [n]. low, high: the ends of the scale.
    """
    points = view.points[view.seen].astype(np.int64)
    each = values[view.seen]
    # Few points are drawn larger, for visibility.
    size = int(np.clip(round(2.2 * SIDE / max(len(points), 1) ** 0.5), 2, 7))
    total, count = np.zeros(SIDE * SIDE), np.zeros(SIDE * SIDE)
    for down in range(size):
        for across in range(size):
            place = points + np.array([across - size // 2, down - size // 2])
            fits = ((place >= 0) & (place < SIDE)).all(axis=1)
            at = place[fits, 1] * SIDE + place[fits, 0]
            total += np.bincount(at, each[fits], SIDE * SIDE)
            count += np.bincount(at, minlength=SIDE * SIDE)
    unit = np.clip((total / np.maximum(count, 1) - low) / max(high - low, 1e-9), 0, 1)
    pixels = np.where(count > 0, 1 + np.floor(unit * (COLOURS - 1) + 0.5), 0).astype(np.uint8).reshape(SIDE, SIDE)
    used = np.flatnonzero(pixels.any(axis=1))
    first, last = (int(used[0]), int(used[-1])) if len(used) else (0, 0)
    return png(pixels[max(0, first - _MARGIN) : last + _MARGIN + 1])


@dataclass(frozen=True)
class PlanePictures:
    """A plane. symbols: int16 [ch, s, s]. bits: float64 [ch], the code length of each channel.

    most: the symbol at the end of the scale of greys. join: points along a side of a pixel. pictures: PNG, one for each
    channel.
    """

    symbols: NDArray[np.int16]
    bits: F64
    most: int
    join: int
    pictures: list[bytes]


def planes(measures: SceneMeasures) -> list[PlanePictures]:
    """Returns both planes, or nothing if the file has none."""
    assert measures.scene is not None
    channels = measures.scene.dimensions.plane_channels
    if not channels:
        return []
    bits = measures.tallies["planes"].channel_bits.reshape(PLANES, channels)
    first, second = assemble_planes(measures.scene.planes)
    return [_plane(first, bits[0]), _plane(second, bits[1:].sum(axis=0))]


def _plane(symbols: NDArray[np.int16], bits: F64) -> PlanePictures:
    magnitude = np.sort(np.abs(symbols), axis=None)
    most = max(1, int(magnitude[int(_HELD * (len(magnitude) - 1))]))
    join = -(-symbols.shape[1] // _PLANE_SIDE)
    greys = [np.clip(_means(channel, join) / most, -1, 1) for channel in symbols]
    pictures = [png(np.floor(127.5 + 127.5 * grey).astype(np.uint8), grey=True) for grey in greys]
    return PlanePictures(symbols, bits, most, join, pictures)


def _means(symbols: NDArray[np.int16], join: int) -> F64:
    """Returns the means of blocks of join x join points. Those at the ends may be smaller."""
    edges = np.arange(0, len(symbols), join)
    total = np.add.reduceat(np.add.reduceat(symbols.astype(np.float64), edges, axis=0), edges, axis=1)
    size = np.minimum(len(symbols) - edges, join)
    return np.asarray(total / (size[:, None] * size[None]))
