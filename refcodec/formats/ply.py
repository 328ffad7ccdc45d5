"""PLY files of plain 3D Gaussians, as the 3DGS code writes them."""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..files import ply
from ..files.outputs import Kind
from .common import COMPENSATED, ContentError, Data, Options, check_count, cut_degree, remark
from .harmonics import REST, ZERO
from .packing import BYTE_OPACITY_LEAST, logits, opacities
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
    # Brush and splat-transform state the first, Postshot the second. The last one counts.
    modes = re.findall(r"(?i)^comment +(?:splatrendermode: *(\w+)|antialiased +(\w+))", ply.header_text(data), re.M)
    if modes and (modes[-1][0].lower() == "mip" or modes[-1][1] == "1"):
        remark(COMPENSATED)
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
    count = stated = sum(name.startswith("f_rest_") for name in ply.names_of(table))
    side = math.isqrt(stated // 3 + 1)
    if stated == 3 * (side**2 - 1):
        count = 3 * REST[cut_degree(side - 1)]
    if count % 3 or count // 3 not in REST:
        allowed = " or ".join(str(3 * rest) for rest in REST)
        raise ContentError(f"it has {count} coefficients f_rest, but must have {allowed}")
    names = [f"f_rest_{channel * stated // 3 + number}" for channel in range(3) for number in range(count // 3)]
    values = columns(table, names, kinds)
    return np.ascontiguousarray(values.reshape(len(table), 3, count // 3).transpose(0, 2, 1))


def read(tables: Tables) -> Splats:
    """Returns the Gaussians of the elements of a file, with properties in any order. Raises ContentError.

    Means are float64 if those of the file are.
    """
    vertex = tables["vertex"]
    names = ply.names_of(vertex)
    for name, problem, advice in _KINDS:
        if (name.removeprefix("-") in names and name[0] != "-") or (name[0] == "-" and name[1:] not in names):
            raise ContentError(problem, advice)
    base = _PROPERTIES["base"]
    parts: dict[str, NDArray[Any]] = {name: columns(vertex, own) for name, own in _PROPERTIES.items() if own != base}
    with np.errstate(all="ignore"):
        if vertex["x"].dtype.itemsize > 4:
            # Coordinates of a map need all bits of theirs until an offset is subtracted.
            parts["mean"] = np.stack([vertex[name].astype(np.float64) for name in _PROPERTIES["mean"]], axis=1)
        if vertex["rot_0"].dtype.itemsize > 4:
            # The length of a quaternion has no meaning, but may be beyond float32.
            wide = np.stack([vertex[name] for name in _PROPERTIES["quaternion"]], axis=1)
            most = np.abs(wide).max(axis=1, keepdims=True)
            parts["quaternion"] = (wide / np.where(most > 0, most, 1)).astype(np.float32)
    if base[0] not in names and {*_COLOURS} <= {*names}:
        remark("its colours are integers: they are the same from all directions")
        parts["base"] = ((columns(vertex, _COLOURS, "u") / _most(vertex["red"]) - 0.5) / ZERO).astype(np.float32)
    else:
        parts["base"] = columns(vertex, base)
    if "opacity" not in names and "alpha" in names:
        share = columns(vertex, ["alpha"], "u")[:, 0] / _most(vertex["alpha"])
        parts["opacity"] = logits(share, BYTE_OPACITY_LEAST).astype(np.float32)
    else:
        parts["opacity"] = columns(vertex, ["opacity"])[:, 0]
    splats = Splats(rest=rest_columns(vertex), **parts)
    return _filtered(splats, columns(vertex, [_FILTER])) if _FILTER in names else splats


def _most(values: NDArray[Any]) -> int:
    """Returns the largest integer of a type."""
    return int(np.iinfo(values.dtype).max)


def _filtered(splats: Splats, width: NDArray[np.float32]) -> Splats:
    """Returns Gaussians with the filter of Mip-Splatting (Yu et al., 2024, section 5.1): width [n, 1], world units."""
    remark(f"its {_FILTER} is applied to axes and opacities")
    axes = np.exp(2 * splats.scale.astype(np.float64))
    wider = axes + width.astype(np.float64) ** 2
    logit = logits(opacities(splats) * np.sqrt((axes / wider).prod(axis=1)), 1e-9)
    return replace(splats, scale=(np.log(wider) / 2).astype(np.float32), opacity=logit.astype(np.float32))


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


# Files of other kinds by a property that they have, or with - lack: what they are, and what helps.
_KINDS = (
    ("f_offset_0", "it is a model of Scaffold-GS, not a splat", "give its folder to convert"),
    ("-rot_0", "it is a point cloud, not a splat", "`refcodec fit` takes one"),
    ("-scale_2", "its Gaussians are flat, as those of 2DGS, which have no third axis", "export 3D Gaussians"),
)
_COLOURS, _FILTER = ["red", "green", "blue"], "filter_3D"

# The properties of each array of Splats but opacity and rest.
_PROPERTIES = {
    "mean": ["x", "y", "z"],
    "base": _numbered("f_dc", 3),
    "scale": _numbered("scale", 3),
    "quaternion": _numbered("rot", 4),
}
