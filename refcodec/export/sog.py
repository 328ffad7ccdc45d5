"""SOG files: Gaussians as lossless WebP images in a ZIP archive, version 2 of PlayCanvas's format.

Each Gaussian is a pixel of each image. Positions have 16 bits on a logarithmic scale. Lengths and colours are indices
into a table of 256 values. Harmonics are indices into a shared palette.
"""

# The packages of the extra `render` are imported where they are used, because other formats do not need them.
# ruff: noqa: PLC0415

from __future__ import annotations

import io
import json
import re
import warnings
import zipfile
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import __version__
from ..files.outputs import Kind
from .splats import Packed, Splats, logits, nearest_bytes, opacities, smaller_components, with_largest

_U8 = NDArray[np.uint8]
_F64 = NDArray[np.float64]

META, _START = "meta.json", '{"version":2,"asset":{"generator":"refcodec'
# The local header of a ZIP entry has 30 bytes.
SOG = Kind(
    "a SOG file that refcodec wrote",
    re.compile(rb"PK\x03\x04.{26}" + re.escape((META + _START).encode()), re.DOTALL),
)
# The time of files in the archive, the earliest of ZIP. Thus the same scene gives the same bytes.
_TIME = (1980, 1, 1, 0, 0, 0)
_TABLE = 256
# Bins of the histogram from which a table starts.
_BINS = 128
# k-means steps for a table and for a palette.
_STEPS = 10
# Entries in a row of the palette image, and the maximum number of entries.
ROW, PALETTE_MOST = 64, 1 << 16
# A palette is built in two steps: first clusters of about this many Gaussians are formed, then each is divided.
_CLUSTER = 4096


def sog_file(splats: Splats) -> Packed:
    """Returns the file. It has the Gaussians in another order. splats: at least one."""
    count = len(splats.mean)
    # Neighbouring Gaussians are close in the images, which compresses better.
    order = _along_curve(splats.mean)
    width = 4 * max(int(np.ceil(np.sqrt(count) / 4)), 1)
    height = 4 * max(int(np.ceil(count / width / 4)), 1)

    def image(values: NDArray[Any]) -> bytes:
        pixels = np.full((width * height, 4), 255, np.uint8)
        pixels[:count, : values.shape[1]] = values
        return _webp(pixels.reshape(height, width, 4))

    mean, means = _positions(splats.mean[order])
    scales, scale_table = _table(splats.scale[order])
    base, base_table = _table(splats.base[order])
    opacity = nearest_bytes(opacities(splats)[order] * 255)
    largest, others = smaller_components(splats.unit_quaternions()[order])
    components = nearest_bytes((others * np.sqrt(0.5) + 0.5) * 255)
    files = {
        "means_l.webp": image(mean & 255),
        "means_u.webp": image(mean >> 8),
        "scales.webp": image(scales),
        "quats.webp": image(np.concatenate([components, 252 + largest[:, None]], axis=1)),
        "sh0.webp": image(np.concatenate([base, opacity[:, None]], axis=1)),
    }
    meta: dict[str, Any] = {
        "version": 2,
        "asset": {"generator": f"refcodec {__version__}"},
        "count": count,
        "means": {**means, "files": ["means_l.webp", "means_u.webp"]},
        "scales": {"codebook": scale_table.tolist(), "files": ["scales.webp"]},
        "quats": {"files": ["quats.webp"]},
        "sh0": {"codebook": base_table.tolist(), "files": ["sh0.webp"]},
    }
    rest: NDArray[Any] = splats.rest[order]
    if splats.degree:
        labels, entries = _palette(rest.reshape(count, -1).astype(np.float64))
        numbers, table = _table(entries.reshape(len(entries), -1, 3))
        rest = table[numbers][labels]
        number = numbers.shape[1]
        pixels = np.full((-(-len(entries) // ROW) * ROW, number, 4), 255, np.uint8)
        pixels[: len(entries), :, :3] = numbers
        files["shN_centroids.webp"] = _webp(pixels.reshape(-1, ROW * number, 4))
        files["shN_labels.webp"] = image(np.stack([labels & 255, labels >> 8, 0 * labels], axis=1))
        names = ["shN_centroids.webp", "shN_labels.webp"]
        shared = {"count": len(entries), "bands": splats.degree, "codebook": table.tolist(), "files": names}
        meta["shN"] = shared
    archive = io.BytesIO()
    with zipfile.ZipFile(archive, "w") as out:
        for name, data in {META: json.dumps(meta, separators=(",", ":")).encode(), **files}.items():
            out.writestr(zipfile.ZipInfo(name, _TIME), data)
    low, high = np.array(means["mins"]), np.array(means["maxs"])
    scaled = low + (high - low) * mean / 65535
    held = (
        np.sign(scaled) * np.expm1(np.abs(scaled)),
        base_table[base],
        rest,
        logits(opacity / 255),
        scale_table[scales],
        with_largest(largest, (components / 255 - 0.5) * np.sqrt(2)),
    )
    return Packed(archive.getvalue(), Splats(*(values.astype(np.float32) for values in held)))


def _webp(pixels: _U8) -> bytes:
    """Returns a lossless image of pixels, uint8 [height, width, 4]."""
    from PIL import Image

    out = io.BytesIO()
    # Without `exact`, colours of transparent pixels are lost.
    Image.fromarray(pixels).save(out, "WEBP", lossless=True, exact=True, quality=100, method=4)
    return out.getvalue()


def _along_curve(mean: NDArray[np.float32]) -> NDArray[np.int64]:
    """Returns an order of points, [n, 3], along a Z-order curve of 16 bits for each axis."""
    low, high = mean.min(axis=0).astype(np.float64), mean.max(axis=0).astype(np.float64)
    grid = ((mean - low) / np.maximum(high - low, 1e-300) * 65535).astype(np.uint64)
    code = np.zeros(len(mean), np.uint64)
    for bit in range(16):
        for axis in range(3):
            code |= (grid[:, axis] >> np.uint64(bit) & np.uint64(1)) << np.uint64(3 * bit + axis)
    return np.argsort(code, kind="stable")


def _positions(mean: NDArray[np.float32]) -> tuple[NDArray[np.uint16], dict[str, list[float]]]:
    """Returns 16 bits for each coordinate, [n, 3], and the range of each axis, on the logarithmic scale."""
    wide = mean.astype(np.float64)
    scaled = np.sign(wide) * np.log1p(np.abs(wide))
    low, high = scaled.min(axis=0), scaled.max(axis=0)
    levels = np.rint((scaled - low) / np.where(high > low, high - low, 1) * 65535).astype(np.uint16)
    return levels, {"mins": low.tolist(), "maxs": high.tolist()}


def _table(values: NDArray[Any]) -> tuple[_U8, _F64]:
    """Returns the table index of each value, and the table of 256 ascending numbers."""
    flat = np.sort(values.reshape(-1).astype(np.float64))
    # For least squares, the density of entries is the cube root of that of the values. The table starts so.
    counts, edges = np.histogram(flat, _BINS)
    dense = np.append(0.0, np.cumsum(np.cbrt(counts)))
    table = np.interp((np.arange(_TABLE) + 0.5) / _TABLE * dense[-1], dense, edges)
    # Then each entry moves to the mean of its nearest values.
    sums = np.concatenate([[0.0], np.cumsum(flat)])
    for _ in range(_STEPS):
        ends = np.searchsorted(flat, (table[1:] + table[:-1]) / 2)
        begin, end = np.append(0, ends), np.append(ends, len(flat))
        filled = end > begin
        table[filled] = (sums[end] - sums[begin])[filled] / (end - begin)[filled]
        table = np.maximum.accumulate(table)
    numbers = np.searchsorted((table[1:] + table[:-1]) / 2, values)
    return numbers.astype(np.uint8), table


def _palette(rows: _F64) -> tuple[NDArray[np.int64], _F64]:
    """Returns the palette index of each row, and the palette of at most PALETTE_MOST entries.

    rows: float64 [n, k]. The number of entries is that of PlayCanvas's program: from 1,024 rows on about one for one to
    two rows.
    """
    count = len(rows)
    if count <= 1024:
        return np.arange(count), rows
    size = min(1024 << int(np.log2(count / 1024)), PALETTE_MOST)
    labels = np.zeros(count, np.int64)
    parts: list[_F64] = []
    number = -(-count // _CLUSTER)
    groups = _clusters(rows, number)[0]
    for group in range(number):
        members = np.flatnonzero(groups == group)
        if len(members):
            # One entry for each group, and the others in proportion to the rows.
            own, centres = _clusters(rows[members], 1 + len(members) * (size - number) // count)
            labels[members] = sum(map(len, parts)) + own
            parts.append(centres)
    return labels, np.concatenate(parts)


def _clusters(rows: _F64, number: int) -> tuple[NDArray[np.int64], _F64]:
    """Returns the cluster number of each row, and the centres, by k-means from evenly chosen rows."""
    from scipy.cluster.vq import kmeans2, vq

    start = rows[np.linspace(0, len(rows) - 1, number).astype(np.int64)]
    with warnings.catch_warnings():
        # A cluster without rows keeps its centre.
        warnings.simplefilter("ignore", UserWarning)
        centres, _ = kmeans2(rows, start, iter=_STEPS, minit="matrix")
    return vq(rows, centres)[0].astype(np.int64), centres
