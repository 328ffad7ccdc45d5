"""SOG files (PlayCanvas), version 2: Gaussians as pixels of lossless WebP images, in a ZIP archive or a folder.

Each Gaussian is a pixel of each image. Positions have 16 bits on a logarithmic scale. Lengths and colours are indices
into a table of 256 values. Harmonics are indices into a shared palette. meta.json names the images.
"""

# The packages of the extra `render` are imported where they are used, because other formats do not need them.
# ruff: noqa: PLC0415

import io
import json
import re
import warnings
import zipfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from .. import __version__
from ..files.outputs import Kind
from ..files.present import BytesFile
from ..files.text import printable
from . import packing
from .archives import opened_zip, read_entry
from .common import COMPENSATED, TRANSFORM, ContentError, Data, Document, Options, beside, check_count, remark
from .harmonics import REST
from .packing import I64, U8, nearest_bytes
from .splats import F64, Splats, narrowed, rows_of

META, _START = "meta.json", '{"version":2,"asset":{"generator":"refcodec'
# The local header of a ZIP entry has 30 bytes.
KIND = Kind(
    "a SOG file that refcodec wrote", re.compile(rb"PK\x03\x04.{26}" + re.escape((META + _START).encode()), re.DOTALL)
)
# Maximum bytes of an archive, of a compressed image, and of meta.json.
FILE_MAX, IMAGE_MAX, META_MAX = 1 << 30, 1 << 28, 1 << 20
# Images have complete rows, so some pixels belong to no Gaussian.
SPARE = 1 << 20
# The entries of a table, and the entries in a row of the palette image and their maximum number.
TABLE, ROW, PALETTE_MOST = 256, 64, 1 << 16
# The fourth number of a quaternion's pixel is this plus the index of its largest component.
_LARGEST = 252
# The time of files in the archive, the earliest of ZIP. Thus the same scene gives the same bytes.
_TIME = (1980, 1, 1, 0, 0, 0)
# Bins of the histogram from which a table starts.
_BINS = 128
# k-means steps for a table and for a palette.
_STEPS = 10
# A palette is built in two steps: first clusters of about this many Gaussians are formed, then each is divided.
_CLUSTER = 4096
# The most clusters of one k-means over many rows, and the most rows that it learns from.
_BRANCHES, _SAMPLE = 16, 1 << 15

# Returns a file by its name and its maximum size in bytes.
ReadPart = Callable[[str, int], bytes]
# The types of values of meta.json.
_Count = Annotated[int, Meta(ge=0, lt=1 << 32)]
_Entries = Annotated[int, Meta(ge=0, le=PALETTE_MOST)]
_Bands = Annotated[int, Meta(ge=0, lt=len(REST))]
_Three = tuple[float, float, float]
_Codebook = Annotated[list[float], Meta(min_length=TABLE, max_length=TABLE)]


# --- reading ----------------------------------------------------------------------------------------------------------


def read(data: Data) -> Splats:
    """Returns the Gaussians of an archive. Raises ContentError."""
    if len(data) > FILE_MAX:
        raise ContentError(f"it has more than {FILE_MAX} bytes")
    with opened_zip(BytesFile(data), "zip archive") as archive:
        return _read(partial(read_entry, archive), len(data))


def read_folder(file: Path) -> Splats:
    """Returns the Gaussians of a meta.json with the images beside it. Raises ContentError, and OSError."""
    return _read(partial(beside, file), sum(image.stat().st_size for image in file.parent.glob("*.webp")))


def _read(part: ReadPart, size: int) -> Splats:
    """Returns the Gaussians. size: of the files, bytes. Raises ContentError."""
    meta = Document(META, part(META, META_MAX), META_MAX)
    # Version 1 does not state its number.
    version = meta.get("version", Any, 1)
    if version != 2:
        advice = TRANSFORM.format(file=META)
        raise ContentError(f"it is SOG version {printable(repr(version), 20)}, but only version 2 is supported", advice)
    if meta.get("model", Any, None) == "antialiased":
        remark(COMPENSATED)
    count = meta.get("count", _Count)
    check_count(count, size)

    def rows(name: str) -> U8:
        return _pixels(part, meta.get(name, str), count).reshape(-1, 4)[:count]

    words = rows("means/files/1")[:, :3].astype(np.int64) << 8 | rows("means/files/0")[:, :3]
    low, high = (np.array(meta.get(f"means/{end}", _Three)) for end in ("mins", "maxs"))
    with np.errstate(over="ignore", invalid="ignore"):
        folded = low + words / 65535 * (high - low)
        # Positions are stored as the logarithm of 1 plus their magnitude.
        mean = np.sign(folded) * np.expm1(np.abs(folded))
    rotation, colour = rows("quats/files/0"), rows("sh0/files/0")
    largest = rotation[:, 3].astype(np.int64) - _LARGEST
    if largest.min(initial=0) < 0:
        raise ContentError("a rotation does not state its largest component")
    rest = np.zeros((count, 0, 3), np.float32)
    if meta.get("shN", Any, None) is not None:
        labels = rows("shN/files/1").astype(np.int64)
        rest = _rest(part, meta, labels[:, 0] | labels[:, 1] << 8)
    return narrowed(
        mean=mean,
        base=np.array(meta.get("sh0/codebook", _Codebook))[colour[:, :3]],
        rest=rest,
        opacity=packing.logits(colour[:, 3] / 255, packing.BYTE_OPACITY_LEAST),
        scale=np.array(meta.get("scales/codebook", _Codebook))[rows("scales/files/0")[:, :3]],
        quaternion=packing.with_largest(largest, (rotation[:, :3] / 255 - 0.5) * np.sqrt(2)),
    )


def _rest(part: ReadPart, meta: Document, labels: I64) -> NDArray[np.float32]:
    """Returns the harmonics besides the first, [N, K, 3]: each Gaussian has those of a palette entry."""
    rest, entries = REST[meta.get("shN/bands", _Bands)], meta.get("shN/count", _Entries)
    # A palette's rows have ROW entries of `rest` pixels each.
    palette = _pixels(part, meta.get("shN/files/0", str), max(entries * rest, 1))
    if palette.shape[1] != ROW * rest or palette.shape[0] * ROW < entries:
        raise ContentError(f"its palette does not have {entries} entries in rows of {ROW}")
    if labels.max(initial=0) >= max(entries, 1):
        raise ContentError(f"a Gaussian has harmonics beyond the {entries} of the palette")
    with np.errstate(over="ignore"):
        table = np.array(meta.get("shN/codebook", _Codebook)).astype(np.float32)
    return table[palette.reshape(-1, rest, 4)[:, :, :3]][labels]


def _pixels(part: ReadPart, name: str, least: int) -> U8:
    """Returns an image as uint8 [height, width, 4]. least: its minimum number of pixels. Raises ContentError."""
    from PIL import Image, UnidentifiedImageError

    shown, data = printable(name, 60), part(name, IMAGE_MAX)
    try:
        with warnings.catch_warnings():
            # Pillow only warns of many pixels. Here they are bounded.
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)
            image = Image.open(io.BytesIO(data), formats=["WEBP", "PNG"])
        with image:
            width, height = image.size
            if not least <= width * height <= 2 * least + SPARE:
                raise ContentError(f"its image {shown} has {width} x {height} pixels for {least}")
            return np.asarray(image.convert("RGBA"))
    except (ContentError, MemoryError):
        raise
    except UnidentifiedImageError:
        raise ContentError(f"its image {shown} is neither WebP nor PNG") from None
    # Pillow raises many types for bad bytes.
    except Exception as error:
        raise ContentError(f"its image {shown} cannot be read ({printable(str(error), 80)})") from None


# --- writing ----------------------------------------------------------------------------------------------------------


def write(splats: Splats, _: Options) -> bytes:
    """Returns a file. It has the Gaussians in another order."""
    # Neighbouring Gaussians are close in the images, which compresses better.
    splats = rows_of(splats, packing.along_curve(splats.mean))
    count = len(splats.mean)
    width = 4 * max(int(np.ceil(np.sqrt(count) / 4)), 1)
    height = 4 * max(int(np.ceil(count / width / 4)), 1)

    def image(values: NDArray[Any]) -> bytes:
        pixels = np.full((width * height, 4), 255, np.uint8)
        pixels[:count, : values.shape[1]] = values
        return _webp(pixels.reshape(height, width, 4))

    words, ends = _positions(splats.mean)
    scales, scale_table = _table(splats.scale)
    base, base_table = _table(splats.base)
    largest, others = packing.smaller_components(splats.unit_quaternions())
    components = nearest_bytes((others * np.sqrt(0.5) + 0.5) * 255)
    opacity = nearest_bytes(packing.opacities(splats) * 255)
    files = {
        "means_l.webp": image(words & 255),
        "means_u.webp": image(words >> 8),
        "scales.webp": image(scales),
        "quats.webp": image(np.concatenate([components, _LARGEST + largest[:, None]], axis=1)),
        "sh0.webp": image(np.concatenate([base, opacity[:, None]], axis=1)),
    }
    meta: dict[str, Any] = {
        "version": 2,
        "asset": {"generator": f"refcodec {__version__}"},
        "count": count,
        "means": {**ends, "files": ["means_l.webp", "means_u.webp"]},
        "scales": {"codebook": scale_table.tolist(), "files": ["scales.webp"]},
        "quats": {"files": ["quats.webp"]},
        "sh0": {"codebook": base_table.tolist(), "files": ["sh0.webp"]},
    }
    if splats.degree:
        labels, entries = _palette(splats.rest.reshape(count, -1).astype(np.float64))
        numbers, table = _table(entries.reshape(len(entries), -1, 3))
        rest = numbers.shape[1]
        pixels = np.full((-(-len(entries) // ROW) * ROW, rest, 4), 255, np.uint8)
        pixels[: len(entries), :, :3] = numbers
        files["shN_centroids.webp"] = _webp(pixels.reshape(-1, ROW * rest, 4))
        files["shN_labels.webp"] = image(np.stack([labels & 255, labels >> 8, 0 * labels], axis=1))
        names = ["shN_centroids.webp", "shN_labels.webp"]
        palette = {"count": len(entries), "bands": splats.degree, "codebook": table.tolist(), "files": names}
        meta["shN"] = palette
    archive = io.BytesIO()
    with zipfile.ZipFile(archive, "w") as out:
        for name, data in {META: json.dumps(meta, separators=(",", ":")).encode(), **files}.items():
            out.writestr(zipfile.ZipInfo(name, _TIME), data)
    return archive.getvalue()


def _webp(pixels: U8) -> bytes:
    """Returns a lossless image of pixels, uint8 [height, width, 4]."""
    from PIL import Image

    out = io.BytesIO()
    # Without `exact`, colours of transparent pixels are lost.
    Image.fromarray(pixels).save(out, "WEBP", lossless=True, exact=True, quality=100, method=4)
    return out.getvalue()


def _positions(mean: NDArray[np.float32]) -> tuple[I64, dict[str, list[float]]]:
    """Returns 16 bits for each coordinate, [n, 3], and the range of each axis, on the logarithmic scale."""
    wide = mean.astype(np.float64)
    scaled = np.sign(wide) * np.log1p(np.abs(wide))
    low, high = scaled.min(axis=0), scaled.max(axis=0)
    words = np.rint((scaled - low) / np.where(high > low, high - low, 1) * 65535).astype(np.int64)
    return words, {"mins": low.tolist(), "maxs": high.tolist()}


def _table(values: NDArray[Any]) -> tuple[U8, F64]:
    """Returns the table index of each value, and the table of 256 ascending numbers."""
    flat = np.sort(values.reshape(-1).astype(np.float64))
    # For least squares, the density of entries is the cube root of that of the values. The table starts so.
    counts, edges = np.histogram(flat, _BINS)
    dense = np.append(0.0, np.cumsum(np.cbrt(counts)))
    table = np.interp((np.arange(TABLE) + 0.5) / TABLE * dense[-1], dense, edges)
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


def _palette(rows: F64) -> tuple[I64, F64]:
    """Returns the palette index of each row, and the palette of at most PALETTE_MOST entries.

    rows: float64 [n, k]. The number of entries is that of PlayCanvas's program: from 1,024 rows on about one for one to
    two rows.
    """
    count = len(rows)
    if count <= 1024:
        return np.arange(count), rows
    size = min(1024 << int(np.log2(count / 1024)), PALETTE_MOST)
    labels = np.zeros(count, np.int64)
    parts: list[F64] = []
    groups = _groups(rows, np.arange(count))
    for members in groups:
        # One entry for each group, and the others in proportion to the rows.
        own, centres = _clusters(rows[members], 1 + len(members) * (size - len(groups)) // count)
        labels[members] = sum(map(len, parts)) + own
        parts.append(centres)
    return labels, np.concatenate(parts)


def _groups(rows: F64, members: I64) -> list[I64]:
    """Returns the members in groups of near rows, of at most _CLUSTER each.

    Time and memory are nearly linear: no k-means has more than _BRANCHES clusters, and rows that hardly divide, such as
    equal ones, are sorted and cut into runs.
    """
    number = -(-len(members) // _CLUSTER)
    if number <= 1:
        return [members]
    labels, _ = _clusters(rows[members], min(number, _BRANCHES))
    parts = [members[labels == label] for label in np.unique(labels)]
    if max(map(len, parts)) > 0.9 * len(members):
        return np.array_split(members[np.lexsort(rows[members].T)], number)
    return [group for part in parts for group in _groups(rows, part)]


def _clusters(rows: F64, number: int) -> tuple[I64, F64]:
    """Returns the cluster number of each row, and the centres, by k-means of evenly chosen rows."""
    from scipy.cluster.vq import kmeans2, vq

    chosen = rows[np.linspace(0, len(rows) - 1, min(len(rows), _SAMPLE)).astype(np.int64)]
    start = rows[np.linspace(0, len(rows) - 1, number).astype(np.int64)]
    with warnings.catch_warnings():
        # A cluster without rows keeps its centre.
        warnings.simplefilter("ignore", UserWarning)
        centres, _ = kmeans2(chosen, start, iter=_STEPS, minit="matrix")
    blocks = np.array_split(rows, -(-len(rows) // _SAMPLE))
    return np.concatenate([vq(block, centres)[0].astype(np.int64) for block in blocks]), centres
