"""C3GS files in GLB files, by the extension KHR_gaussian_splatting_compression_c3gs (spec/gltf)."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any, BinaryIO

from ..bitstream.header import RenderInfo
from ..files.documents import DocumentError, parse_json
from ..files.text import printable
from ..statuses import UsageError
from .glb import CHUNK, COMPRESSION, EXTENSION, HEAD

# Maximum bytes of the JSON that is read.
JSON_MAX = 1 << 20
# SPEC 6.5, code points of ITU-T H.273: BT.709 primaries and the sRGB curve. 2 is unspecified, and means the same here.
_PRIMARIES, _TRANSFER = (1, 2), (13, 2)


def check_colours(render: RenderInfo) -> None:
    """Raises ValueError for a scene whose colours are not those of glb.SPACE."""
    if render.colour_primaries not in _PRIMARIES or render.transfer_characteristics not in _TRANSFER:
        raise ValueError(
            f"its colours have primaries {render.colour_primaries} and transfer characteristics "
            f"{render.transfer_characteristics} of ITU-T H.273, but must have 1 and 13, sRGB"
        )


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
