"""GLB files: glTF 2.0 with the extension KHR_gaussian_splatting of Khronos, in one binary file.

Numbers are float32, and quaternions are x, y, z, w. Positions are those of the scene. A node turns the up
axis of the scene to +y, which is up in glTF.
"""

from __future__ import annotations

import json
import re
import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import __version__
from ..bitstream.header import RenderInfo
from ..files.outputs import Kind
from ..rendering.harmonics import ZERO
from .splats import Splats, nearest_bytes, opacities

F64 = NDArray[np.float64]

EXTENSION = "KHR_gaussian_splatting"
# The extension for a C3GS file in a GLB file (spec/gltf).
COMPRESSION = "KHR_gaussian_splatting_compression_c3gs"
# SPEC 6.5, code points of ITU-T H.273: BT.709 primaries and the sRGB curve. 2 is unspecified, and means the same here.
_PRIMARIES, _TRANSFER = (1, 2), (13, 2)
# The kernel and the colour space, as in 3DGS.
SPACE = {"kernel": "ellipse", "colorSpace": "srgb_rec709_display"}
_FLOAT, _BYTE, _POINTS, _VERTICES = 5126, 5121, 0, 34962
HEAD, CHUNK = struct.Struct("<4sII"), struct.Struct("<I4s")
_START = '{"asset":{"version":"2.0","generator":"refcodec'
GLB = Kind(
    "a GLB file that refcodec wrote", re.compile(rb"glTF\x02\x00\x00\x00.{8}JSON" + re.escape(_START.encode()), re.S)
)


def check_colours(render: RenderInfo) -> None:
    """Raises ValueError for a scene whose colours are not those of SPACE."""
    if render.colour_primaries not in _PRIMARIES or render.transfer_characteristics not in _TRANSFER:
        raise ValueError(
            f"its colours have primaries {render.colour_primaries} and transfer characteristics "
            f"{render.transfer_characteristics} of ITU-T H.273, but must have 1 and 13, sRGB"
        )


def _attributes(splats: Splats) -> dict[str, NDArray[Any]]:
    """Returns the vertex attributes by name, [n] or [n, parts] each.

    The extension demands lengths, opacities and unit quaternions. Each is rounded once. Other numbers keep their bits.
    """
    opacity = opacities(splats)
    # Accessors hold only finite numbers.
    with np.errstate(over="ignore"):
        lengths = np.minimum(np.exp(splats.scale.astype(np.float64)), np.finfo(np.float32).max)
    # Programs without the extension show points in this colour.
    colour = np.clip(ZERO * splats.base.astype(np.float64) + 0.5, 0, 1)
    # COLOR_0 is linear.
    colour = np.where(colour <= 0.04045, colour / 12.92, ((colour + 0.055) / 1.055) ** 2.4)
    points = np.concatenate([colour, opacity[:, None]], axis=1)
    attributes: dict[str, NDArray[Any]] = {
        "POSITION": splats.mean,
        "COLOR_0": nearest_bytes(points * 255),
        f"{EXTENSION}:ROTATION": splats.unit_quaternions()[:, [1, 2, 3, 0]],
        f"{EXTENSION}:SCALE": lengths,
        f"{EXTENSION}:OPACITY": opacity,
        f"{EXTENSION}:SH_DEGREE_0_COEF_0": splats.base,
    }
    for degree in range(1, splats.degree + 1):
        for number in range(2 * degree + 1):
            attributes[f"{EXTENSION}:SH_DEGREE_{degree}_COEF_{number}"] = splats.rest[:, degree * degree - 1 + number]
    return {name: v if v.dtype == np.uint8 else v.astype("<f4") for name, v in attributes.items()}


def upright(up: F64) -> list[float]:
    """Returns the quaternion x, y, z, w of the shortest turn that takes a unit vector to +y. It turns -y about z."""
    x, y, z = up.tolist()
    quaternion = np.array([-z, 0.0, x, 1 + y] if y > -1 else [0.0, 0.0, 1.0, 0.0])
    return (quaternion / np.linalg.norm(quaternion)).tolist()


def glb_bytes(splats: Splats, up: F64, carried: bytes | None = None, plain: bool = True) -> bytes:
    """Returns the file.

    up: the up axis of the scene, a unit vector, float64 [3]. carried: the C3GS file that decodes to these Gaussians,
    for a file with the extension COMPRESSION. plain: whether the file has the Gaussians as plain numbers; if not, only
    readers with that extension can read it. Raises ValueError for a file of 4 GiB or more.
    """
    data: list[bytes] = []
    views: list[dict[str, Any]] = []
    accessors: list[dict[str, Any]] = []
    names = {"": "SCALAR", "3": "VEC3", "4": "VEC4"}
    attributes = _attributes(splats)
    at = 0
    if carried is not None:
        # The bytes of a C3GS file are a multiple of four.
        views.append({"buffer": 0, "byteLength": len(carried)})
        data.append(carried)
        at = len(carried)
    if not plain:
        # No attribute of Gaussians.
        del attributes["COLOR_0"]
    for values in attributes.values():
        kind = _BYTE if values.dtype == np.uint8 else _FLOAT
        accessor: dict[str, Any] = {
            "componentType": kind,
            "count": len(values),
            "type": names["".join(map(str, values.shape[1:]))],
        }
        if kind == _BYTE:
            accessor["normalized"] = True
        if plain:
            accessor["bufferView"] = len(views)
            views.append({"buffer": 0, "byteOffset": at, "byteLength": values.nbytes, "target": _VERTICES})
            data.append(np.ascontiguousarray(values).tobytes())
            at += values.nbytes
        accessors.append(accessor)
    accessors[0] |= {"min": splats.mean.min(axis=0).tolist(), "max": splats.mean.max(axis=0).tolist()}
    own: dict[str, Any] = {**SPACE, "sortingMethod": "cameraDistance", "projection": "perspective"}
    used = [EXTENSION]
    if carried is not None:
        own["extensions"] = {COMPRESSION: {"bufferView": 0}}
        used.append(COMPRESSION)
    primitive = {
        "mode": _POINTS,
        "attributes": {name: number for number, name in enumerate(attributes)},
        "extensions": {EXTENSION: own},
    }
    document = {
        "asset": {"version": "2.0", "generator": f"refcodec {__version__}"},
        "extensionsUsed": used,
        **({} if plain else {"extensionsRequired": used}),
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "rotation": upright(up)}],
        "meshes": [{"primitives": [primitive]}],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": at}],
    }
    text = json.dumps(document, separators=(",", ":")).encode()
    # Every attribute has a multiple of four bytes for each Gaussian, so that only the text needs padding.
    text += b" " * (-len(text) % 4)
    length = HEAD.size + 2 * CHUNK.size + len(text) + at
    if length >= 1 << 32:
        raise ValueError(f"it would take {length} bytes, but GLB files are below 4 GiB")
    head = HEAD.pack(b"glTF", 2, length) + CHUNK.pack(len(text), b"JSON") + text + CHUNK.pack(at, b"BIN\0")
    return head + b"".join(data)
