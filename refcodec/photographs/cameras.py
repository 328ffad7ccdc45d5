"""Cameras, their checks, and the one error of reading photographs.

Conventions are COLMAP's. A camera looks along +z, with x to the right and y down. A point p of the world is at
rotation @ p + translation in its frame, and at (fx x/z + cx, fy y/z + cy) in its image. Image coordinates are
continuous: the image spans [0, width] x [0, height] and the centre of the top left pixel is at (0.5, 0.5). So resizing
multiplies fx and cx by one factor, fy and cy by another, with no half pixels.
"""

import os
import stat
import unicodedata
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

import numpy as np
from numpy.typing import NDArray

from ..bitstream.cameras import rotation_matrix
from ..files.present import NotAFileError, is_there
from ..rendering.camera import Camera
from ..statuses import UsageError

F64 = NDArray[np.float64]
U8 = NDArray[np.uint8]

# Focal lengths outside this range are mistakes. In units of the longer side.
FOCAL_MIN, FOCAL_MAX = 0.01, 1000.0
# The longest side of an image that Pillow opens.
SIDE_MAX = 1 << 17
# Allowed deviation of rotation @ rotation.T from the identity: files have matrices of four digits or more.
ROTATION_TOLERANCE = 1e-3
ESTIMATE = "estimate the poses again, or remove this image"


class PhotographError(UsageError):
    """Photographs that cannot be used. The message has the place, the fault with what is allowed, and the remedy."""

    where: str
    problem: str
    advice: str

    def __init__(self, where: Path | str, problem: str, advice: str) -> None:
        self.where, self.problem, self.advice = str(where), problem, advice
        super().__init__(f"{where}: {problem}; {advice}")


def there(path: Path, kind: int = stat.S_IFREG) -> bool:
    """Whether an optional file of a data set exists. kind: stat.S_IFDIR for a folder.

    Raises PhotographError if something else is in its place, such as a dangling link.
    """
    try:
        return is_there(path, kind)
    except NotAFileError as error:
        raise PhotographError(path, str(error), "restore it, or remove it") from None


# The coefficients of COLMAP's and OpenCV's FULL_OPENCV model, in normalised image coordinates, by their order.
COEFFICIENTS = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
Distortion = tuple[float, ...]
UNDISTORTED: Distortion = (0.0,) * len(COEFFICIENTS)


@dataclass(frozen=True, eq=False)
class Shot:
    """A posed image of a data set: the file, the camera before undistortion and resizing, its distortion.

    mask: the file of its mask, None if it has none.
    """

    path: Path
    camera: Camera
    distortion: Distortion = UNDISTORTED
    mask: Path | None = None


# The suffixes of images, in the order in which they are tried for a name without one, as Blender's files have.
IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".webp", ".tif", ".tiff", ".bmp")


class Names:
    """Finds the files in a folder that a data set names."""

    def __init__(self, folder: Path) -> None:
        self.folder, self._entries = folder, dict[Path, dict[str, str]]()

    def file(self, where: Path | str, key: str, name: str) -> Path:
        """Returns the file of a name: as stated, or with slashes for backslashes, in another case or form of accents.

        where, key: the place of the name in the data set, and what it is there. Some programs leave out the suffix of
        an image. If there is no such file, returns the path as stated. Raises PhotographError for a name outside the
        folder: otherwise an untrusted document could put any picture of this machine into a scene or a page.
        """
        slashed = PurePosixPath(name.replace("\\", "/"))
        if not slashed.parts or ".." in slashed.parts or slashed.is_absolute():
            problem = f"the {key} {name!r:.200} does not name a file in the folder"
            raise PhotographError(where, problem, f"names are relative to {self.folder}: change them")
        stated = self.folder / name
        # A dangling link is the file that is meant, and it is missing.
        if stated.is_file() or (stated.is_symlink() and not stated.is_dir()):
            return stated
        folder = self._below(self.folder, slashed.parts[:-1])
        places = (self._below(folder, (slashed.name + suffix,)) for suffix in ("", *IMAGE_SUFFIXES))
        return next((place for place in places if place.is_file()), stated)

    def _below(self, place: Path, parts: Iterable[str]) -> Path:
        for part in parts:
            if place not in self._entries:
                names = sorted(os.listdir(place)) if place.is_dir() else []
                self._entries[place] = {_folded(entry): entry for entry in names} | {entry: entry for entry in names}
            entries = self._entries[place]
            place /= entries.get(part) or entries.get(_folded(part), part)
        return place


def _folded(name: str) -> str:
    return unicodedata.normalize("NFC", unicodedata.normalize("NFC", name).casefold())


def check_intrinsics(where: Path | str, camera: Camera, distortion: Distortion) -> None:
    """Raises PhotographError for an impossible size, focal length, principal point or distortion."""
    width, height, advice = camera.width, camera.height, "correct the camera's intrinsics"
    if not (1 <= width <= SIDE_MAX and 1 <= height <= SIDE_MAX):
        problem = f"the image has {width} x {height} pixels; each side must be 1 to {SIDE_MAX}"
        raise PhotographError(where, problem, "correct the camera's size")
    low, high = FOCAL_MIN * max(width, height), FOCAL_MAX * max(width, height)
    for name, focal in (("fx", camera.fx), ("fy", camera.fy)):
        # Written so that NaN fails.
        if not low <= focal <= high:
            problem = f"the focal length {name} is {focal} pixels; for {width} x {height} it must be"
            raise PhotographError(where, f"{problem} {low:g} to {high:g}", advice)
    for name, value in zip(("cx", "cy", *COEFFICIENTS), (camera.cx, camera.cy, *distortion), strict=True):
        if not np.isfinite(value):
            raise PhotographError(where, f"{name} is {value}, but must be a finite number", advice)
    if not (-width <= camera.cx <= 2 * width and -height <= camera.cy <= 2 * height):
        problem = f"the principal point ({camera.cx:g}, {camera.cy:g}) is outside the image of {width} x {height}"
        raise PhotographError(where, f"{problem} by more than the size of the image", advice)


def check_pose(where: Path | str, *numbers: F64) -> None:
    """Raises PhotographError for NaN and infinity."""
    if not all(np.isfinite(values).all() for values in numbers):
        raise PhotographError(where, "the pose has a NaN or an infinite number", ESTIMATE)


def checked_rotation(where: Path | str, matrix: F64) -> F64:
    """Returns the rotation nearest to a [3, 3] matrix. Raises PhotographError beyond ROTATION_TOLERANCE."""
    check_pose(where, matrix)
    with np.errstate(over="ignore", invalid="ignore"):
        # Written so that NaN fails: squares of large numbers are infinite.
        right = np.abs(matrix @ matrix.T - np.eye(3)).max() <= ROTATION_TOLERANCE
        lengths = ", ".join(f"{v:.4g}" for v in np.linalg.norm(matrix, axis=1))
        determinant = np.linalg.det(matrix)
    if not right or not determinant > 0:
        problem = f"the pose's matrix is not a rotation (rows of length {lengths}, determinant {determinant:.4g})"
        raise PhotographError(where, problem, "give poses without scale, shear or mirroring")
    u, _, v = np.linalg.svd(matrix)
    return np.asarray(u @ v, np.float64)


def quaternion_rotation(where: Path | str, quaternion: F64) -> F64:
    """Returns the rotation [3, 3] of a quaternion w, x, y, z of any length. Raises PhotographError for 0, NaN, inf."""
    check_pose(where, quaternion)
    # Scaled first, so that neither huge nor tiny components leave float64's range when they are squared.
    largest = np.abs(quaternion).max()
    if largest == 0:
        raise PhotographError(where, "the pose's quaternion is 0 0 0 0", ESTIMATE)
    return rotation_matrix(quaternion / largest / np.linalg.norm(quaternion / largest))
