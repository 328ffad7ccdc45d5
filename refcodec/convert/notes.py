"""Files that 3DGS programs write beside a trained model: cfg_args, the text of its settings, and cameras.json."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..files.documents import DocumentError, read_json
from ..files.text import printable
from ..folder.layout import SceneFolderError, there
from ..rendering.camera import ROTATION_TOLERANCE, SIDE_MAX, Camera

SETTINGS_FILE, CAMERAS_FILE = "cfg_args", "cameras.json"
# A line of some kilobytes.
SETTINGS_MAX = 64 << 10
# A camera takes some 500 bytes.
CAMERAS_MAX, CAMERAS_BYTES = 16384, 8 << 20

_CAMERAS = "restore the file, or remove it"


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


def read_cameras(file: Path) -> list[Camera]:
    """Returns the cameras of a cameras.json, in its order; none if the file is missing.

    The file states the centre of a camera in the world, and by rows the rotation from camera to world. Raises
    SceneFolderError.
    """
    if not there(file, _CAMERAS):
        return []
    try:
        listed = read_json(file, CAMERAS_BYTES)
    except DocumentError as error:
        raise SceneFolderError(file, f"it is not JSON ({error})", _CAMERAS) from None
    if not isinstance(listed, list) or len(listed) > CAMERAS_MAX:
        raise SceneFolderError(file, f"it is not a list of at most {CAMERAS_MAX} cameras", _CAMERAS)
    return [_camera(file, number, fields) for number, fields in enumerate(listed)]


def _is_numbers(value: Any, shape: tuple[int, ...]) -> bool:
    """Whether a JSON value is nested lists of numbers of the given shape."""
    if not shape:
        return isinstance(value, int | float) and not isinstance(value, bool)
    first, *others = shape
    return isinstance(value, list) and len(value) == first and all(_is_numbers(v, tuple(others)) for v in value)


def _camera(file: Path, number: int, fields: Any) -> Camera:
    def fault(problem: str) -> SceneFolderError:
        return SceneFolderError(file, f"[{number}] {problem}", _CAMERAS)

    if not isinstance(fields, dict):
        raise fault("is not an object")

    def numbers(name: str, shape: tuple[int, ...]) -> NDArray[np.float64]:
        value = fields.get(name)
        array = np.array(value, np.float64) if _is_numbers(value, shape) else np.full(shape, np.inf)
        if np.abs(array).max() > np.finfo(np.float32).max:
            raise fault(f"has no {name} of {' x '.join(map(str, shape)) or 1} numbers")
        return array

    width, height = (int(numbers(name, ())) for name in ("width", "height"))
    fx, fy = (float(numbers(name, ())) for name in ("fx", "fy"))
    if not (1 <= width <= SIDE_MAX and 1 <= height <= SIDE_MAX and fx > 0 and fy > 0):
        raise fault(f"has no width and height from 1 to {SIDE_MAX} and focal lengths above 0")
    rotation, centre = numbers("rotation", (3, 3)).T, numbers("position", (3,))
    right = np.abs(rotation).max() < 2 and np.abs(rotation @ rotation.T - np.eye(3)).max() <= ROTATION_TOLERANCE
    if not right or np.linalg.det(rotation) < 0:
        raise fault(f"has a matrix that is not a rotation to {ROTATION_TOLERANCE}")
    name = printable(str(fields.get("img_name", number)), 200)
    return Camera(name, width, height, fx, fy, width / 2, height / 2, rotation, -rotation @ centre)
