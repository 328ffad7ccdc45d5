"""PlayCanvas's compressed PLY files: each 256 Gaussians are a chunk, whose numbers are shares of the chunk's ranges.

The element `chunk` has the ranges, `vertex` four words of 32 bits for each Gaussian, and `sh` bytes for harmonics.
"""

import re
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..files import ply
from ..files.outputs import Kind
from . import packing
from .common import ContentError, Options
from .harmonics import ZERO
from .ply import MARK, Tables, columns, rest_columns
from .splats import F64, Splats, narrowed, rows_of

# The number of Gaussians in a chunk.
CHUNK = 256
# The fields of each word, the highest bits first, with their widths: three axes, the place of the largest component
# and the other ones, three axes, and red, green, blue and opacity.
WORDS = {"position": (11, 10, 11), "rotation": (2, 10, 10, 10), "scale": (11, 10, 11), "color": (8, 8, 8, 8)}
# The ranges of a chunk, as the stem and the ends of its properties.
_RANGES = {"position": ("", "xyz"), "scale": ("scale_", "xyz"), "color": ("", "rgb")}
# Bytes of harmonics are the centres of 256 steps from -4 to 4.
_SPAN = 8
# Gaussians are drawn in to so many times the largest coordinate of those that are not far out.
_FARTHEST = 2
KIND = Kind(
    "a compressed PLY file that refcodec wrote",
    re.compile(rb"ply\nformat binary_little_endian 1\.0\nelement chunk [0-9]+\ncomment " + MARK.encode() + rb"\n"),
)


def is_compressed(tables: Tables) -> bool:
    """Whether the elements are those of a compressed file."""
    return "packed_position" in ply.names_of(tables["vertex"])


def read(tables: Tables) -> Splats:
    """Returns the Gaussians of the elements of a file. Raises ContentError."""
    vertex, chunks, harmonics = tables["vertex"], tables.get("chunk"), tables.get("sh")
    count = len(vertex)
    if chunks is None or len(chunks) != -(-count // CHUNK):
        raise ContentError(f"it has no element chunk for each {CHUNK} Gaussians")
    if harmonics is not None and len(harmonics) != count:
        raise ContentError(f"its element sh has {len(harmonics)} rows, but must have {count}")
    for name in WORDS:
        columns(vertex, [f"packed_{name}"], "u")
    words = {name: vertex[f"packed_{name}"].astype(np.uint32).astype(np.int64) for name in WORDS}
    shares = {name: _shares(words[name], widths) for name, widths in WORDS.items()}
    chunk, values = np.arange(count) // CHUNK, {}
    for name, (stem, axes) in _RANGES.items():
        values[name] = shares[name][:, :3]
        # Files of the first version have no ranges of colours.
        if name != "color" or "min_r" in ply.names_of(chunks):
            ends = ([f"{end}_{stem}{axis}" for axis in axes] for end in ("min", "max"))
            low, high = (columns(chunks, names).astype(np.float64) for names in ends)
            values[name] = low[chunk] + values[name] * (high - low)[chunk]
    rest = np.zeros((count, 0, 3)) if harmonics is None else rest_columns(harmonics, "u").astype(np.float64)
    centres = np.where(rest == 0, 0, np.where(rest == 255, 1, (rest + 0.5) / 256))
    others = (shares["rotation"][:, 1:] - 0.5) * np.sqrt(2)
    return narrowed(
        mean=values["position"],
        base=(values["color"] - 0.5) / ZERO,
        rest=(centres - 0.5) * _SPAN,
        opacity=packing.logits(shares["color"][:, 3], packing.BYTE_OPACITY_LEAST),
        scale=values["scale"],
        quaternion=packing.with_largest(words["rotation"] >> 30, others),
    )


def _shares(words: NDArray[np.int64], widths: Sequence[int]) -> F64:
    """Returns the fields of words as shares of their largest values, [n, fields]."""
    parts, shift = [], sum(widths)
    for width in widths:
        shift -= width
        parts.append((words >> shift & ((1 << width) - 1)) / ((1 << width) - 1))
    return np.stack(parts, axis=1)


def write(splats: Splats, _: Options) -> bytes:
    """Returns a file. It has the Gaussians in another order, so that those of a chunk are near each other.

    The few far out share the last chunk with others, and are drawn in.
    """
    splats = packing.drawn_in(splats, _FARTHEST * float(np.abs(splats.mean[packing.bulk(splats.mean)]).max()))
    splats = rows_of(splats, packing.along_curve(splats.mean))
    count = len(splats.mean)
    starts, chunk = np.arange(0, count, CHUNK), np.arange(count) // CHUNK
    values: dict[str, NDArray[Any]] = {
        "position": splats.mean,
        "scale": splats.scale,
        "color": ZERO * splats.base.astype(np.float64) + 0.5,
    }
    largest, others = packing.smaller_components(splats.unit_quaternions())
    shares: dict[str, F64] = {"rotation": np.insert(others / np.sqrt(2) + 0.5, 0, largest / 3, axis=1)}
    ranges: dict[str, NDArray[np.float32]] = {}
    for name, (stem, axes) in _RANGES.items():
        # Shares are those of the ranges as they are stored.
        low, high = (end.reduceat(values[name], starts).astype("<f4") for end in (np.minimum, np.maximum))
        for word, end in (("min", low), ("max", high)):
            ranges |= {f"{word}_{stem}{axis}": column for axis, column in zip(axes, end.T, strict=True)}
        span = high.astype(np.float64) - low
        shares[name] = (values[name] - low.astype(np.float64)[chunk]) / np.where(span > 0, span, 1)[chunk]
    shares["color"] = np.append(shares["color"], packing.opacities(splats)[:, None], axis=1)
    words = {name: np.zeros(count, np.int64) for name in WORDS}
    for name, widths in WORDS.items():
        for width, share in zip(widths, shares[name].T, strict=True):
            most = (1 << width) - 1
            words[name] = words[name] << width | np.rint(share * most).clip(0, most).astype(np.int64)
    vertices = {f"packed_{name}": word.astype("<u4") for name, word in words.items()}
    elements = {"chunk": _table(ranges), "vertex": _table(vertices)}
    if splats.degree:
        steps = np.floor((splats.rest.astype(np.float64) / _SPAN + 0.5) * 256).clip(0, 255).astype("u1")
        by_channel = steps.transpose(0, 2, 1).reshape(count, -1)
        elements["sh"] = _table({f"f_rest_{number}": column for number, column in enumerate(by_channel.T)})
    return ply.ply_bytes(elements, MARK)


def _table(columns: dict[str, Any]) -> NDArray[Any]:
    """Returns named columns as a structured array."""
    return np.rec.fromarrays(list(columns.values()), [(name, column.dtype) for name, column in columns.items()])
