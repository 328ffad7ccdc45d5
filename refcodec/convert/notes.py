"""Files that 3DGS programs write beside a trained model: cfg_args, the text of its settings, and cameras.json.

A cameras.json is read, and written beside splats. It has the coordinates of the scene, as a PLY file has them, whatever
the axes of another format are.
"""

import json
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np
from msgspec import Meta

from ..files.outputs import Kind
from ..files.text import printable
from ..folder.layout import SceneFolderError, there
from ..formats.common import ContentError, Document, errors_in
from ..rendering.camera import ROTATION_TOLERANCE, SIDE_MAX, Camera

SETTINGS_FILE, CAMERAS_FILE = "cfg_args", "cameras.json"
# A line of some kilobytes.
SETTINGS_MAX = 64 << 10
# A camera takes some 500 bytes.
CAMERAS_MAX, CAMERAS_BYTES = 16384, 8 << 20
# The first key of a file that is written here.
MARK = "refcodec"
WRITTEN = Kind("a cameras.json that refcodec wrote", re.compile(rb'\[\{"generator": "' + MARK.encode() + rb'"'))


@dataclass(frozen=True)
class ModelSettings:
    """Settings of a model, None if the text does not state them.

    white: whether its background is white. voxel: edge of its voxels, world units. features: per anchor. bank:
    whether features are mixed by view.
    """

    white: bool | None = None
    voxel: float | None = None
    features: int | None = None
    bank: bool | None = None


def read_settings(file: Path) -> ModelSettings:
    """Returns the settings that cfg_args states, a text such as Namespace(feat_dim=32). Nothing of it is run.

    A missing file states none. Raises SceneFolderError.
    """
    if not there(file, "restore it, or remove it"):
        return ModelSettings()
    with file.open("rb") as opened:
        data = opened.read(SETTINGS_MAX + 1)
    if len(data) > SETTINGS_MAX or not data.lstrip().startswith(b"Namespace("):
        problem = f"it is not a text Namespace(...) of at most {SETTINGS_MAX} bytes"
        raise SceneFolderError(file, problem, "restore the file, or remove it")
    text = data.decode("utf-8", "replace")

    def stated(name: str) -> str | None:
        match = re.search(rf"[(\s,]{name}=([A-Za-z0-9.+-]{{1,32}})[,)]", text)
        return match and match[1]

    flags = {"True": True, "False": False}
    voxel, features = stated("voxel_size"), stated("feat_dim")
    edge = (
        float(voxel) if voxel and re.fullmatch(r"[0-9.]+(e[+-]?[0-9]{1,3})?", voxel) and voxel.count(".") < 2 else 0.0
    )
    return ModelSettings(
        white=flags.get(stated("white_background") or ""),
        # With 0 or less, the program chooses the voxel size.
        voxel=edge if 0 < edge < np.inf else None,
        features=int(features) if features and features.isdecimal() else None,
        bank=flags.get(stated("use_feat_bank") or ""),
    )


_MOST = float(np.finfo(np.float32).max)
_Number = Annotated[float, Meta(ge=-_MOST, le=_MOST)]
_Vector = tuple[_Number, _Number, _Number]
_Side = Annotated[float, Meta(ge=1, le=SIDE_MAX)]
_Point = Annotated[float, Meta(ge=-SIDE_MAX, le=2 * SIDE_MAX)]
_Focal = Annotated[float, Meta(gt=0, le=_MOST)]


class _Camera(msgspec.Struct):
    """A camera. Its position is in the world, and its rotation is from the camera to the world, by rows.

    3DGS has no cx and cy: the principal point is in the middle. splats: the names of those that it belongs to.
    """

    width: _Side
    height: _Side
    fx: _Focal
    fy: _Focal
    rotation: tuple[_Vector, _Vector, _Vector]
    position: _Vector
    img_name: Any = None
    cx: _Point | None = None
    cy: _Point | None = None
    splats: list[str] | None = None


_Cameras = Annotated[list[_Camera], Meta(max_length=CAMERAS_MAX)]


def read_cameras(file: Path) -> list[Camera]:
    """Returns the cameras of a cameras.json, in its order; none if the file is missing. Raises SceneFolderError."""
    return read_cameras_of(file)[0]


def read_cameras_of(file: Path) -> tuple[list[Camera], list[str]]:
    """As read_cameras. Also returns the names of the splats to which the cameras belong; none if that is not stated."""
    advice = "restore the file, or remove it"
    if not there(file, advice):
        return [], []
    with file.open("rb") as opened:
        data = opened.read(CAMERAS_BYTES + 1)
    with errors_in(file, advice):
        listed = Document("text", data, CAMERAS_BYTES).get("", _Cameras)
        names = listed[0].splats if listed else None
        return [_camera(number, stated) for number, stated in enumerate(listed)], names or []


def cameras_json(cameras: Sequence[Camera], splats: Sequence[str]) -> bytes:
    """Returns a cameras.json of at most CAMERAS_MAX cameras. splats: the names of those that they belong to."""
    lines = []
    for number, camera in enumerate(cameras[:CAMERAS_MAX]):
        marked = {"generator": MARK, "splats": [*splats]} if not number else {}
        names = {"id": number, "img_name": camera.name, "width": camera.width, "height": camera.height}
        pose = {"position": camera.centre.tolist(), "rotation": camera.rotation.T.tolist()}
        lens = {"fy": camera.fy, "fx": camera.fx, "cx": camera.cx, "cy": camera.cy}
        lines.append(json.dumps({**marked, **names, **pose, **lens}))
    return ("[" + ",\n".join(lines) + "]\n").encode()


def _camera(number: int, stated: _Camera) -> Camera:
    """Returns a camera of the file. Raises ContentError."""
    rotation, centre = np.array(stated.rotation).T, np.array(stated.position)
    right = np.abs(rotation).max() < 2 and np.abs(rotation @ rotation.T - np.eye(3)).max() <= ROTATION_TOLERANCE
    if not right or np.linalg.det(rotation) < 0:
        raise ContentError(f"[{number}] has a matrix that is not a rotation to {ROTATION_TOLERANCE}")
    name = printable(str(number if stated.img_name is None else stated.img_name), 200)
    width, height = int(stated.width), int(stated.height)
    cx, cy = (s / 2 if c is None else c for s, c in ((width, stated.cx), (height, stated.cy)))
    return Camera(name, width, height, stated.fx, stated.fy, cx, cy, rotation, -rotation @ centre)
