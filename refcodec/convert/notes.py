"""Files that 3DGS programs write beside a trained model: cfg_args, the text of its settings, and cameras.json."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np
from msgspec import Meta

from ..files.text import printable
from ..folder.layout import SceneFolderError, there
from ..formats.common import ContentError, Document, errors_in
from ..rendering.camera import ROTATION_TOLERANCE, SIDE_MAX, Camera

SETTINGS_FILE, CAMERAS_FILE = "cfg_args", "cameras.json"
# A line of some kilobytes.
SETTINGS_MAX = 64 << 10
# A camera takes some 500 bytes.
CAMERAS_MAX, CAMERAS_BYTES = 16384, 8 << 20


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
_Focal = Annotated[float, Meta(gt=0, le=_MOST)]


class _Camera(msgspec.Struct):
    """A camera. Its position is in the world, and its rotation is from the camera to the world, by rows."""

    width: _Side
    height: _Side
    fx: _Focal
    fy: _Focal
    rotation: tuple[_Vector, _Vector, _Vector]
    position: _Vector
    img_name: Any = None


_Cameras = Annotated[list[_Camera], Meta(max_length=CAMERAS_MAX)]


def read_cameras(file: Path) -> list[Camera]:
    """Returns the cameras of a cameras.json, in its order; none if the file is missing. Raises SceneFolderError."""
    advice = "restore the file, or remove it"
    if not there(file, advice):
        return []
    with file.open("rb") as opened:
        data = opened.read(CAMERAS_BYTES + 1)
    with errors_in(file, advice):
        listed = Document("text", data, CAMERAS_BYTES).get("", _Cameras)
        return [_camera(number, stated) for number, stated in enumerate(listed)]


def _camera(number: int, stated: _Camera) -> Camera:
    """Returns a camera of the file. Raises ContentError."""
    rotation, centre = np.array(stated.rotation).T, np.array(stated.position)
    right = np.abs(rotation).max() < 2 and np.abs(rotation @ rotation.T - np.eye(3)).max() <= ROTATION_TOLERANCE
    if not right or np.linalg.det(rotation) < 0:
        raise ContentError(f"[{number}] has a matrix that is not a rotation to {ROTATION_TOLERANCE}")
    name = printable(str(number if stated.img_name is None else stated.img_name), 200)
    width, height = int(stated.width), int(stated.height)
    return Camera(name, width, height, stated.fx, stated.fy, width / 2, height / 2, rotation, -rotation @ centre)
