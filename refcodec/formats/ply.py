"""PLY files of plain 3D Gaussians, as the 3DGS code writes them."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..files import ply
from ..files.outputs import Kind
from .common import ContentError, Data, Options, check_count
from .harmonics import REST
from .splats import Splats

# A comment in the files of refcodec.
MARK = "refcodec"
KIND = Kind(
    "a PLY file of Gaussians that refcodec wrote",
    re.compile(rb"ply\nformat binary_little_endian 1\.0\nelement vertex [0-9]+\ncomment " + MARK.encode() + rb"\n"),
)

Tables = Mapping[str, NDArray[Any]]


def tables_of(data: Data) -> Tables:
    """Returns the elements of a file, among them `vertex`. Raises ContentError and PlyError."""
    tables = ply.parse_ply(data)
    check_count(max(map(len, tables.values()), default=0), len(data))
    if "vertex" not in tables:
        raise ContentError("it has no element vertex")
    return tables


def columns(table: NDArray[Any], names: Sequence[str], kinds: str = "fiu") -> NDArray[np.float32]:
    """Returns some properties of an element, float32 [rows, columns]. kinds: those of NumPy that they may have.

    Raises ContentError for a missing property, or one of another type.
    """
    for name in names:
        if name not in ply.names_of(table) or table.dtype[name].kind not in kinds:
            raise ContentError(f"it has no property {name} of the type of a splat file")
    return ply.float_columns(table, names)


def rest_columns(table: NDArray[Any], kinds: str = "fiu") -> NDArray[np.float32]:
    """Returns the harmonics besides the first, [rows, K, 3], of the properties f_rest, which are ordered by channel.

    Raises ContentError for a number that fits no degree.
    """
    count = sum(name.startswith("f_rest_") for name in ply.names_of(table))
    if count % 3 or count // 3 not in REST:
        allowed = " or ".join(str(3 * rest) for rest in REST)
        raise ContentError(f"it has {count} coefficients f_rest, but must have {allowed}")
    values = columns(table, _numbered("f_rest", count), kinds)
    return np.ascontiguousarray(values.reshape(len(table), 3, count // 3).transpose(0, 2, 1))


def read(tables: Tables) -> Splats:
    """Returns the Gaussians of the elements of a file, with properties in any order. Raises ContentError."""
    vertex = tables["vertex"]
    parts = {name: columns(vertex, properties) for name, properties in _PROPERTIES.items()}
    return Splats(rest=rest_columns(vertex), opacity=columns(vertex, ["opacity"])[:, 0], **parts)


def write(splats: Splats, _: Options) -> bytes:
    """Returns a file: binary, little endian, float32, with normals of 0 after the means. It keeps all bits."""
    count, rest = len(splats.mean), 3 * splats.rest.shape[1]
    by_channel = splats.rest.transpose(0, 2, 1).reshape(count, rest)
    parts: list[NDArray[Any]] = [*(splats.mean, np.zeros((count, 3)), splats.base, by_channel)]
    parts += [splats.opacity[:, None], splats.scale, splats.quaternion]
    names = [*_PROPERTIES["mean"], "nx", "ny", "nz", *_PROPERTIES["base"], *_numbered("f_rest", rest)]
    names += ["opacity", *_PROPERTIES["scale"], *_PROPERTIES["quaternion"]]
    table = np.concatenate(parts, axis=1).astype("<f4").view([(name, "<f4") for name in names])
    return ply.ply_bytes({"vertex": table.reshape(count)}, MARK)


def _numbered(stem: str, count: int) -> list[str]:
    return [f"{stem}_{number}" for number in range(count)]


# The properties of each array of Splats but opacity and rest.
_PROPERTIES = {
    "mean": ["x", "y", "z"],
    "base": _numbered("f_dc", 3),
    "scale": _numbered("scale", 3),
    "quaternion": _numbered("rot", 4),
}
