"""Writers of splat files by the text of each format, as references for the readers."""

from __future__ import annotations

import gzip
import io
import json
import struct
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from refcodec.export.glb import glb_bytes
from refcodec.export.splats import Splats

F64 = NDArray[np.float64]
Arrays = dict[str, F64]
RESTS = (0, 3, 8, 15)
ZERO = 0.5 / np.sqrt(np.pi)


def made(count: int = 300, degree: int = 2, seed: int = 0) -> Arrays:
    """Gaussians in a ball, of opaque and of transparent ones, whose numbers every format holds."""
    rng = np.random.default_rng(seed)
    quaternion = rng.normal(0, 1, (count, 4))
    return {
        "mean": rng.normal(0, 0.5, (count, 3)),
        "base": rng.normal(0, 0.7, (count, 3)).clip(-1.5, 1.5),
        "rest": rng.normal(0, 0.2, (count, RESTS[degree], 3)).clip(-0.9, 0.9),
        "opacity": rng.normal(1, 2, count).clip(-4, 4),
        "scale": rng.normal(-2.5, 0.4, (count, 3)).clip(-4, -1),
        "quaternion": quaternion / np.linalg.norm(quaternion, axis=1, keepdims=True),
    }


def table(columns: dict[str, NDArray[Any]], element: str = "vertex") -> tuple[list[str], bytes]:
    """Lines of a PLY header, and rows, of columns of any types."""
    names = {"f4": "float", "u4": "uint", "u1": "uchar"}
    lines = [f"element {element} {len(next(iter(columns.values())))}"]
    lines += [f"property {names[c.dtype.str[1:]]} {name}" for name, c in columns.items()]
    rows = np.empty(len(next(iter(columns.values()))), [(name, c.dtype) for name, c in columns.items()])
    for name, column in columns.items():
        rows[name] = column
    return lines, rows.tobytes()


def write_tables(path: Path, *tables: tuple[list[str], bytes]) -> None:
    """Writes a binary PLY file of elements."""
    lines = ["ply", "format binary_little_endian 1.0", *(line for found, _ in tables for line in found), "end_header"]
    path.write_bytes("\n".join([*lines, ""]).encode() + b"".join(rows for _, rows in tables))


def columns(splats: Arrays) -> dict[str, NDArray[Any]]:
    """The columns of 3DGS's own file."""
    n = len(splats["mean"])
    found = dict(zip("xyz", splats["mean"].T, strict=True)) | dict.fromkeys(("nx", "ny", "nz"), np.zeros(n))
    found |= {f"f_dc_{i}": column for i, column in enumerate(splats["base"].T)}
    rest = splats["rest"].transpose(0, 2, 1).reshape(n, splats["rest"].shape[1] * 3)
    found |= {f"f_rest_{i}": column for i, column in enumerate(rest.T)}
    found["opacity"] = splats["opacity"]
    found |= {f"scale_{i}": column for i, column in enumerate(splats["scale"].T)}
    found |= {f"rot_{i}": column for i, column in enumerate(splats["quaternion"].T)}
    return {name: column.astype("<f4") for name, column in found.items()}


def write_plain(splats: Arrays, path: Path) -> None:
    write_tables(path, table(columns(splats)))


def sigmoid(x: F64) -> F64:
    return 1 / (1 + np.exp(-x))


def three(quaternion: F64) -> tuple[NDArray[np.int64], F64]:
    """The place of the largest component, and the others, for a quaternion whose largest is positive."""
    largest = np.abs(quaternion).argmax(axis=1)
    rows = np.arange(len(quaternion))
    right = quaternion * np.sign(quaternion[rows, largest])[:, None]
    return largest, np.array([np.delete(q, i) for q, i in zip(right, largest, strict=True)])


def write_packed(splats: Arrays, path: Path) -> None:
    """PlayCanvas's compressed PLY: chunks of 256, and words of bits."""
    n = len(splats["mean"])
    colour = 0.5 + ZERO * splats["base"]
    starts = range(0, n, 256)
    ranges: dict[str, list[float]] = {}
    words = {name: np.zeros(n, np.uint64) for name in ("position", "rotation", "scale", "color")}

    def packed(values: F64, *widths: int) -> NDArray[np.uint64]:
        word = np.zeros(len(values), np.uint64)
        for column, width in zip(values.T, widths, strict=True):
            word = word << np.uint64(width) | np.rint(column * ((1 << width) - 1)).astype(np.uint64)
        return word

    for start in starts:
        part = slice(start, min(start + 256, n))
        shares = {}
        kinds = (("", "xyz", splats["mean"]), ("scale_", "xyz", splats["scale"]), ("", "rgb", colour))
        for stem, axes, values in kinds:
            low, high = values[part].min(axis=0), values[part].max(axis=0)
            for axis, least, most in zip(axes, low, high, strict=True):
                ranges.setdefault(f"min_{stem}{axis}", []).append(least)
                ranges.setdefault(f"max_{stem}{axis}", []).append(most)
            shares[stem + axes] = (values[part] - low) / np.maximum(high - low, 1e-30)
        words["position"][part] = packed(shares["xyz"], 11, 10, 11)
        words["scale"][part] = packed(shares["scale_xyz"], 11, 10, 11)
        alpha = sigmoid(splats["opacity"][part, None])
        words["color"][part] = packed(np.concatenate([shares["rgb"], alpha], axis=1), 8, 8, 8, 8)
    largest, rest = three(splats["quaternion"])
    rotation = packed(rest / np.sqrt(2) + 0.5, 10, 10, 10)
    words["rotation"] = largest.astype(np.uint64) << np.uint64(30) | rotation
    chunks = table({name: np.array(values, "<f4") for name, values in ranges.items()}, "chunk")
    vertices = table({f"packed_{name}": values.astype("<u4") for name, values in words.items()})
    harmonics = splats["rest"].transpose(0, 2, 1).reshape(n, -1)
    bytes_ = np.floor((harmonics / 8 + 0.5) * 256).clip(0, 255).astype("u1")
    more = [table({f"f_rest_{i}": c for i, c in enumerate(bytes_.T)}, "sh")] if bytes_.shape[1] else []
    write_tables(path, chunks, vertices, *more)


def spz_parts(splats: Arrays, version: int, fraction: int = 12) -> list[bytes]:
    """Position, opacity, colour, lengths, rotation and harmonics of SPZ, in its axes: y up, z backwards."""
    mean = splats["mean"] * (1, -1, -1)
    if version == 1:
        position = mean.astype("<f2").tobytes()
    else:
        fixed = np.rint(mean * (1 << fraction)).astype("<i4")
        position = fixed.view("u1").reshape(-1, 4)[:, :3].tobytes()
    quaternion = splats["quaternion"] * (1, 1, -1, -1)
    if version < 3:
        right = quaternion * np.sign(quaternion[:, :1])
        rotation = np.rint((right[:, 1:] + 1) * 127.5).astype("u1").tobytes()
    else:
        largest, rest = three(np.roll(quaternion, -1, axis=1))
        word = largest.astype(np.uint64)
        for column in rest.T:
            size = np.rint(np.abs(column) * np.sqrt(2) * 511).astype(np.uint64)
            word = word << np.uint64(10) | (column < 0).astype(np.uint64) << np.uint64(9) | size
        rotation = word.astype("<u4").tobytes()
    flip = np.array([-1, -1, 1, -1, 1, 1, -1, 1, -1, 1, -1, -1, 1, -1, 1])[: splats["rest"].shape[1], None]
    return [
        position,
        np.rint(sigmoid(splats["opacity"]) * 255).astype("u1").tobytes(),
        np.rint((splats["base"] * 0.15 + 0.5) * 255).astype("u1").tobytes(),
        np.rint((splats["scale"] + 10) * 16).astype("u1").tobytes(),
        rotation,
        np.rint(splats["rest"] * flip * 128 + 128).clip(0, 255).astype("u1").tobytes(),
    ]


def write_spz(splats: Arrays, path: Path, version: int) -> None:
    """SPZ of a version: gzip of one stream, or in version 4 streams of Zstandard."""
    n, degree = len(splats["mean"]), RESTS.index(splats["rest"].shape[1])
    parts = spz_parts(splats, version)
    if version < 4:
        header = struct.pack("<4sIIBBBB", b"NGSP", version, n, degree, 12, 0, 0)
        path.write_bytes(gzip.compress(header + b"".join(parts)))
        return
    import zstandard  # noqa: PLC0415 (an extra)

    streams = [(len(part), zstandard.compress(part)) for part in parts if part]
    header = struct.pack("<4sIIBBBBI12x", b"NGSP", 4, n, degree, 12, 0, len(streams), 32)
    entries = b"".join(struct.pack("<QQ", len(data), size) for size, data in streams)
    path.write_bytes(header + entries + b"".join(data for _, data in streams))


def webp(pixels: NDArray[np.uint8], width: int) -> bytes:
    """An image without loss, of rows of pixels, RGBA."""
    height = -(-len(pixels) // width)
    whole = np.zeros((height * width, 4), np.uint8)
    whole[: len(pixels)] = pixels
    data = io.BytesIO()
    Image.fromarray(whole.reshape(height, width, 4), "RGBA").save(data, "WEBP", lossless=True, exact=True)
    return data.getvalue()


def rgba(columns_: NDArray[Any], alpha: NDArray[Any] | int = 255) -> NDArray[np.uint8]:
    """Pixels of up to three columns."""
    found = np.zeros((len(columns_), 4), np.uint8)
    found[:, : columns_.shape[1]] = columns_
    found[:, 3] = alpha
    return found


def sog_entries(splats: Arrays, entries: int = 50) -> dict[str, bytes]:
    """The files of SOG, version 2. Gaussian i has the harmonics of entry i % entries."""
    n, rest = len(splats["mean"]), splats["rest"].shape[1]
    folded = np.sign(splats["mean"]) * np.log1p(np.abs(splats["mean"]))
    low, high = folded.min(axis=0), folded.max(axis=0)
    words = np.rint((folded - low) / (high - low) * 65535).astype(np.int64)
    largest, three_ = three(splats["quaternion"])
    books = {kind: np.linspace(splats[kind].min(), splats[kind].max(), 256) for kind in ("scale", "base")}

    def index(kind: str) -> NDArray[np.int64]:
        return np.abs(splats[kind][:, :, None] - books[kind]).argmin(axis=2)

    found = {
        "means_l.webp": webp(rgba(words & 255), 20),
        "means_u.webp": webp(rgba(words >> 8), 20),
        "quats.webp": webp(rgba(np.rint((three_ / np.sqrt(2) + 0.5) * 255), largest + 252), 20),
        "scales.webp": webp(rgba(index("scale")), 20),
        "sh0.webp": webp(rgba(index("base"), np.rint(sigmoid(splats["opacity"]) * 255)), 20),
    }
    meta: dict[str, Any] = {
        "version": 2,
        "count": n,
        "means": {"mins": low.tolist(), "maxs": high.tolist(), "files": ["means_l.webp", "means_u.webp"]},
        "scales": {"codebook": books["scale"].tolist(), "files": ["scales.webp"]},
        "quats": {"files": ["quats.webp"]},
        "sh0": {"codebook": books["base"].tolist(), "files": ["sh0.webp"]},
    }
    if rest:
        book = np.linspace(-1, 1, 256)
        palette = np.abs(splats["rest"][:entries, :, :, None] - book).argmin(axis=3).reshape(entries * rest, 3)
        labels = np.arange(n) % entries
        found["shN_centroids.webp"] = webp(rgba(palette), 64 * rest)
        found["shN_labels.webp"] = webp(rgba(np.stack([labels & 255, labels >> 8], axis=1)), 20)
        files = ["shN_centroids.webp", "shN_labels.webp"]
        meta["shN"] = {"count": entries, "bands": RESTS.index(rest), "codebook": book.tolist(), "files": files}
    return found | {"meta.json": json.dumps(meta).encode()}


def write_sog(entries: dict[str, bytes], path: Path) -> None:
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in entries.items():
            archive.writestr(name, data)


def write_glb(splats: Arrays, path: Path, up: F64 | None = None) -> None:
    """As refcodec writes it. up: a unit vector, or None for +y. What others wrote is in test_splat_files."""
    own = {name: values.astype(np.float32) for name, values in splats.items()}
    path.write_bytes(glb_bytes(Splats(**own), np.eye(3)[1] if up is None else up))


def change_glb(path: Path, change: Callable[[dict[str, Any]], Any]) -> None:
    """Writes a file again whose JSON was changed."""
    data = path.read_bytes()
    length = struct.unpack("<I", data[12:16])[0]
    document = json.loads(data[20 : 20 + length])
    change(document)
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    rest = data[20 + length :]
    head = struct.pack("<4sII", b"glTF", 2, 20 + len(text) + len(rest))
    path.write_bytes(head + struct.pack("<I4s", len(text), b"JSON") + text + rest)
