"""COLMAP's sparse models, text and binary, and their image folders.

pycolmap 4.2.1 is not used: it takes 135 MB, accepts a truncated cameras.bin silently, and does not return from a
points3D.bin that states 2^60 points. Formats: https://colmap.github.io/format.html
"""

import contextlib
import re
import stat
import struct
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from .cameras import (
    F64,
    IMAGE_SUFFIXES,
    U8,
    UNDISTORTED,
    Camera,
    Distortion,
    Names,
    PhotographError,
    Shot,
    check_intrinsics,
    check_pose,
    quaternion_rotation,
    there,
)
from .images import Size, image_size

# The supported models, with the mapping of their parameters to fx, fy, cx, cy and the first COEFFICIENTS.
MODELS: dict[str, tuple[int, Callable[..., tuple[tuple[float, float, float, float], Distortion]]]] = {
    "SIMPLE_PINHOLE": (3, lambda f, cx, cy: ((f, f, cx, cy), ())),
    "PINHOLE": (4, lambda fx, fy, cx, cy: ((fx, fy, cx, cy), ())),
    "SIMPLE_RADIAL": (4, lambda f, cx, cy, k: ((f, f, cx, cy), (k,))),
    "RADIAL": (5, lambda f, cx, cy, k1, k2: ((f, f, cx, cy), (k1, k2))),
    "OPENCV": (8, lambda fx, fy, cx, cy, k1, k2, p1, p2: ((fx, fy, cx, cy), (k1, k2, p1, p2))),
    "FULL_OPENCV": (
        12,
        lambda fx, fy, cx, cy, k1, k2, p1, p2, k3, k4, k5, k6: ((fx, fy, cx, cy), (k1, k2, p1, p2, k3, k4, k5, k6)),
    ),
}
# Binary files number the models. Names of unsupported models are for the message.
MODEL_IDS = (
    *("SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "OPENCV_FISHEYE", "FULL_OPENCV", "FOV"),
    *("SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE", "THIN_PRISM_FISHEYE", "RAD_TAN_THIN_PRISM_FISHEYE"),
    *("SIMPLE_DIVISION", "DIVISION", "SIMPLE_FISHEYE", "FISHEYE", "EUCM", "EQUIRECTANGULAR"),
)
PARTS = ("cameras", "images", "points3D")
MASKS = "masks"
# Smallest records of the binary files, in bytes: counts are compared with the rest of the file.
CAMERA_HEAD, IMAGE_HEAD, POINT_HEAD = struct.Struct("<IiQQ"), struct.Struct("<I7dI"), struct.Struct("<Q3d3BdQ")
SMALLEST = {"cameras": CAMERA_HEAD.size, "images": IMAGE_HEAD.size + 1 + 8, "points3D": POINT_HEAD.size}
# A line of images.txt has all 2D points of an image.
LINE_MAX = 1 << 26
RERUN = "the file is damaged or incomplete: export the model again (colmap model_converter)"
# The rows of cameras: cameras without names and poses, and their distortions, by number.
_Lenses = dict[int, tuple[Camera, Distortion]]


@dataclass(frozen=True, eq=False)
class _Pose:
    """A row of images: its camera, its name, quaternion w, x, y, z [4] and translation [3], from world to camera."""

    where: str
    camera: int
    name: str
    quaternion: F64
    translation: F64


def find_models(folder: Path) -> list[tuple[int, Path]]:
    """Returns the COLMAP models of a folder, each with its number of images: the one of most images first.

    They are sparse/0, sparse/1 and so on, or else the first of sparse and the folder that has the files of a model.
    """
    numbered = sorted((p for p in folder.glob("sparse/*") if p.name.isdecimal()), key=lambda p: int(p.name))
    places = [
        place
        for place in (*numbered, folder / "sparse", folder)
        if any(there(place / f"{part}{suffix}") for part in PARTS for suffix in (".bin", ".txt"))
    ]
    several = [place for place in places if place in numbered] or places[:1]
    # The only one is counted when it is read.
    counts = [_image_count(place) if len(several) > 1 else 0 for place in several]
    return sorted(zip(counts, several, strict=True), key=lambda model: -model[0])


def _image_count(model: Path) -> int:
    """Returns the number of images that a model states, 0 if that cannot be read."""
    with contextlib.suppress(PhotographError, OSError, struct.error):
        if (file := model / "images.bin").is_file():
            with file.open("rb") as opened:
                return int(struct.unpack("<Q", opened.read(8))[0])
        return len(_text_images(model / "images.txt"))
    return 0


def read_colmap(folder: Path, model: Path, size: Size) -> tuple[list[Shot], F64, U8, int]:
    """Returns posed images in order of names, points [M, 3], colours [M, 3], and the number of images without pose.

    folder: the data set. model: one of find_models. Images are in folder/images, or in images_2, images_4 and so
    on, the smallest of these with enough pixels for the size. The mask of NAME.jpg is folder/masks/NAME.jpg.png or
    NAME.png. Raises PhotographError.
    """
    suffix = ".bin" if any(there(model / f"{part}.bin") for part in PARTS) else ".txt"
    files = [model / f"{part}{suffix}" for part in PARTS]
    for file in files:
        if not there(file):
            advice = f"a model is {', '.join(f.name for f in files)} together: export it again (colmap model_converter)"
            raise PhotographError(file, "the file is missing", advice)
    binary, (cameras_file, images_file, points_file) = suffix == ".bin", files
    lenses = (_binary_cameras if binary else _text_cameras)(cameras_file)
    poses = (_binary_images if binary else _text_images)(images_file)
    points, colours = read_points(points_file)
    if not poses:
        raise PhotographError(images_file, "no image has a pose", "reconstruct again until images are registered")
    if not len(points):
        raise PhotographError(points_file, "there are no points", "triangulate some (colmap point_triangulator)")
    shots = [_shot(cameras_file, pose, lenses) for pose in sorted(poses, key=lambda p: p.name)]
    names = {shot.camera.name for shot in shots}
    if len(names) < len(shots):
        twice = next(a.camera.name for a, b in pairwise(shots) if a.camera.name == b.camera.name)
        advice = "names must differ: export the model again"
        raise PhotographError(images_file, f"two images are named {twice!r}", advice)
    found = Names(_image_folder(folder, shots, size))
    shots = [replace(shot, path=found.file(images_file, "name", shot.camera.name)) for shot in shots]
    missing = [shot.path for shot in shots if not shot.path.is_file()]
    if missing:
        problem = f"the image is missing ({len(missing)} of the {len(shots)} images with a pose are missing)"
        raise PhotographError(missing[0], problem, "restore it, or remove its pose from the model")
    if (folder / MASKS).is_dir():
        find = partial(Names(folder / MASKS).file, images_file, "name")
        tried = [map(find, (s.camera.name, str(PurePosixPath(s.camera.name).with_suffix("")))) for s in shots]
        shots = [replace(s, mask=next(filter(Path.is_file, f), None)) for s, f in zip(shots, tried, strict=True)]
    pictures = {p for p in found.folder.rglob("*") if p.suffix.lower() in IMAGE_SUFFIXES and p.is_file()}
    return shots, points, colours, len(pictures - {shot.path for shot in shots})


def read_points(file: Path) -> tuple[F64, U8]:
    """Returns the points of a points3D.txt or points3D.bin: positions float64 [M, 3] and colours uint8 [M, 3].

    Raises PhotographError, and OSError.
    """
    return _text_points(file) if file.suffix == ".txt" else _binary_points(file)


def _shot(cameras: Path, pose: _Pose, lenses: _Lenses) -> Shot:
    if pose.camera not in lenses:
        raise PhotographError(pose.where, f"camera {pose.camera} is not in {cameras.name}", "export the model again")
    rotation = quaternion_rotation(pose.where, pose.quaternion)
    check_pose(pose.where, pose.translation)
    camera, distortion = lenses[pose.camera]
    # The name of an image is also that of its output file.
    name = pose.name.replace("\\", "/")
    camera = replace(camera, name=name, rotation=rotation, translation=pose.translation)
    return Shot(Path(), camera, distortion)


def _image_folder(folder: Path, shots: list[Shot], size: Size) -> Path:
    """Returns images, images_2, images_4, ...: the smallest whose first image has enough pixels for the size."""
    reduced = {
        int(m[1]): p
        for p in folder.glob("images_*")
        if (m := re.fullmatch(r"images_([1-9][0-9]{0,3})", p.name)) and there(p, stat.S_IFDIR)
    }
    folders = [p for p in (folder / "images", *(reduced[n] for n in sorted(reduced))) if there(p, stat.S_IFDIR)]
    if not folders:
        raise PhotographError(
            folder / "images", "there is no image folder", "put the images into images/ (or images_2/, images_4/, ...)"
        )
    if size is not None:
        for place in reversed(folders[1:]):
            if there(first := Names(place).file(place, "name", shots[0].camera.name)):
                width, height = image_size(first)
                if max(width, height) >= size if isinstance(size, int) else (width >= size[0] and height >= size[1]):
                    return place
    return folders[0]


def _add_lens(
    out: _Lenses, where: str, identifier: int, model: str, width: int, height: int, parameters: Sequence[float]
) -> None:
    count, make = MODELS[model]
    if len(parameters) != count:
        raise PhotographError(where, f"it has {len(parameters)} parameters, but {model} has {count}", RERUN)
    intrinsics, stated = make(*parameters)
    distortion = (*stated, *UNDISTORTED[len(stated) :])
    camera = Camera("", width, height, *intrinsics, np.eye(3), np.zeros(3))
    check_intrinsics(where, camera, distortion)
    if identifier in out:
        raise PhotographError(where, f"camera {identifier} is defined twice", RERUN)
    out[identifier] = camera, distortion


def _supported(where: str, model: str) -> None:
    if model not in MODELS:
        problem = f"the camera model {model} is not supported; the supported models are {', '.join(MODELS)}"
        raise PhotographError(where, problem, "undistort the images beforehand (colmap image_undistorter)")


def _cloud(file: Path, rows: list[tuple[float, ...]]) -> tuple[F64, U8]:
    """Returns rows of x, y, z, red, green, blue as float64 [M, 3] and uint8 [M, 3]."""
    table = np.array(rows, np.float64).reshape(-1, 6)
    # Points that are NaN or infinite are left out later (far_points).
    if ((table[:, 3:] < 0) | (table[:, 3:] > 255)).any():
        raise PhotographError(file, "a colour is outside 0 to 255", RERUN)
    return table[:, :3].copy(), table[:, 3:].astype(np.uint8)


# --- text -------------------------------------------------------------------------------------------------------------


def _lines(file: Path) -> Iterator[tuple[str, str]]:
    """Yields the place and the text of every line that is not a comment."""
    try:
        with file.open(encoding="utf-8") as text:
            for number, line in enumerate(iter(lambda: text.readline(LINE_MAX), ""), 1):
                if len(line) == LINE_MAX:
                    raise PhotographError(f"{file}, line {number}", f"it has more than {LINE_MAX} characters", RERUN)
                if not line.startswith("#"):
                    yield f"{file}, line {number}", line.strip()
    except UnicodeDecodeError:
        raise PhotographError(file, "it is not text in UTF-8", RERUN) from None


@contextlib.contextmanager
def _numbers(where: str, form: str) -> Iterator[None]:
    """Turns the exceptions of conversions and unpacking for a bad line into PhotographError."""
    try:
        yield
    except PhotographError:
        raise
    except (ValueError, OverflowError) as error:
        raise PhotographError(where, f"the line is not of the form {form} ({error})", RERUN) from None


def _text_cameras(file: Path) -> _Lenses:
    out: _Lenses = {}
    for where, line in _lines(file):
        if not line:
            continue
        with _numbers(where, "CAMERA_ID MODEL WIDTH HEIGHT PARAMETERS"):
            identifier, model, width, height, *parameters = line.split()
            _supported(where, model)
            _add_lens(out, where, int(identifier), model, int(width), int(height), [float(p) for p in parameters])
    return out


def _text_images(file: Path) -> list[_Pose]:
    out: list[_Pose] = []
    lines = _lines(file)
    for where, line in lines:
        if not line:
            continue
        with _numbers(where, "IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME"):
            # A name may have spaces.
            identifier, *pose, camera, name = line.split(maxsplit=9)
            int(identifier)
            w, x, y, z, a, b, c = (float(p) for p in pose)
            out.append(_Pose(where, int(camera), name, np.array([w, x, y, z]), np.array([a, b, c])))
        # The line after it holds its 2D points, three numbers each, or nothing. They are not used here, but if the
        # line were missing, every second image would be lost silently.
        below, points = next(lines, (where, ""))
        if len(points.split()) % 3:
            problem = "the line after an image must hold its 2D points as X Y POINT3D_ID"
            raise PhotographError(below, problem, "give every image a second line, which may be empty")
    return out


def _text_points(file: Path) -> tuple[F64, U8]:
    rows: list[tuple[float, ...]] = []
    for where, line in _lines(file):
        if not line:
            continue
        with _numbers(where, "POINT3D_ID X Y Z R G B ERROR TRACK"):
            _, x, y, z, r, g, b, _, *track = line.split()
            if len(track) % 2:
                raise ValueError("a track has two numbers for each image")
            rows.append((float(x), float(y), float(z), float(int(r)), float(int(g)), float(int(b))))
    return _cloud(file, rows)


# --- binary -----------------------------------------------------------------------------------------------------------


class _Bytes:
    """A binary file, read in order. Nothing is allocated for a count that the file cannot hold."""

    def __init__(self, file: Path) -> None:
        self.file, self.data, self.at = file, file.read_bytes(), 0

    def fault(self, problem: str) -> PhotographError:
        return PhotographError(self.file, problem, RERUN)

    def need(self, size: int, what: str) -> None:
        if size > len(self.data) - self.at:
            raise self.fault(f"it ends inside {what}, at byte {len(self.data)}")

    def take(self, form: struct.Struct, what: str) -> tuple[Any, ...]:
        self.need(form.size, what)
        values = form.unpack_from(self.data, self.at)
        self.at += form.size
        return values

    def skip(self, size: int, what: str) -> None:
        self.need(size, what)
        self.at += size

    def name(self, what: str) -> str:
        end = self.data.find(b"\0", self.at)
        if end < 0:
            raise self.fault(f"it ends inside {what}, at byte {len(self.data)}")
        raw, self.at = self.data[self.at : end], end + 1
        try:
            return raw.decode()
        except UnicodeDecodeError:
            raise self.fault(f"the name in {what} is not UTF-8") from None

    def records(self, part: str) -> Iterator[str]:
        """Yields a description of each record, which the caller then reads. Checks the count, and the end."""
        (count,) = self.take(struct.Struct("<Q"), "the count")
        most = (len(self.data) - self.at) // SMALLEST[part]
        if count > most:
            raise self.fault(f"it states {count} {part}, its {len(self.data)} bytes hold at most {most}")
        for index in range(count):
            yield f"record {index} of {count}"
        if self.at != len(self.data):
            raise self.fault(f"{len(self.data) - self.at} bytes follow its {count} {part}")


def _binary_cameras(file: Path) -> _Lenses:
    out: _Lenses = {}
    data = _Bytes(file)
    for what in data.records("cameras"):
        identifier, model_id, width, height = data.take(CAMERA_HEAD, what)
        where = f"{file}, {what}"
        model = MODEL_IDS[model_id] if 0 <= model_id < len(MODEL_IDS) else f"number {model_id}"
        _supported(where, model)
        parameters = data.take(struct.Struct(f"<{MODELS[model][0]}d"), what)
        _add_lens(out, where, identifier, model, width, height, parameters)
    return out


def _binary_images(file: Path) -> list[_Pose]:
    out: list[_Pose] = []
    data = _Bytes(file)
    for what in data.records("images"):
        _, *pose, camera = data.take(IMAGE_HEAD, what)
        name = data.name(what)
        (points,) = data.take(struct.Struct("<Q"), what)
        # X, Y, POINT3D_ID.
        data.skip(24 * points, what)
        out.append(_Pose(f"{file}, {what}", camera, name, np.array(pose[:4]), np.array(pose[4:])))
    return out


def _binary_points(file: Path) -> tuple[F64, U8]:
    rows: list[tuple[float, ...]] = []
    data = _Bytes(file)
    for what in data.records("points3D"):
        _, *row, _, track = data.take(POINT_HEAD, what)
        # IMAGE_ID, POINT2D_IDX.
        data.skip(8 * track, what)
        rows.append(tuple(row))
    return _cloud(file, rows)
