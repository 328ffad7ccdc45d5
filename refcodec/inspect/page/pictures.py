"""Pictures in the format PNG, without a library, and the two scales of colour of the page."""

from __future__ import annotations

import struct
import zlib

import numpy as np
from numpy.typing import NDArray

from .markup import image, tag, text

Bytes2 = NDArray[np.uint8]

# From few to many. All of them are seen on the dark ground of a picture.
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
    """Returns the indices of colours of values, uint8. Values outside low to high have the colour of the end."""
    unit = np.clip((values - low) / max(high - low, 1e-9), 0, 1)
    return (1 + np.floor(unit * (COLOURS - 1) + 0.5)).astype(np.uint8)


def png(pixels: Bytes2, colours: Bytes2 | None = None) -> bytes:
    """Returns a picture as PNG.

    pixels: uint8 [rows, columns], grey from 0 to 255, or indices of colours. colours: uint8 [256, 3].
    """
    rows, columns = pixels.shape
    head = struct.pack(">IIBBBBB", columns, rows, 8, 0 if colours is None else 3, 0, 0, 0)
    # Each row begins with the number of its filter. 0 is none.
    lines = np.concatenate([np.zeros((rows, 1), np.uint8), pixels], axis=1)
    parts = [(b"IHDR", head)]
    if colours is not None:
        parts.append((b"PLTE", colours.tobytes()))
    parts += [(b"IDAT", zlib.compress(lines.tobytes(), 9)), (b"IEND", b"")]
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data)) for kind, data in parts
    )


def colour_bar(low: str, high: str, words: str, colours: Bytes2 | None = None) -> str:
    """Returns a bar of the scale with its ends, as HTML.

    low, high: the ends, with their unit. words: what the scale is of. colours: those of `palette`, or None for grey.
    """
    ramp = np.arange(256, dtype=np.uint8)[None] if colours is None else np.arange(1, 256, dtype=np.uint8)[None]
    bar = image(png(ramp, colours), f"scale of colours from {low} to {high}", class_="ramp")
    return tag("p", text(low), bar, text(high), tag("span", text(words), class_="soft"), class_="scale")
