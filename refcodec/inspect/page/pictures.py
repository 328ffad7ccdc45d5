"""Pictures in the format PNG, without a library, and the scale of colours."""

from __future__ import annotations

import struct
import zlib

import numpy as np
from numpy.typing import NDArray

Bytes2 = NDArray[np.uint8]

# From few to many. All of them are visible on the dark ground of a picture.
_STOPS = [(66, 72, 160), (52, 110, 170), (38, 145, 150), (60, 180, 115), (150, 210, 60), (253, 231, 37)]
# Index 0 of a picture with colours is its ground.
GROUND = (18, 20, 24)
COLOURS = 255


def palette() -> Bytes2:
    """Returns the ground and the colours of the scale after it, uint8 [256, 3]."""
    stops = np.array(_STOPS, dtype=np.float64)
    at = np.linspace(0, len(stops) - 1, COLOURS)
    ramp = np.stack([np.interp(at, np.arange(len(stops)), stops[:, i]) for i in range(3)], axis=1)
    return np.concatenate([[GROUND], np.floor(ramp + 0.5)]).astype(np.uint8)


def coloured(values: NDArray[np.float64], low: float, high: float) -> Bytes2:
    """Returns the colour indices of values, uint8. Values outside low to high have the colour of the nearer end."""
    unit = np.clip((values - low) / max(high - low, 1e-9), 0, 1)
    return (1 + np.floor(unit * (COLOURS - 1) + 0.5)).astype(np.uint8)


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
