"""NeRF's transforms.json: cameras in Blender's convention, with or without points.

transform_matrix takes camera to world, and a camera looks along -z with y up: y and z are negated to get COLMAP's.
Pixels are counted as in COLMAP (instant-ngp, nerfstudio). Without cx and cy the principal point is in the middle.
"""

from __future__ import annotations

from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from ..files.documents import DocumentError, read_json
from ..files.ply import names_of, read_ply
from .cameras import (
    F64,
    U8,
    UNDISTORTED,
    Camera,
    Distortion,
    PhotographError,
    Shot,
    check_intrinsics,
    checked_rotation,
    checked_translation,
    there,
)
from .images import image_size

SINGLE, TRAIN, TEST = "transforms.json", "transforms_train.json", "transforms_test.json"
# Suffixes tried in turn after a file_path, which has none in Blender's files.
SUFFIXES = ("", ".png", ".jpg", ".jpeg", ".JPG", ".PNG")
MODELS = ("SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV")
INTRINSICS = ("w", "h", "fl_x", "fl_y", "camera_angle_x", "camera_angle_y", "cx", "cy", "k1", "k2", "p1", "p2")
# Coefficients of models that are not supported.
HIGHER = ("k3", "k4", "k5", "k6")
POINT_FILES = ("points3d.ply", "points3D.ply")
# The number of initial points of 3DGS for NeRF's synthetic scenes.
RANDOM_POINTS = 100_000
# Half the side of the scene's box, as a share of the cameras' distance. It is 1.34 for NeRF's synthetic scenes, where
# 3DGS has 1.3.
BOX_SHARE = 1 / 3
GREY = 128
REPAIR = "write the file again with the program that made it"


def is_transforms(folder: Path) -> bool:
    """Whether a folder has one of NeRF's files."""
    return any(there(folder / name) for name in (SINGLE, TRAIN, TEST))


def read_transforms(folder: Path, seed: int) -> tuple[list[Shot], list[Shot] | None, F64, U8, int, bool]:
    """Reads a folder.

    Returns posed images for training, held-out ones, points [M, 3], colours [M, 3], the number of images without pose,
    and whether the points were drawn at random.

    transforms_train.json and transforms_test.json are a split. With only transforms.json or transforms_train.json,
    there is none, and None is returned for the held-out images. A frame without transform_matrix is an image without
    pose. Points come from the PLY file that ply_file_path names, or from points3d.ply, or else from random_points.
    Raises PhotographError.
    """
    name = SINGLE if there(folder / SINGLE) else TRAIN
    if not there(folder / name):
        raise PhotographError(folder / TRAIN, f"the file is missing, but {TEST} exists", f"give both, or a {SINGLE}")
    document = _document(folder / name)
    shots, skipped = _frames(folder / name, document)
    test = None
    if name == TRAIN and there(folder / TEST):
        test, more = _frames(folder / TEST, _document(folder / TEST))
        skipped += more
    everything = [*shots, *(test or ())]
    if not everything:
        raise PhotographError(folder, "no image has a pose", "give the frames a transform_matrix")
    named = document.get("ply_file_path")
    if named is not None:
        places = [_inside(str(folder / name), folder, "ply_file_path", named)]
    else:
        places = [folder / name for name in POINT_FILES]
    place = next((p for p in places if there(p)), None)
    if place is None and named is not None:
        raise PhotographError(
            places[0], "the point cloud that ply_file_path names is missing", "restore it, or remove ply_file_path"
        )
    points, colours = read_points(place) if place else random_points(folder, [shot.camera for shot in everything], seed)
    return shots, test, points, colours, skipped, place is None


def _document(file: Path) -> dict[str, Any]:
    try:
        document = read_json(file)
    except DocumentError as error:
        raise PhotographError(file, f"it is not JSON ({error})", REPAIR) from None
    if not isinstance(document, dict) or not isinstance(document.get("frames"), list):
        raise PhotographError(file, 'it has no list "frames"', REPAIR)
    return document


def _frames(file: Path, document: dict[str, Any]) -> tuple[list[Shot], int]:
    """Returns the posed images of a file in order of their names, and the number of frames without pose."""
    shots, skipped = [], 0
    names: set[str] = set()
    for index, frame in enumerate(document["frames"]):
        where = f"{file}, frame {index}"
        if not isinstance(frame, dict) or not isinstance(frame.get("file_path"), str):
            raise PhotographError(where, "it has no file_path", REPAIR)
        if frame.get("transform_matrix") is None:
            skipped += 1
            continue
        if frame.get("mask_path", document.get("mask_path")) is not None:
            advice = "remove mask_path, and cut out what should not be seen as transparency of the images"
            raise PhotographError(where, "it has a mask_path, but masks are not supported", advice)
        shot = _shot(where, file.parent, document, frame)
        if shot.camera.name in names:
            raise PhotographError(where, f"two images are named {shot.camera.name!r}", "give each image its own name")
        names.add(shot.camera.name)
        shots.append(shot)
    return sorted(shots, key=lambda s: s.camera.name), skipped


def _inside(where: str, folder: Path, key: str, stated: object) -> Path:
    """Returns the file that a document names. Raises PhotographError for one outside the folder.

    Otherwise an untrusted document could put any picture of this machine into a scene or a page.
    """
    path = PurePosixPath(str(stated))
    if not path.parts or ".." in path.parts or path.is_absolute():
        raise PhotographError(
            where,
            f"the {key} {str(stated)!r:.200} does not name a file in the folder",
            "names are relative to the folder of the document: move it to the folder that has the images",
        )
    return folder / str(stated)


def _shot(where: str, folder: Path, document: dict[str, Any], frame: dict[str, Any]) -> Shot:
    stated = frame["file_path"]
    stem = _inside(where, folder, "file_path", stated)
    # A dangling link is the file that is meant, and it is missing.
    places = [folder / f"{stated}{suffix}" for suffix in SUFFIXES]
    path = next((p for p in places if p.is_file() or (p.is_symlink() and not p.is_dir())), stem)
    # The name of an image is also that of its output file.
    name = "/".join(PurePosixPath(stated).parts)
    # Numbers of a frame override those of the file.
    keys = {**document, **frame}
    fields = {key: _number(where, keys, key) for key in (*INTRINSICS, *HIGHER)}
    size = image_size(path)
    width, height = (_whole(where, key, fields[key], side) for key, side in zip(("w", "h"), size, strict=True))
    distortion = _distortion(where, keys, fields)
    fx, fy = _focal(where, fields, width, height)
    cx, cy = (
        middle if value is None else value for value, middle in ((fields["cx"], width / 2), (fields["cy"], height / 2))
    )
    rotation, translation = _pose(where, frame["transform_matrix"])
    camera = Camera(name, width, height, fx, fy, cx, cy, rotation, translation)
    check_intrinsics(where, camera, distortion)
    return Shot(path, camera, distortion)


def _number(where: str, keys: dict[str, Any], key: str) -> float | None:
    value = keys.get(key)
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise PhotographError(where, f"{key} is {value!r:.60}, but must be a number", REPAIR)
    try:
        return float(value)
    except OverflowError:
        return float("inf")


def _whole(where: str, key: str, value: float | None, default: int) -> int:
    """Returns a side in pixels, which some programs write as 800.0; if missing, that of the image."""
    if value is None:
        return default
    if not (np.isfinite(value) and value == int(value)):
        raise PhotographError(where, f"{key} is {value}, but must be a whole number of pixels", REPAIR)
    return int(value)


def _distortion(where: str, keys: dict[str, Any], fields: dict[str, float | None]) -> Distortion:
    model = keys.get("camera_model", "OPENCV")
    # nerfstudio calls a pinhole camera PERSPECTIVE, too.
    if model not in (*MODELS, "PERSPECTIVE") or keys.get("is_fisheye"):
        model = "fisheye" if model in MODELS else f"{model!s:.60}"
        raise PhotographError(
            where,
            f"the camera model {model} is not supported; the supported models are {', '.join(MODELS)}",
            "undistort the images beforehand",
        )
    higher = [key for key in HIGHER if fields[key]]
    if higher:
        raise PhotographError(
            where,
            f"{higher[0]} is {fields[higher[0]]}: the camera model FULL_OPENCV is not supported; "
            f"the supported models are {', '.join(MODELS)}",
            "undistort the images beforehand",
        )
    k1, k2, p1, p2 = (fields[key] or 0.0 for key in ("k1", "k2", "p1", "p2"))
    return (k1, k2, p1, p2) if any((k1, k2, p1, p2)) else UNDISTORTED


def _focal(where: str, fields: dict[str, float | None], width: int, height: int) -> tuple[float, float]:
    """Returns the focal lengths of fl_x and fl_y, or of the angles of view. A single one is used for both."""
    out: list[float | None] = []
    for axis, side in (("x", width), ("y", height)):
        focal, angle = fields[f"fl_{axis}"], fields[f"camera_angle_{axis}"]
        if focal is None and angle is not None:
            if not 0 < angle < np.pi:
                raise PhotographError(
                    where, f"camera_angle_{axis} is {angle}, but must be in radians, between 0 and pi", REPAIR
                )
            focal = side / 2 / float(np.tan(angle / 2))
        out.append(focal)
    fx, fy = (a if a is not None else b for a, b in (out, out[::-1]))
    if fx is None or fy is None:
        raise PhotographError(
            where, "there is no focal length", "give fl_x and fl_y in pixels, or camera_angle_x in radians"
        )
    return fx, fy


def _pose(where: str, rows: Any) -> tuple[F64, F64]:
    """Returns rotation and translation, world to camera as in COLMAP, of a camera-to-world matrix of 3 or 4 rows."""
    try:
        matrix = np.array(rows, np.float64)
    except (ValueError, TypeError, OverflowError):
        matrix = np.empty(0)
    if matrix.shape not in ((3, 4), (4, 4)):
        raise PhotographError(where, "its transform_matrix is not 4 rows of 4 numbers", REPAIR)
    if len(matrix) == 4 and not np.allclose(matrix[3], (0, 0, 0, 1), atol=1e-6):
        raise PhotographError(where, "the last row of its transform_matrix is not 0 0 0 1", REPAIR)
    rotation = checked_rotation(where, (matrix[:3, :3] * (1, -1, -1)).T)
    return rotation, -rotation @ checked_translation(where, matrix[:3, 3])


def read_points(file: Path) -> tuple[F64, U8]:
    """Returns the vertices of a PLY file: positions float64 [M, 3] and colours uint8 [M, 3], grey if it has none.

    Raises PhotographError.
    """
    advice = "give vertices with x, y, z and, as 8-bit integers, red, green, blue"
    try:
        data = read_ply(file)["vertex"]
        points = np.stack([data[axis].astype(np.float64) for axis in "xyz"], axis=1)
        colours = np.full(points.shape, GREY, np.uint8)
        if "red" in names_of(data):
            columns = [data[name] for name in ("red", "green", "blue")]
            if any(column.dtype != np.uint8 for column in columns):
                raise PhotographError(file, f"its colours are {columns[0].dtype}, but must be uint8", advice)
            colours = np.stack(columns, axis=1)
    except PhotographError:
        raise
    # A missing element or property is a KeyError or a ValueError.
    except (KeyError, ValueError, OSError) as error:
        raise PhotographError(file, f"it is not a readable point cloud ({error})", advice) from None
    if not len(points):
        raise PhotographError(
            file, "there are no points", f"remove the file: {RANDOM_POINTS} points are then drawn at random"
        )
    if not np.isfinite(points).all():
        raise PhotographError(file, "a point is NaN or infinite", advice)
    return points, colours


def random_points(folder: Path, cameras: list[Camera], seed: int) -> tuple[F64, U8]:
    """Returns RANDOM_POINTS uniform grey points in the scene box: positions float64 [M, 3], colours uint8 [M, 3].

    The box is a cube around the point that is nearest to all the cameras' axes (least squares). Half its side is
    BOX_SHARE of the median distance of the cameras from there. It suits cameras around an object. Raises
    PhotographError if the axes do not meet in front of the cameras.
    """
    centres = np.stack([camera.centre for camera in cameras])
    axes = np.stack([camera.rotation[2] for camera in cameras])
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    total = across.sum(axis=0)
    advice = f"give points in {POINT_FILES[0]}, or reconstruct some with COLMAP"
    # The smallest eigenvalue is 0 for parallel axes or one camera, and at most n / 2.
    if np.linalg.eigvalsh(total)[0] < 1e-4 * len(cameras):
        raise PhotographError(
            folder, "there are no points, and the cameras' axes do not meet, so none can be drawn", advice
        )
    middle = np.linalg.solve(total, (across @ centres[:, :, None]).sum(axis=0)[:, 0])
    depth = float(np.median(((middle - centres) * axes).sum(axis=1)))
    if depth <= 0:
        raise PhotographError(
            folder, "there are no points, and the cameras look away from each other, so none can be drawn", advice
        )
    half = BOX_SHARE * float(np.median(np.linalg.norm(middle - centres, axis=1)))
    points = middle + np.random.default_rng(seed).uniform(-half, half, (RANDOM_POINTS, 3))
    return points, np.full(points.shape, GREY, np.uint8)
