"""SPZ files (Niantic): 3D Gaussians as fixed-point numbers, compressed by gzip (versions 1 to 3) or Zstandard (4).

The axes of a file are those of OpenGL: y points up and z backwards. 3DGS files have those of COLMAP. Thus y and
z are negated, with the corresponding components of quaternions and harmonics.
"""

from __future__ import annotations

import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..export.splats import with_largest
from ..export.spz import COLOUR, HARMONIC_SIGNS, MAGIC, SCALE, SCALE_LEAST
from ..folder.layout import SceneFolderError
from ..rendering.harmonics import REST
from .splat_arrays import ADVICE, Arrays, check_count, logits

GZIP = b"\x1f\x8b"
# Magic, version, number of Gaussians, degree of harmonics, fractional bits of positions, flags, and a reserved byte,
# which is the number of streams in version 4.
HEADER = struct.Struct("<4sIIBBBB")
# Version 4: the offset of the stream table after the header. An entry has the compressed and the uncompressed size.
TABLE, STREAM = struct.Struct("<I"), struct.Struct("<QQ")
FILE_MAX = 1 << 31


def read_spz(file: Path) -> Arrays:
    """Returns the Gaussians of a file. Raises SceneFolderError."""
    if file.stat().st_size > FILE_MAX:
        raise SceneFolderError(file, f"it has more than {FILE_MAX} bytes", ADVICE)
    data = file.read_bytes()
    packed = data[:2] == GZIP
    first = _gunzipped(file, data, HEADER.size) if packed else data[: HEADER.size]
    if len(first) < HEADER.size or first[:4] != MAGIC:
        raise SceneFolderError(file, "it is not an SPZ file", ADVICE)
    _, version, count, degree, fraction, _, streams = HEADER.unpack(first)
    if not ((packed and 1 <= version <= 3) or (not packed and version == 4)):
        raise SceneFolderError(file, f"it is SPZ version {version}, but only versions 1 to 4 are supported", ADVICE)
    if degree >= len(REST) or fraction > 23:
        problem = f"it states harmonics of degree {degree} and {fraction} fractional bits; 3 and 23 are the most"
        raise SceneFolderError(file, problem, ADVICE)
    check_count(file, count, len(data))
    sizes = _sizes(version, REST[degree])
    if packed:
        parts = _gunzipped(file, data, HEADER.size + count * sum(sizes))[HEADER.size :]
    else:
        parts = _unpacked(file, data, streams, [count * size for size in sizes if size])
    if len(parts) < count * sum(sizes):
        raise SceneFolderError(file, f"it has fewer bytes than its {count} Gaussians need", ADVICE)
    ends = np.cumsum([0, *sizes]) * count
    arrays = [
        np.frombuffer(parts, np.uint8, count * size, int(end)).reshape(count, size) if count and size else _none(count)
        for size, end in zip(sizes, ends, strict=False)
    ]
    return _gaussians(version, fraction, REST[degree], *arrays)


def _none(count: int) -> NDArray[np.uint8]:
    return np.zeros((count, 0), np.uint8)


def _sizes(version: int, rest: int) -> tuple[int, ...]:
    """Returns the bytes per Gaussian: position, opacity, colour, lengths, rotation, harmonics."""
    return (6 if version == 1 else 9, 1, 3, 3, 4 if version >= 3 else 3, 3 * rest)


def _gunzipped(file: Path, data: bytes, most: int) -> bytes:
    """Returns a bounded number of first bytes of gzip data. Raises SceneFolderError."""
    try:
        return zlib.decompressobj(wbits=31).decompress(data, most)
    except zlib.error as error:
        raise SceneFolderError(file, f"its gzip stream is damaged ({error})", ADVICE) from None


def _unpacked(file: Path, data: bytes, count: int, sizes: list[int]) -> bytes:
    """Returns the concatenated streams of version 4. Raises SceneFolderError."""
    try:
        import zstandard  # noqa: PLC0415 (an extra)
    except ModuleNotFoundError:
        problem = "it is SPZ version 4, which requires zstandard"
        raise SceneFolderError(file, problem, "pip install 'refcodec[convert]', or convert it to PLY") from None
    start = TABLE.unpack_from(data, HEADER.size)[0] if len(data) >= HEADER.size + TABLE.size else len(data)
    if count != len(sizes) or start + count * STREAM.size > len(data):
        raise SceneFolderError(file, f"it has {count} streams, but must have {len(sizes)} complete ones", ADVICE)
    place, streams = start + count * STREAM.size, []
    for number, wanted in enumerate(sizes):
        size, plain = STREAM.unpack_from(data, start + number * STREAM.size)
        if plain != wanted or place + size > len(data):
            raise SceneFolderError(file, f"its stream {number} does not have {wanted} bytes", ADVICE)
        try:
            with zstandard.ZstdDecompressor(max_window_size=1 << 27).stream_reader(
                data[place : place + size]
            ) as reader:
                streams.append(reader.read(wanted))
        except zstandard.ZstdError as error:
            raise SceneFolderError(file, f"its stream {number} is damaged ({error})", ADVICE) from None
        if len(streams[-1]) != wanted:
            raise SceneFolderError(file, f"its stream {number} does not have {wanted} bytes", ADVICE)
        place += size
    return b"".join(streams)


def _gaussians(version: int, fraction: int, rest: int, *parts: NDArray[np.uint8]) -> Arrays:
    """Returns Gaussians from the bytes of each part, uint8 [N, bytes]."""
    position, opacity, colour, lengths, rotation, harmonics = parts
    count = len(position)
    if version == 1:
        mean = position.copy().view("<f2").astype(np.float64)
    else:
        wide = np.zeros((count, 3, 4), np.uint8)
        wide[:, :, 1:] = position.reshape(count, 3, 3)
        # In the upper bytes of 32 bits, so that the sign bit is correct.
        mean = (wide.reshape(count, 12).view("<i4") >> 8) / 2.0**fraction
    if version >= 3:
        quaternion = _smallest_three(rotation)
    else:
        vector = rotation / 127.5 - 1
        scalar = np.sqrt(np.maximum(1 - (vector**2).sum(axis=1), 0))
        quaternion = np.concatenate([scalar[:, None], vector], axis=1)
    arrays: dict[str, NDArray[Any]] = {
        "mean": mean * (1, -1, -1),
        "base": (colour / 255 - 0.5) / COLOUR,
        "rest": _rest(harmonics.reshape(count, rest, 3)),
        "scale": lengths / SCALE + SCALE_LEAST,
        "quaternion": quaternion * (1, 1, -1, -1),
    }
    return {name: values.astype(np.float32, copy=False) for name, values in arrays.items()} | {
        "opacity": logits(opacity[:, 0] / 255)
    }


def _rest(harmonics: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Returns coefficients from bytes, [N, K, 3]. They are most of a file, and exact in float32."""
    coefficients = harmonics.astype(np.float32)
    coefficients -= 128
    coefficients *= HARMONIC_SIGNS[: coefficients.shape[1], None].astype(np.float32) / 128
    return coefficients


def _smallest_three(rotation: NDArray[np.uint8]) -> NDArray[np.float64]:
    """Returns quaternions w, x, y, z of words: index of the largest component, sign and 9 bits of the others."""
    word = rotation.copy().view("<u4")[:, 0].astype(np.int64)
    fields = np.stack([word >> shift & 1023 for shift in (20, 10, 0)], axis=1)
    values = (fields & 511) / 511 * np.sqrt(0.5) * np.where(fields & 512, -1, 1)
    return np.roll(with_largest(word >> 30, values), 1, axis=1)
