"""Whether a PNG file has all its rows. Pillow silently shows missing rows as black."""

from __future__ import annotations

import zlib
from pathlib import Path

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
# Samples of a pixel for each colour type.
_SAMPLES = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}
# The passes of an interlaced image: first column and row, and the steps to the next.
_PASSES = ((0, 0, 8, 8), (4, 0, 8, 8), (0, 4, 4, 8), (2, 0, 4, 4), (0, 2, 2, 4), (1, 0, 2, 2), (0, 1, 1, 2))
_BLOCK = 1 << 20


def has_all_rows(path: Path) -> bool:
    """Whether the compressed data of a PNG file has the length that follows from its header. True for other formats.

    Raises OSError, and zlib.error for data that cannot be decompressed.
    """
    with path.open("rb") as file:
        if file.read(8) != _SIGNATURE:
            return True
        decoder, found, wanted = zlib.decompressobj(), 0, 0
        while len(head := file.read(8)) == 8:
            length, kind = int.from_bytes(head[:4], "big"), head[4:]
            if kind == b"IHDR":
                wanted = _raw_bytes(file.read(length))
            elif kind == b"IDAT":
                while length > 0 and (block := file.read(min(length, _BLOCK))):
                    length -= len(block)
                    # Decompressed bytes are counted, not kept.
                    while block:
                        found += len(decoder.decompress(block, _BLOCK))
                        block = decoder.unconsumed_tail
            else:
                file.seek(length, 1)
            file.seek(4, 1)
            if found >= wanted > 0:
                return True
        # The bytes that the decoder still holds.
        return found + len(decoder.flush()) >= wanted


def _raw_bytes(header: bytes) -> int:
    """Returns the bytes of all rows before compression, each with its byte of the filter. header: the chunk IHDR."""
    width, height = int.from_bytes(header[:4], "big"), int.from_bytes(header[4:8], "big")
    depth, colour, interlaced = header[8], header[9], header[12]
    bits = depth * _SAMPLES.get(colour, 1)
    sizes = [(width, height)]
    if interlaced:
        sizes = [(-(-(width - x) // across), -(-(height - y) // down)) for x, y, across, down in _PASSES]
    return sum(h * (1 + -(-w * bits // 8)) for w, h in sizes if w > 0 and h > 0)
