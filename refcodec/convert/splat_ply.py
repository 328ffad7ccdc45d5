"""PLY files of plain 3D Gaussians: those of the 3DGS code, and PlayCanvas's compressed ones."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..export.ply import columns
from ..export.splats import with_largest
from ..files.ply import PlyError, check_ply_header, names_of, read_ply
from ..files.text import printable
from ..folder.layout import SceneFolderError
from ..rendering.harmonics import REST, ZERO
from .splat_arrays import ADVICE, Arrays, check_count, logits

# The number of Gaussians in a chunk of a compressed file, which share value ranges.
CHUNK = 256
PACKED = ("packed_position", "packed_rotation", "packed_scale", "packed_color")


def read_splat_ply(file: Path) -> Arrays:
    """Returns the Gaussians of a file, its properties in any order. Raises SceneFolderError."""
    try:
        most, _ = check_ply_header(file)
        check_count(file, most, file.stat().st_size)
        elements = read_ply(file)
    except (PlyError, OSError) as error:
        problem = f"it is not a readable PLY file ({printable(str(error), 120)})"
        raise SceneFolderError(file, problem, ADVICE) from None
    vertex = elements.get("vertex")
    if vertex is None:
        raise SceneFolderError(file, "it has no element vertex", ADVICE)
    if PACKED[0] in names_of(vertex):
        return _packed(file, elements)
    return _plain(file, vertex)


def _plain(file: Path, table: Any) -> Arrays:
    """Returns the Gaussians of a table of 3DGS."""
    rest = _rest(file, table)
    arrays = {name: _array(file, table, names) for name, names in columns(rest).items()}
    arrays["opacity"] = arrays["opacity"][:, 0]
    arrays["rest"] = np.ascontiguousarray(arrays["rest"].reshape(len(table), 3, -1).transpose(0, 2, 1))
    return arrays


def _rest(file: Path, table: Any) -> int:
    """Returns the number of harmonics besides the first. Raises SceneFolderError for a number that fits no degree."""
    extra = sum(name.startswith("f_rest_") for name in names_of(table))
    if extra % 3 or extra // 3 not in REST:
        wanted = " or ".join(str(3 * rest) for rest in REST)
        raise SceneFolderError(file, f"it has {extra} coefficients f_rest, but must have {wanted}", ADVICE)
    return extra // 3


def _array(file: Path, table: Any, names: tuple[str, ...], kinds: str = "fiu") -> NDArray[np.float32]:
    """Returns some properties as float32 [N, columns]. Raises SceneFolderError for a missing property or a list."""
    values = np.empty((len(table), len(names)), np.float32)
    for column, name in enumerate(names):
        values[:, column] = _column(file, table, name, kinds)
    return values


def _column(file: Path, table: Any, name: str, kinds: str) -> NDArray[Any]:
    if name not in names_of(table) or table.dtype[name].kind not in kinds:
        raise SceneFolderError(file, f"it has no property {name} of the type of a splat file", ADVICE)
    return np.asarray(table[name])


# --- compressed -------------------------------------------------------------------------------------------------------


def _packed(file: Path, elements: dict[str, Any]) -> Arrays:
    """Returns the Gaussians of a compressed file, whose integers are positions in the value range of their chunk."""
    vertex, chunks = elements["vertex"], elements.get("chunk")
    count = len(vertex)
    if chunks is None or len(chunks) != -(-count // CHUNK):
        raise SceneFolderError(file, f"it has no element chunk for each {CHUNK} Gaussians", ADVICE)
    words = {name: _column(file, vertex, name, "u").astype(np.uint32).astype(np.int64) for name in PACKED}
    chunk = np.arange(count) // CHUNK

    def between(names: str, axes: str, share: NDArray[np.float64]) -> NDArray[np.float64]:
        low, high = (
            _array(file, chunks, tuple(f"{end}_{names}{axis}" for axis in axes)).astype(np.float64)
            for end in ("min", "max")
        )
        return low[chunk] + share * (high - low)[chunk]

    mean = between("", "xyz", _bits(words["packed_position"], 11, 10, 11))
    scale = between("scale_", "xyz", _bits(words["packed_scale"], 11, 10, 11))
    colour = _bits(words["packed_color"], 8, 8, 8, 8)
    # Files of the first version have no colour ranges.
    ranged = "min_r" in names_of(chunks)
    shade = between("", "rgb", colour[:, :3]) if ranged else colour[:, :3]
    rotation = (_bits(words["packed_rotation"], 2, 10, 10, 10)[:, 1:] - 0.5) * np.sqrt(2)
    quaternion = with_largest(words["packed_rotation"] >> 30, rotation)
    arrays = {
        "mean": mean,
        "base": (shade - 0.5) / ZERO,
        "rest": _packed_rest(file, elements.get("sh"), count),
        "scale": scale,
        "quaternion": quaternion,
    }
    with np.errstate(over="ignore"):
        narrow = {name: values.astype(np.float32) for name, values in arrays.items()}
    return narrow | {"opacity": logits(colour[:, 3])}


def _bits(words: NDArray[np.int64], *widths: int) -> NDArray[np.float64]:
    """Returns the fields of words, the highest bits first, as shares of their largest value: float64 [N, fields]."""
    parts, shift = [], sum(widths)
    for width in widths:
        shift -= width
        parts.append((words >> shift & ((1 << width) - 1)) / ((1 << width) - 1))
    return np.stack(parts, axis=1)


def _packed_rest(file: Path, table: Any, count: int) -> NDArray[np.float64]:
    """Returns the harmonics besides the first, [N, K, 3], of bytes: the centres of 256 steps from -4 to 4."""
    if table is None:
        return np.zeros((count, 0, 3))
    rest = _rest(file, table)
    if len(table) != count:
        raise SceneFolderError(file, f"its element sh has {len(table)} rows, but must have {count}", ADVICE)
    values = _array(file, table, tuple(f"f_rest_{i}" for i in range(3 * rest)), "u").astype(np.float64)
    share = np.where(values == 0, 0, np.where(values == 255, 1, (values + 0.5) / 256))
    return ((share - 0.5) * 8).reshape(count, 3, rest).transpose(0, 2, 1)
