"""GLB files: glTF 2.0 with the extension KHR_gaussian_splatting of Khronos, in one binary file.

Positions are those of the scene. A node turns the up axis of the scene to +y, which is up in glTF. Quaternions are
x, y, z, w. Written numbers are float32. A file may carry a scene as a C3GS file, by the extension of spec/gltf. Files
.gltf, with their numbers in another file, are read, too.
"""

import base64
import json
import re
import struct
from pathlib import Path
from typing import Annotated, Any
from urllib.parse import unquote

import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from .. import __version__
from ..bitstream.cameras import rotation_matrix
from ..files.outputs import Kind
from ..files.present import mapped
from ..files.text import printable
from . import packing
from .common import ContentError, Data, Document, Options, beside, check_count, cut_degree, remark
from .harmonics import REST, ZERO, snapped
from .splats import F64, Splats, joined, moved, narrowed

EXTENSION, COMPRESSION = "KHR_gaussian_splatting", "KHR_gaussian_splatting_compression_c3gs"
# Files with this extension may have integers as they are.
_INTEGERS = "KHR_mesh_quantization"
# What a node with Gaussians may not have.
_OF_NODES = ("skin", "extensions/EXT_mesh_gpu_instancing")
_PLAIN = "export glTF without compression, or PLY"
_APPLY = "apply the transforms of its nodes in the program that made it"
# The kernel and the colour space, as in 3DGS.
_SPACE = {"kernel": "ellipse", "colorSpace": "srgb_rec709_display"}
# Maximum bytes of the JSON, of the numbers, and of the JSON of a .gltf file, which may have its numbers in base64.
JSON_MAX, DATA_MAX, TEXT_MAX = 1 << 20, 1 << 31, 1 << 28
# Maximum number of nodes with Gaussians.
PLACES_MAX = 4096
# Numbers by componentType. glTF normalises integers to a span of 1.
_TYPES = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5126: "<f4"}
_FLOAT, _BYTE, _POINTS, _VERTICES = 5126, 5121, 0, 34962
_WIDTHS = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}
HEAD, CHUNK = struct.Struct("<4sII"), struct.Struct("<I4s")
_START = '{"asset":{"version":"2.0","generator":"refcodec'
KIND = Kind(
    "a GLB file that refcodec wrote", re.compile(rb"glTF\x02\x00\x00\x00.{8}JSON" + re.escape(_START.encode()), re.S)
)

# The types of values of the JSON.
_Size = Annotated[int, Meta(ge=0, le=DATA_MAX)]
_Stride = Annotated[int, Meta(ge=1, le=252)]
_Part = Annotated[float, Meta(ge=-2, le=2)]
_Number = Annotated[float, Meta(ge=-1e12, le=1e12)]
_Three = tuple[_Number, _Number, _Number]
_Matrix = Annotated[list[_Number], Meta(min_length=16, max_length=16)]
_Rotation = tuple[_Part, _Part, _Part, _Part]
_Type = Annotated[int, Meta(ge=min(_TYPES), le=max(_TYPES))]
_Attributes = dict[str, Annotated[int, Meta(ge=0)]]


# --- reading ----------------------------------------------------------------------------------------------------------


class _Gltf:
    """The JSON of a file, and the bytes of its binary chunk."""

    def __init__(self, data: Data) -> None:
        """Raises ContentError."""
        if len(data) < HEAD.size or HEAD.unpack_from(data)[:2] != (b"glTF", 2):
            raise ContentError("it is not a GLB file of glTF 2.0")
        if (stated := HEAD.unpack_from(data)[2]) > len(data):
            raise ContentError(f"it states {stated} bytes, but has {len(data)}: it is cut", "copy or export it again")
        text, place = _chunk(data, HEAD.size, b"JSON", JSON_MAX)
        self.data, _ = _chunk(data, place, b"BIN\0", DATA_MAX)
        self.root = Document("chunk JSON", text, JSON_MAX)

    def primitives(self) -> list[tuple[int, str]]:
        """Returns the paths of the primitives with Gaussians, each with the number of its mesh. Raises ContentError."""
        get = self.root.get
        places = [
            (mesh, f"meshes/{mesh}/primitives/{number}")
            for mesh in range(len(get("meshes", list[Any], [])))
            for number in range(len(get(f"meshes/{mesh}/primitives", list[Any], [])))
        ]
        return [place for place in places if get(f"{place[1]}/extensions/{EXTENSION}", Any, None) is not None]

    def placed(self) -> list[tuple[str, F64]]:
        """Returns the path of each primitive with Gaussians, and the matrix that takes it to the scene, float64 [4, 4].

        A primitive is there as often as nodes of the scene have its mesh. One without nodes is there once. Raises
        ContentError.
        """
        get, meshes, found = self.root.get, self.primitives(), list[tuple[str, F64]]()
        if not meshes:
            used = [name for name in get("extensionsUsed", list[str], []) if "spz" in name or "splat" in name]
            other = f"but uses {_names(used)}" if {*used} - {EXTENSION} else "so it is no splat"
            raise ContentError(f"it has 0 primitives with {EXTENSION}, {other}", _PLAIN)
        paths: dict[int, list[str]] = {}
        for mesh, path in meshes:
            paths.setdefault(mesh, []).append(path)
        nodes = range(len(get("nodes", list[Any], [])))
        below = {number for node in nodes for number in get(f"nodes/{node}/children", list[_Size], [])}
        roots = get(f"scenes/{get('scene', _Size, 0)}/nodes", list[_Size], [n for n in nodes if n not in below])
        left, seen = [(node, np.eye(4)) for node in reversed(roots)], set[int]()
        while left:
            node, above = left.pop()
            if node in seen or node not in nodes:
                raise ContentError(f"its nodes are not trees: node {node} is missing, or has several parents")
            seen.add(node)
            with np.errstate(all="ignore"):
                matrix = above @ self.transform(f"nodes/{node}")
            left += [(child, matrix) for child in reversed(get(f"nodes/{node}/children", list[_Size], []))]
            own = paths.get(get(f"nodes/{node}/mesh", _Size, -1), [])
            for name in _OF_NODES if own else ():
                if get(f"nodes/{node}/{name}", Any, None) is not None:
                    raise ContentError(f"its node {node} has {name}, which is not supported with splats", _APPLY)
            found += [(path, matrix) for path in own]
        if len(found) > PLACES_MAX:
            raise ContentError(f"its nodes show splats {len(found)} times, but {PLACES_MAX} are the most", _APPLY)
        return found or [(path, np.eye(4)) for _, path in meshes]

    def transform(self, node: str) -> F64:
        """Returns the matrix of a node, without that of its parents, float64 [4, 4]. Raises ContentError."""
        get, matrix = self.root.get, np.eye(4)
        if (columns := get(f"{node}/matrix", _Matrix, None)) is not None:
            return np.array(columns, np.float64).reshape(4, 4).T
        turn = np.array(get(f"{node}/rotation", _Rotation, (0, 0, 0, 1)), np.float64)
        length = np.linalg.norm(turn)
        if not 0.9 < length < 1.1:
            raise ContentError("the rotation of a node is not a unit quaternion")
        matrix[:3, :3] = rotation_matrix(turn[[3, 0, 1, 2]] / length) * get(f"{node}/scale", _Three, (1, 1, 1))
        matrix[:3, 3] = get(f"{node}/translation", _Three, (0, 0, 0))
        return matrix

    def frame(self) -> tuple[F64, list[tuple[str, F64]]]:
        """Returns the rotation from the axes of the first mesh with Gaussians to the scene, [3, 3], and placed().

        Raises ContentError for a transform that does more than to turn, mirror, move, and scale all axes alike.
        """
        places = self.placed()
        for path, matrix in places:
            linear = matrix[:3, :3]
            with np.errstate(all="ignore"):
                gram = linear.T @ linear
                size = np.trace(gram) / 3
                uneven = np.abs(gram - size * np.eye(3)).max()
            if not (np.isfinite(matrix).all() and size > 1e-24 and uneven < 1e-4 * size):
                shown = path.removesuffix("/primitives/0")
                raise ContentError(f"its nodes shear {shown}, or scale its axes differently, which is no splat", _APPLY)
        first = places[0][1][:3, :3]
        size = np.linalg.det(first)
        return snapped(first / np.cbrt(size)), places

    def gaussians(self, path: str) -> dict[str, int]:
        """Returns the attributes of the Gaussians of a primitive. Raises ContentError."""
        own = f"{path}/extensions/{EXTENSION}"
        if self.root.get(f"{path}/targets", Any, None) is not None:
            raise ContentError("its Gaussians have targets of morphing, which are not supported")
        for name, wanted in _SPACE.items():
            stated = self.root.get(f"{own}/{name}", str, wanted)
            if stated != wanted:
                raise ContentError(f"its {name} is {printable(repr(stated), 40)}, but only {wanted!r} is supported")
        compressed = self.root.get(f"{own}/extensions", dict[str, Any], {})
        # A C3GS file may have the Gaussians as plain numbers, too.
        if others := sorted(compressed.keys() - {COMPRESSION}):
            raise ContentError(f"its Gaussians are compressed by {_names(others)}, which is not supported", _PLAIN)
        required = {*self.root.get("extensionsRequired", list[str], [])}
        if others := sorted(required - {EXTENSION, COMPRESSION, _INTEGERS}):
            raise ContentError(f"it requires {_names(others)}, which is not supported", _PLAIN)
        attributes = self.root.get(f"{path}/attributes", _Attributes)
        plain = self.root.get(f"accessors/{attributes.get('POSITION')}/bufferView", Any, None) is not None
        if compressed and not plain:
            raise ContentError("its Gaussians are a C3GS file, which `refcodec export FILE -o scene.c3gs` takes out")
        return attributes

    def column(self, attributes: dict[str, int], name: str, width: int, count: int | None) -> F64:
        """Returns an attribute of the vertices, float64 [count, width]. count: None for the stated one.

        Raises ContentError.
        """
        if name not in attributes:
            raise ContentError(f"it has no attribute {name}")
        get, accessor = self.root.get, f"accessors/{attributes[name]}"
        kind = _TYPES.get(get(f"{accessor}/componentType", _Type))
        if kind is None or _WIDTHS.get(get(f"{accessor}/type", str)) != width:
            raise ContentError(f"its {name} does not have {width} numbers of type float, byte or short")
        dtype = np.dtype(kind)
        normalized = get(f"{accessor}/normalized", bool, False)
        plain = name == f"{EXTENSION}:SCALE" or _INTEGERS in get("extensionsUsed", list[str], [])
        if not (dtype.kind == "f" or normalized or plain):
            raise ContentError(f"its {name} has integers that are not normalized")
        if get(f"{accessor}/sparse", Any, None) is not None:
            raise ContentError(f"its {name} is sparse, which is not supported")
        stated = get(f"{accessor}/count", _Size)
        if count is None:
            check_count(stated, len(self.data))
        elif stated != count:
            raise ContentError(f"its {name} has {stated} rows for {count} Gaussians")
        start, length, view = self.part(get(f"{accessor}/bufferView", _Size))
        row = width * dtype.itemsize
        stride, own = get(f"{view}/byteStride", _Stride, row), get(f"{accessor}/byteOffset", _Size, 0)
        if stride < row or own + (stated - 1) * stride + row > length:
            raise ContentError(f"its {name} lies outside its buffer view, or its rows overlap")
        rows = np.ndarray((stated, width), dtype, self.data, start + own, (stride, dtype.itemsize))
        if dtype.kind == "f" or not normalized:
            return rows.astype(np.float64)
        return np.maximum(rows / float(np.iinfo(dtype).max), -1.0)

    def part(self, number: int) -> tuple[int, int, str]:
        """Returns the start and the length of a buffer view in the binary chunk, and its path. Raises ContentError."""
        get, view = self.root.get, f"bufferViews/{number}"
        start, length = get(f"{view}/byteOffset", _Size, 0), get(f"{view}/byteLength", _Size)
        if others := sorted(get(f"{view}/extensions", dict[str, Any], {})):
            raise ContentError(f"its {view} is compressed by {_names(others)}, which is not supported", _PLAIN)
        if get(f"{view}/buffer", _Size) or get("buffers/0/uri", Any, None) is not None:
            raise ContentError(f"its {view} is in another file, which a buffer names: use that file")
        if start + length > len(self.data):
            raise ContentError(f"its {view} lies outside the binary chunk")
        return start, length, view


def _chunk(data: Data, place: int, kind: bytes, most: int) -> tuple[bytes, int]:
    """Returns the bytes of the chunk at a place, and the place after it. Raises ContentError."""
    head = data[place : place + CHUNK.size]
    length, chunk_kind = CHUNK.unpack(head) if len(head) == CHUNK.size else (0, b"")
    start, name = place + CHUNK.size, kind.rstrip(b"\0").decode()
    if chunk_kind != kind or start + length > len(data):
        raise ContentError(f"its chunk {name} is missing or truncated")
    if length > most:
        raise ContentError(f"its chunk {name} has more than {most} bytes")
    return data[start : start + length], start + length


def _names(extensions: list[str]) -> str:
    return printable(", ".join(extensions), 80)


def packed(file: Path) -> bytes:
    """Returns a .gltf file, with its buffer within or beside it, as a GLB file. Raises ContentError, and OSError."""
    text = mapped(file)[:]
    uri = Document("JSON text", text, TEXT_MAX).get("buffers/0/uri", str)
    head, _, numbers = uri.partition(";base64,")
    try:
        body = base64.b64decode(numbers, validate=True) if head.startswith("data:") else None
    except ValueError:
        raise ContentError("its buffer is not base64") from None
    body = beside(file, unquote(uri), DATA_MAX) if body is None else body
    root = json.loads(text)
    del root["buffers"][0]["uri"]
    return _file(json.dumps(root).encode(), [body])


def read(data: Data) -> Splats:
    """Returns the Gaussians of a file, all in one place, along the axes of the first mesh that has some.

    Thus a node that only turns changes no bits. Raises ContentError.
    """
    gltf = _Gltf(data)
    turn, places = gltf.frame()
    parts, count = dict[str, Splats](), 0
    for path, _ in places:
        parts[path] = parts.get(path) or _read(gltf, gltf.gaussians(path))
        count += len(parts[path].mean)
        check_count(count, len(data))
    return joined([moved(parts[path], turn.T @ matrix[:3, :3], turn.T @ matrix[:3, 3]) for path, matrix in places])


def _read(gltf: _Gltf, attributes: dict[str, int]) -> Splats:
    """Returns the Gaussians of a primitive, in the coordinates of their mesh. Raises ContentError."""
    mean = gltf.column(attributes, "POSITION", 3, None)

    def column(name: str, width: int) -> F64:
        return gltf.column(attributes, f"{EXTENSION}:{name}", width, len(mean))

    degree = cut_degree(max(d for d in range(5) if not d or f"{EXTENSION}:SH_DEGREE_{d}_COEF_0" in attributes))
    rest = np.zeros((len(mean), REST[degree], 3), np.float32)
    with np.errstate(all="ignore"):
        for number, name in enumerate(_coefficients(degree)):
            rest[:, number] = column(name, 3)
        opacity, lengths = column("OPACITY", 1)[:, 0], column("SCALE", 3)
        # Earlier drafts of the extension have logarithms, which are hardly positive in a whole file.
        if logarithms := np.mean(lengths < 0) > 0.01:
            remark("its SCALE has negative numbers: it is read as logarithms, those of an earlier draft of glTF")
        return narrowed(
            mean=mean,
            base=column("SH_DEGREE_0_COEF_0", 3),
            rest=rest,
            opacity=np.log(opacity / (1 - opacity)),
            scale=lengths if logarithms else np.log(lengths),
            quaternion=column("ROTATION", 4)[:, [3, 0, 1, 2]],
        )


def read_up(data: Data) -> F64:
    """Returns the up axis of the Gaussians of a file, a unit vector, float64 [3].

    The nodes of the first mesh turn this axis to +y, which is up in glTF. Raises ContentError.
    """
    up: F64 = _Gltf(data).frame()[0][1]
    return up


def read_carried(data: Data) -> bytes:
    """Returns the C3GS file in a GLB file. It is not decoded. Raises ContentError."""
    gltf = _Gltf(data)
    paths = [f"{path}/extensions/{EXTENSION}/extensions/{COMPRESSION}" for _, path in gltf.primitives()]
    carried = [path for path in paths if gltf.root.get(path, Any, None) is not None]
    # Several primitives may show one scene.
    numbers = {gltf.root.get(f"{path}/bufferView", _Size) for path in carried}
    if len(numbers) != 1:
        raise ContentError(f"it has {len(numbers)} scenes with {COMPRESSION}, but must have exactly 1")
    start, length, _ = gltf.part(numbers.pop())
    return gltf.data[start : start + length]


# --- writing ----------------------------------------------------------------------------------------------------------


def write(splats: Splats, options: Options) -> bytes:
    """Returns a file. Raises ValueError for 4 GiB or more."""
    return glb_bytes(splats, options.up)


def _coefficients(degree: int) -> list[str]:
    """Returns the names of the attributes of harmonics of degree 1 to `degree`."""
    return [f"SH_DEGREE_{d}_COEF_{number}" for d in range(1, degree + 1) for number in range(2 * d + 1)]


def _attributes(splats: Splats) -> dict[str, NDArray[Any]]:
    """Returns the vertex attributes by name, [n] or [n, parts] each.

    The extension demands lengths, opacities and unit quaternions. Each is rounded once. Other numbers keep their bits.
    """
    opacity = packing.opacities(splats)
    # Accessors hold only finite numbers.
    with np.errstate(over="ignore"):
        lengths = np.minimum(np.exp(splats.scale.astype(np.float64)), np.finfo(np.float32).max)
    # Programs without the extension show points in this colour.
    colour = np.clip(ZERO * splats.base.astype(np.float64) + 0.5, 0, 1)
    # COLOR_0 is linear.
    colour = np.where(colour <= 0.04045, colour / 12.92, ((colour + 0.055) / 1.055) ** 2.4)
    points = np.concatenate([colour, opacity[:, None]], axis=1)
    own = {
        "ROTATION": splats.unit_quaternions()[:, [1, 2, 3, 0]],
        "SCALE": lengths,
        "OPACITY": opacity,
        "SH_DEGREE_0_COEF_0": splats.base,
        **dict(zip(_coefficients(splats.degree), splats.rest.swapaxes(0, 1), strict=True)),
    }
    return {
        "POSITION": splats.mean.astype("<f4"),
        "COLOR_0": packing.nearest_bytes(points * 255),
        **{f"{EXTENSION}:{name}": values.astype("<f4") for name, values in own.items()},
    }


def _upright(up: F64) -> list[float]:
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
    forms = {"": "SCALAR", "3": "VEC3", "4": "VEC4"}
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
        integers = values.dtype == np.uint8
        accessor: dict[str, Any] = {
            "componentType": _BYTE if integers else _FLOAT,
            "count": len(values),
            "type": forms["".join(map(str, values.shape[1:]))],
        }
        if integers:
            accessor["normalized"] = True
        if plain:
            accessor["bufferView"] = len(views)
            views.append({"buffer": 0, "byteOffset": at, "byteLength": values.nbytes, "target": _VERTICES})
            data.append(np.ascontiguousarray(values).tobytes())
            at += values.nbytes
        accessors.append(accessor)
    accessors[0] |= {"min": splats.mean.min(axis=0).tolist(), "max": splats.mean.max(axis=0).tolist()}
    own: dict[str, Any] = {**_SPACE, "sortingMethod": "cameraDistance", "projection": "perspective"}
    used = [EXTENSION]
    if carried is not None:
        own["extensions"] = {COMPRESSION: {"bufferView": 0}}
        used.append(COMPRESSION)
    primitive = {
        "mode": _POINTS,
        "attributes": {name: number for number, name in enumerate(attributes)},
        "extensions": {EXTENSION: own},
    }
    root = {
        "asset": {"version": "2.0", "generator": f"refcodec {__version__}"},
        "extensionsUsed": used,
        **({} if plain else {"extensionsRequired": used}),
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "rotation": _upright(up)}],
        "meshes": [{"primitives": [primitive]}],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": at}],
    }
    return _file(json.dumps(root, separators=(",", ":")).encode(), data)


def _file(text: bytes, data: list[bytes]) -> bytes:
    """Returns a file of its text and the parts of its numbers. Raises ValueError for 4 GiB or more."""
    text += b" " * (-len(text) % 4)
    at = sum(map(len, data))
    data = [*data, bytes(-at % 4)]
    length = HEAD.size + 2 * CHUNK.size + len(text) + at + len(data[-1])
    if length >= 1 << 32:
        raise ValueError(f"it would take {length} bytes, but GLB files are below 4 GiB")
    chunks = CHUNK.pack(len(text), b"JSON") + text + CHUNK.pack(at + len(data[-1]), b"BIN\0")
    return b"".join([HEAD.pack(b"glTF", 2, length), chunks, *data])
