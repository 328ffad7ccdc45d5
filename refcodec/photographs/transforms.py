"""NeRF's transforms.json: cameras in Blender's convention, with or without points.

transform_matrix takes camera to world, and a camera looks along -z with y up: y and z are negated to get COLMAP's.
Pixels are counted as in COLMAP (instant-ngp, nerfstudio). Without cx and cy the principal point is in the middle.
"""

from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
from msgspec import Struct

from ..files.documents import DocumentError, FieldError, checked, read_json
from ..files.ply import names_of, read_ply
from .cameras import (
    COEFFICIENTS,
    F64,
    U8,
    Camera,
    Distortion,
    Names,
    PhotographError,
    Shot,
    check_intrinsics,
    check_pose,
    checked_rotation,
    there,
)
from .images import image_size

SINGLE, TRAIN, TEST = "transforms.json", "transforms_train.json", "transforms_test.json"
MODELS = ("SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "FULL_OPENCV")
POINT_FILES = ("points3d.ply", "points3D.ply")
# The number of initial points of 3DGS for NeRF's synthetic scenes.
RANDOM_POINTS = 100_000
# Half the side of the scene's box, as a share of the cameras' distance. It is 1.34 for NeRF's synthetic scenes, where
# 3DGS has 1.3.
BOX_SHARE = 1 / 3
GREY = 128
REPAIR = "write the file again with the program that made it"

Row = tuple[float, float, float, float]


class TransformsFrame(Struct):
    """A frame, with the values of its file where it has none."""

    file_path: str
    transform_matrix: Any = None
    mask_path: str | None = None
    camera_model: Any = "OPENCV"
    is_fisheye: Any = None
    w: float | None = None
    h: float | None = None
    fl_x: float | None = None
    fl_y: float | None = None
    camera_angle_x: float | None = None
    camera_angle_y: float | None = None
    cx: float | None = None
    cy: float | None = None
    k1: float | None = None
    k2: float | None = None
    p1: float | None = None
    p2: float | None = None
    k3: float | None = None
    k4: float | None = None
    k5: float | None = None
    k6: float | None = None


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
        places = [Names(folder).file(folder / name, "ply_file_path", str(named))]
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
    shots, skipped, found = [], 0, Names(file.parent)
    names: set[str] = set()
    shared = {name: value for name, value in document.items() if name != "frames"}
    for index, stated in enumerate(document["frames"]):
        where = f"{file}, frame {index}"
        try:
            # Values of a frame override those of the file.
            frame = checked({**shared, **checked(stated, dict[str, Any])}, TransformsFrame)
        except FieldError as error:
            raise PhotographError(where, str(error), REPAIR) from None
        if frame.transform_matrix is None:
            skipped += 1
            continue
        shot = _shot(where, found, frame)
        if shot.camera.name in names:
            raise PhotographError(where, f"two images are named {shot.camera.name!r}", "give each image its own name")
        names.add(shot.camera.name)
        shots.append(shot)
    return sorted(shots, key=lambda s: s.camera.name), skipped


def _shot(where: str, folder: Names, frame: TransformsFrame) -> Shot:
    path = folder.file(where, "file_path", frame.file_path)
    # The name of an image is also that of its output file.
    name = "/".join(PurePosixPath(frame.file_path.replace("\\", "/")).parts)
    # Some programs write sides as 800.0. Missing ones are those of the image.
    sides = [own if side is None else side for side, own in zip((frame.w, frame.h), image_size(path), strict=True)]
    for key, side in zip("wh", sides, strict=True):
        if side != int(side):
            raise PhotographError(where, f"{key} is {side}, but must be a whole number of pixels", REPAIR)
    width, height = map(int, sides)
    distortion = _distortion(where, frame)
    fx, fy = _focal(where, frame, width, height)
    cx, cy = width / 2 if frame.cx is None else frame.cx, height / 2 if frame.cy is None else frame.cy
    rotation, translation = _pose(where, frame.transform_matrix)
    camera = Camera(name, width, height, fx, fy, cx, cy, rotation, translation)
    check_intrinsics(where, camera, distortion)
    mask = None if frame.mask_path is None else folder.file(where, "mask_path", frame.mask_path)
    return Shot(path, camera, distortion, mask)


def _distortion(where: str, frame: TransformsFrame) -> Distortion:
    model, supported = frame.camera_model, f"is not supported; the supported models are {', '.join(MODELS)}"
    # nerfstudio calls a pinhole camera PERSPECTIVE, too.
    if model not in (*MODELS, "PERSPECTIVE") or frame.is_fisheye:
        model = "fisheye" if model in MODELS else f"{model!s:.60}"
        raise PhotographError(where, f"the camera model {model} {supported}", "undistort the images beforehand")
    return tuple(getattr(frame, name) or 0.0 for name in COEFFICIENTS)


def _focal(where: str, frame: TransformsFrame, width: int, height: int) -> tuple[float, float]:
    """Returns the focal lengths of fl_x and fl_y, or of the angles of view. A single one is used for both."""
    out: list[float | None] = []
    for axis, side in (("x", width), ("y", height)):
        focal, angle = getattr(frame, f"fl_{axis}"), getattr(frame, f"camera_angle_{axis}")
        if focal is None and angle is not None:
            if not 0 < angle < np.pi:
                problem = f"camera_angle_{axis} is {angle}, but must be in radians, between 0 and pi"
                raise PhotographError(where, problem, REPAIR)
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
        matrix = np.array(checked(rows, list[Row]))
    except FieldError:
        matrix = np.empty(0)
    if len(matrix) not in (3, 4):
        raise PhotographError(where, "its transform_matrix is not 4 rows of 4 numbers", REPAIR)
    if len(matrix) == 4 and not np.allclose(matrix[3], (0, 0, 0, 1), atol=1e-6):
        raise PhotographError(where, "the last row of its transform_matrix is not 0 0 0 1", REPAIR)
    rotation, translation = checked_rotation(where, (matrix[:3, :3] * (1, -1, -1)).T), matrix[:3, 3]
    check_pose(where, translation)
    return rotation, -rotation @ translation


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
