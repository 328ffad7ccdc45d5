"""GLB files: glTF 2.0 with the extension KHR_gaussian_splatting of Khronos, in one binary file.

Gaussians are read in the coordinates of their mesh, the only one. The rotation of its node gives the up axis.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from ..bitstream.cameras import rotation_matrix
from ..export.glb import CHUNK, COMPRESSION, EXTENSION, HEAD, SPACE
from ..files.documents import DocumentError, parse_json
from ..files.text import printable
from ..folder.layout import SceneFolderError
from ..rendering.harmonics import REST
from .splat_arrays import ADVICE, Arrays, check_count

# Maximum bytes of the JSON, and of the numbers.
JSON_MAX, DATA_MAX = 1 << 20, 1 << 31
# Numbers by componentType. glTF normalises integers to a span of 1.
TYPES = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5126: "<f4"}
# The largest stride of a buffer view in bytes.
STRIDE_MAX = 252
WIDTHS = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}


class _Gltf:
    """The JSON of a file, and the bytes of its only buffer."""

    def __init__(self, file: Path) -> None:
        """Reads the file. Raises SceneFolderError, and OSError."""
        self.file = file
        with file.open("rb") as opened:
            size = os.fstat(opened.fileno()).st_size
            head = opened.read(HEAD.size)
            if len(head) < HEAD.size or HEAD.unpack(head)[:2] != (b"glTF", 2):
                raise self.fault("it is not a GLB file of glTF 2.0")
            text = self._chunk(opened, b"JSON", JSON_MAX, size)
            self.data = self._chunk(opened, b"BIN\0", DATA_MAX, size)
        try:
            self.root = parse_json(text, JSON_MAX)
        except DocumentError as error:
            raise self.fault(f"its JSON chunk is not JSON ({error})") from None

    def fault(self, problem: str) -> SceneFolderError:
        return SceneFolderError(self.file, problem, ADVICE)

    def _chunk(self, opened: BinaryIO, kind: bytes, most: int, size: int) -> bytes:
        """Returns the bytes of the next chunk. size: of the file."""
        head = opened.read(CHUNK.size)
        length, chunk_kind = CHUNK.unpack(head) if len(head) == CHUNK.size else (0, b"")
        name = kind.rstrip(b"\0").decode()
        if chunk_kind != kind or length > size - opened.tell():
            raise self.fault(f"its chunk {name} is missing or truncated")
        if length > most:
            raise self.fault(f"its chunk {name} has more than {most} bytes")
        return opened.read(length)

    def items(self, name: str) -> list[dict[str, Any]]:
        """Returns the objects of a list of the root, none if it is missing."""
        values = self.root.get(name, []) if isinstance(self.root, dict) else None
        if not isinstance(values, list) or not all(isinstance(item, dict) for item in values):
            raise self.fault(f"its {name} is not a list of objects")
        return values

    def item(self, name: str, number: Any) -> dict[str, Any]:
        """Returns an object of a list by its number."""
        entries = self.items(name)
        if type(number) is not int or not 0 <= number < len(entries):
            raise self.fault(f"its list {name} has no entry {printable(repr(number), 20)}")
        return entries[number]

    def integer(self, fields: dict[str, Any], name: str, default: int, low: int, high: int) -> int:
        value = fields.get(name, default)
        if type(value) is not int or not low <= value <= high:
            raise self.fault(f"a {name} is {printable(repr(value), 20)}, but must be an integer from {low} to {high}")
        return value

    def column(self, attributes: dict[str, Any], name: str, width: int, count: int | None) -> NDArray[np.float64]:
        """Returns an attribute of the vertices, float64 [count, width]. count: None for the stated one."""
        if name not in attributes:
            raise self.fault(f"it has no attribute {name}")
        accessor = self.item("accessors", attributes[name])
        kind, form = accessor.get("componentType"), accessor.get("type")
        if type(kind) is not int or kind not in TYPES or not isinstance(form, str) or WIDTHS.get(form) != width:
            raise self.fault(f"its {name} does not have {width} numbers of type float, byte or short")
        dtype = np.dtype(TYPES[kind])
        if (
            "sparse" in accessor
            or "bufferView" not in accessor
            or (dtype.kind != "f" and not accessor.get("normalized"))
        ):
            raise self.fault(
                f"its {name} is sparse or not normalized, but must be dense, and normalized if it holds integers"
            )
        view = self.item("bufferViews", accessor["bufferView"])
        stated = self.integer(accessor, "count", 0, 0, DATA_MAX)
        if count is None:
            check_count(self.file, stated, len(self.data))
        elif stated != count:
            raise self.fault(f"its {name} has {stated} rows for {count} Gaussians")
        self.integer(view, "buffer", 0, 0, 0)
        start = self.integer(view, "byteOffset", 0, 0, DATA_MAX)
        length = self.integer(view, "byteLength", 0, 0, DATA_MAX)
        row = width * dtype.itemsize
        stride = self.integer(view, "byteStride", row, row, STRIDE_MAX)
        own = self.integer(accessor, "byteOffset", 0, 0, DATA_MAX)
        if start + length > len(self.data) or own + (stated - 1) * stride + row > length:
            raise self.fault(f"its {name} lies outside its buffer")
        rows = np.ndarray((stated, width), dtype, self.data, start + own, (stride, dtype.itemsize))
        if dtype.kind == "f":
            return rows.astype(np.float64)
        return np.maximum(rows / float(np.iinfo(dtype).max), -1.0)


def _primitive(gltf: _Gltf) -> tuple[int, dict[str, Any]]:
    """Returns the one primitive with Gaussians, and the number of its mesh. Raises SceneFolderError."""
    found: list[tuple[int, dict[str, Any]]] = []
    for number, mesh in enumerate(gltf.items("meshes")):
        primitives = mesh.get("primitives")
        for primitive in primitives if isinstance(primitives, list) else ():
            extensions = primitive.get("extensions") if isinstance(primitive, dict) else None
            if isinstance(extensions, dict) and isinstance(extensions.get(EXTENSION), dict):
                found.append((number, primitive))
    if len(found) != 1:
        raise gltf.fault(f"it has {len(found)} primitives with {EXTENSION}, but must have exactly 1")
    number, primitive = found[0]
    extension = primitive["extensions"][EXTENSION]
    for name, wanted in SPACE.items():
        if extension.get(name, wanted) != wanted:
            stated = printable(repr(extension[name]), 40)
            raise gltf.fault(f"its {name} is {stated}, but only {wanted!r} is supported")
    compressed, attributes = extension.get("extensions"), primitive.get("attributes")
    # A C3GS file may have the Gaussians as plain numbers, too.
    if compressed and not (isinstance(compressed, dict) and set(compressed) == {COMPRESSION}):
        raise gltf.fault("its Gaussians are compressed by another extension, which is not supported")
    if not isinstance(attributes, dict):
        raise gltf.fault("its Gaussians have no attributes")
    if compressed and "bufferView" not in gltf.item("accessors", attributes.get("POSITION")):
        raise gltf.fault("its Gaussians are a C3GS file, which `refcodec export FILE -o scene.c3gs` takes out")
    return number, primitive


def read_glb(file: Path) -> Arrays:
    """Returns the Gaussians of a file. Raises SceneFolderError, and OSError."""
    gltf = _Gltf(file)
    attributes = _primitive(gltf)[1]["attributes"]
    mean = gltf.column(attributes, "POSITION", 3, None)

    def column(name: str, width: int) -> NDArray[np.float64]:
        return gltf.column(attributes, f"{EXTENSION}:{name}", width, len(mean))

    degree = max((d for d in range(1, len(REST)) if f"{EXTENSION}:SH_DEGREE_{d}_COEF_0" in attributes), default=0)
    rest = np.zeros((len(mean), REST[degree], 3), np.float32)
    for band in range(1, degree + 1):
        for number in range(2 * band + 1):
            rest[:, band * band - 1 + number] = column(f"SH_DEGREE_{band}_COEF_{number}", 3)
    opacity = column("OPACITY", 1)[:, 0]
    with np.errstate(all="ignore"):
        arrays = {
            "mean": mean,
            "base": column("SH_DEGREE_0_COEF_0", 3),
            "opacity": np.log(opacity / (1 - opacity)),
            "scale": np.log(column("SCALE", 3)),
            "quaternion": column("ROTATION", 4)[:, [3, 0, 1, 2]],
        }
        return {name: values.astype(np.float32) for name, values in arrays.items()} | {"rest": rest}


def glb_up(file: Path) -> NDArray[np.float64]:
    """Returns the up axis of the Gaussians of a file, a unit vector, float64 [3].

    The node of the mesh turns this axis to +y, which is up in glTF. Raises SceneFolderError, and OSError.
    """
    gltf = _Gltf(file)
    mesh, _ = _primitive(gltf)
    node = next((node for node in gltf.items("nodes") if node.get("mesh") == mesh), {})
    stated = node.get("rotation", [0, 0, 0, 1])
    right = isinstance(stated, list) and len(stated) == 4 and all(type(v) in (int, float) for v in stated)
    turn = np.array(stated if right else [0, 0, 0, 1], np.float64)
    if not right or np.abs(turn).max() > 2 or not 0.9 < np.linalg.norm(turn) < 1.1:
        raise gltf.fault("the rotation of a node is not a unit quaternion")
    up: NDArray[np.float64] = rotation_matrix(turn[[3, 0, 1, 2]] / np.linalg.norm(turn))[1]
    return up


def c3gs_of_glb(file: Path) -> bytes:
    """Returns the C3GS file in a GLB file. It is not decoded. Raises SceneFolderError, and OSError."""
    gltf = _Gltf(file)
    start, length = _place(gltf)
    if not 0 <= start <= start + length <= len(gltf.data):
        raise gltf.fault("its scene lies outside the binary chunk")
    return gltf.data[start : start + length]


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


def _place(gltf: _Gltf) -> tuple[int, int]:
    """Returns where the C3GS file is in the binary chunk, and its length. Raises SceneFolderError."""
    root = gltf.root
    found = [
        _member(primitive, "extensions", EXTENSION, "extensions", COMPRESSION, "bufferView")
        for mesh in _list(_member(root, "meshes"))
        for primitive in _list(_member(mesh, "primitives"))
        if _member(primitive, "extensions", EXTENSION, "extensions", COMPRESSION) is not None
    ]
    # Several primitives may show one scene.
    count = len({*map(repr, found)})
    if count != 1:
        raise gltf.fault(f"it has {count} scenes with {COMPRESSION}, but must have exactly 1")
    number = found[0]
    view = _member(root, "bufferViews", number) if type(number) is int else None
    if not isinstance(view, dict):
        raise gltf.fault(f"its list bufferViews has no entry {printable(repr(number), 20)}")
    buffer, start, length = view.get("buffer"), view.get("byteOffset", 0), view.get("byteLength")
    if not type(buffer) is type(start) is type(length) is int:
        raise gltf.fault("the numbers of its buffer view are not integers")
    if buffer != 0 or _member(root, "buffers", 0, "uri") is not None:
        raise gltf.fault("its scene is in another file, which a buffer names: use that file")
    return start, length
