"""GLB files that contain a static scene as a C3GS file, by KHR_gaussian_splatting_compression_c3gs (spec/gltf).

The C3GS file is a buffer view. The accessors describe the Gaussians that it decodes to. With a fallback they also have
these Gaussians as plain numbers, for readers without the extension.
"""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from .. import __version__
from ..bitstream.dimensions import STATIC
from ..bitstream.header import RenderInfo
from ..bitstream.splat import HARMONICS, LENGTHS, LOGIT, MEAN, QUATERNION
from ..files.documents import DocumentError, parse_json
from ..files.text import printable
from ..render.harmonics import ZERO, degree_of
from ..statuses import UsageError
from .glb import CHUNK, EXTENSION, HEAD, upright

F64 = NDArray[np.float64]

COMPRESSION = "KHR_gaussian_splatting_compression_c3gs"
# Maximum bytes of the JSON that is read.
JSON_MAX = 1 << 20
_FLOAT, _SHORT, _POINTS, _VERTICES = 5126, 5123, 0, 34962
_TYPES = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}
# SPEC 6.5, code points of ITU-T H.273. 2 is unspecified, and stands for the first of each.
_PRIMARIES = (1, 2)
_COLOUR_SPACES = {13: "srgb_rec709_display", 2: "srgb_rec709_display", 8: "lin_rec709_display"}


def colour_space(render: RenderInfo) -> str:
    """Returns the colorSpace of KHR_gaussian_splatting for a scene. Raises ValueError if it has no name there."""
    found = _COLOUR_SPACES.get(render.transfer_characteristics) if render.colour_primaries in _PRIMARIES else None
    if found is None:
        raise ValueError(
            f"its colours have primaries {render.colour_primaries} and transfer characteristics "
            f"{render.transfer_characteristics} of ITU-T H.273, but glTF has only 1 with 13 (sRGB) or 8 (linear)"
        )
    return found


def attributes_of(numbers: NDArray[np.float32]) -> dict[str, NDArray[np.float32]]:
    """Returns the attributes of KHR_gaussian_splatting by name, float32 [n, parts] each.

    numbers: the Gaussians of 9.4, float32 [n, 11 + colour_outputs]. Means and harmonics keep their bits.
    """
    wide = numbers.astype(np.float64)
    quaternion = wide[:, QUATERNION]
    quaternion = quaternion / np.linalg.norm(quaternion, axis=1, keepdims=True)
    # An accessor holds finite numbers only.
    with np.errstate(over="ignore"):
        lengths = np.minimum(np.exp(wide[:, LENGTHS]), np.finfo(np.float32).max)
        opacity = 1 / (1 + np.exp(-wide[:, LOGIT, None]))
    harmonics = numbers[:, HARMONICS].reshape(len(numbers), (numbers.shape[1] - HARMONICS.start) // 3, 3)
    found = {
        "POSITION": numbers[:, MEAN],
        f"{EXTENSION}:ROTATION": quaternion[:, [1, 2, 3, 0]],
        f"{EXTENSION}:SCALE": lengths,
        f"{EXTENSION}:OPACITY": opacity,
    }
    for degree in range(degree_of(harmonics.shape[1] - 1) + 1):
        for number in range(2 * degree + 1):
            found[f"{EXTENSION}:SH_DEGREE_{degree}_COEF_{number}"] = harmonics[:, degree * degree + number]
    return {name: values.astype(np.float32) for name, values in found.items()}


def _points(attributes: dict[str, NDArray[np.float32]], space: str) -> NDArray[np.uint16]:
    """Returns COLOR_0, which programs without KHR_gaussian_splatting show: linear light and the opacity, [n, 4]."""
    colour = np.clip(ZERO * attributes[f"{EXTENSION}:SH_DEGREE_0_COEF_0"].astype(np.float64) + 0.5, 0, 1)
    if space.startswith("srgb"):
        colour = np.where(colour <= 0.04045, colour / 12.92, ((colour + 0.055) / 1.055) ** 2.4)
    return np.floor(np.hstack([colour, attributes[f"{EXTENSION}:OPACITY"]]) * 65535 + 0.5).astype(np.uint16)


def glb_of_c3gs(data: bytes, numbers: NDArray[np.float32], render: RenderInfo, up: F64, fallback: bool) -> bytes:
    """Returns a GLB file that contains a C3GS file.

    Args:
        data: the C3GS file of a static scene.
        numbers: its Gaussians (9.4), float32 [n, 11 + colour_outputs].
        render: its render information.
        up: its up axis, a unit vector, float64 [3]. The node turns it to +y, which is up in glTF.
        fallback: whether the GLB file also has the Gaussians as plain numbers.

    Raises:
        ValueError: not a static scene, no Gaussians, colours of another space, or a GLB file of 4 GiB or more.
    """
    if render.render_model != STATIC:
        raise ValueError(f"its render_model is {render.render_model}, but only static scenes, {STATIC}, have Gaussians")
    if not len(numbers):
        raise ValueError("it has no Gaussians, and glTF has no empty accessors")
    space, attributes = colour_space(render), attributes_of(numbers)
    columns: dict[str, NDArray[Any]] = {**attributes}
    if fallback:
        columns["COLOR_0"] = _points(attributes, space)
    binary = [data]
    views: list[dict[str, Any]] = [{"buffer": 0, "byteLength": len(data)}]
    accessors: list[dict[str, Any]] = []
    at = len(data)
    for values in columns.values():
        whole = values.dtype == np.uint16
        accessor: dict[str, Any] = {
            "componentType": _SHORT if whole else _FLOAT,
            "count": len(values),
            "type": _TYPES[values.shape[1]],
        }
        if whole:
            accessor["normalized"] = True
        if fallback:
            accessor["bufferView"] = len(views)
            views.append({"buffer": 0, "byteOffset": at, "byteLength": values.nbytes, "target": _VERTICES})
            binary.append(np.ascontiguousarray(values, values.dtype.newbyteorder("<")).tobytes())
            at += values.nbytes
        accessors.append(accessor)
    mean = attributes["POSITION"]
    accessors[0] |= {"min": mean.min(axis=0).tolist(), "max": mean.max(axis=0).tolist()}
    own = {"kernel": "ellipse", "colorSpace": space, "extensions": {COMPRESSION: {"bufferView": 0}}}
    primitive = {
        "mode": _POINTS,
        "attributes": {name: number for number, name in enumerate(columns)},
        "extensions": {EXTENSION: own},
    }
    document = {
        "asset": {"version": "2.0", "generator": f"refcodec {__version__}"},
        "extensionsUsed": [EXTENSION, COMPRESSION],
        **({} if fallback else {"extensionsRequired": [EXTENSION, COMPRESSION]}),
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "rotation": upright(up)}],
        "meshes": [{"primitives": [primitive]}],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": at}],
    }
    text = json.dumps(document, separators=(",", ":")).encode()
    # Each part of the binary chunk is a multiple of four bytes, so that only the text needs padding.
    text += b" " * (-len(text) % 4)
    length = HEAD.size + 2 * CHUNK.size + len(text) + at
    if length >= 1 << 32:
        raise ValueError(f"it would take {length} bytes, but GLB files are below 4 GiB")
    head = HEAD.pack(b"glTF", 2, length) + CHUNK.pack(len(text), b"JSON") + text + CHUNK.pack(at, b"BIN\0")
    return head + b"".join(binary)


def c3gs_of_glb(file: Path) -> bytes:
    """Returns the C3GS file in a GLB file. It is not decoded. Raises UsageError, and OSError."""
    with file.open("rb") as opened:
        try:
            root, length = _chunks(opened)
            start, size = _place(root)
            if not 0 <= start <= start + size <= length:
                raise ValueError("its scene lies outside the binary chunk")
        except ValueError as error:
            raise UsageError(f"{printable(str(file))} gives no C3GS file: {error}") from None
        opened.seek(start, os.SEEK_CUR)
        return opened.read(size)


def _chunks(opened: BinaryIO) -> tuple[Any, int]:
    """Returns the JSON of a GLB file, and the length of its binary chunk, which is then to be read.

    Raises ValueError, and OSError.
    """
    size = os.fstat(opened.fileno()).st_size
    head = opened.read(HEAD.size)
    if len(head) < HEAD.size or HEAD.unpack(head)[:2] != (b"glTF", 2):
        raise ValueError("it is not a GLB file of glTF 2.0")

    def chunk(kind: bytes, name: str) -> int:
        head = opened.read(CHUNK.size)
        length, own = CHUNK.unpack(head) if len(head) == CHUNK.size else (0, b"")
        if own != kind or length > size - opened.tell():
            raise ValueError(f"its chunk {name} is missing or truncated")
        return int(length)

    length = chunk(b"JSON", "JSON")
    if length > JSON_MAX:
        raise ValueError(f"its chunk JSON has more than {JSON_MAX} bytes")
    try:
        root = parse_json(opened.read(length), JSON_MAX)
    except DocumentError as error:
        raise ValueError(f"its chunk JSON is not JSON ({error})") from None
    return root, chunk(b"BIN\0", "BIN")


def _member(value: Any, *path: str | int) -> Any:
    """Returns a member of nested objects and lists by its names and numbers, or None if there is none."""
    for step in path:
        if isinstance(step, str):
            value = value.get(step) if isinstance(value, dict) else None
        else:
            value = value[step] if isinstance(value, list) and 0 <= step < len(value) else None
    return value


def _list(value: Any) -> list[Any]:
    return value if isinstance(value, list) else []


def _place(root: Any) -> tuple[int, int]:
    """Returns where the C3GS file is in the binary chunk, and its length. root: the JSON. Raises ValueError."""
    found = [
        _member(primitive, "extensions", EXTENSION, "extensions", COMPRESSION, "bufferView")
        for mesh in _list(_member(root, "meshes"))
        for primitive in _list(_member(mesh, "primitives"))
        if _member(primitive, "extensions", EXTENSION, "extensions", COMPRESSION) is not None
    ]
    # Several primitives may show one scene.
    count = len({*map(repr, found)})
    if count != 1:
        raise ValueError(f"it has {count} scenes with {COMPRESSION}, but must have exactly 1")
    number = found[0]
    view = _member(root, "bufferViews", number) if type(number) is int else None
    if not isinstance(view, dict):
        raise ValueError(f"its list bufferViews has no entry {printable(repr(number), 20)}")
    buffer, start, length = view.get("buffer"), view.get("byteOffset", 0), view.get("byteLength")
    if not type(buffer) is type(start) is type(length) is int:
        raise ValueError("the numbers of its buffer view are not integers")
    if buffer != 0 or _member(root, "buffers", 0, "uri") is not None:
        raise ValueError("its scene is in another file, which a buffer names: use that file")
    return start, length
