"""Folders of posed photographs, from COLMAP or in NeRF's format, as cameras, images and points.

Nothing here needs a GPU, torch or pickle. Whatever a folder holds, the outcome is a PhotographSet or one
PhotographError.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from .cameras import F64, U8, UNDISTORTED, Camera, PhotographError, Shot
from .colmap import find_model, read_colmap
from .images import Size, image_size, parse_background, parse_size, read_image, same_aspect, shrink, wanted_size
from .lens import undistorted_camera, undistorted_image
from .transforms import is_transforms, read_transforms

__all__ = [
    "Camera",
    "Photograph",
    "PhotographError",
    "PhotographSet",
    "parse_background",
    "parse_size",
    "read_photographs",
]

# Every eighth image is for tests, the usual hold-out of real scenes.
TEST_EVERY = 8
Colour = tuple[int, int, int]

# What transparent photographs are laid over: white in NeRF's datasets, black in others, as in 3DGS.
WHITE, BLACK = (255, 255, 255), (0, 0, 0)


@dataclass(frozen=True, eq=False)
class Photograph:
    """A camera and what it saw.

    load: reads the image over a background, 0 to 255 each. background: what it is laid over, if it is transparent.
    path: of its file.
    """

    camera: Camera
    load: Callable[[Colour], U8]
    background: Colour
    path: Path

    @cached_property
    def image(self) -> U8:
        """uint8 [H, W, 3], RGB, of the camera's size; kept once it is loaded. Raises PhotographError."""
        return self.load(self.background)

    def empty(self) -> NDArray[np.bool_]:
        """The pixels that are wholly transparent, bool [H, W]: each background is seen through them as it is.

        Raises PhotographError.
        """
        white, black = (self.image if self.background == over else self.load(over) for over in (WHITE, BLACK))
        return ((white == 255) & (black == 0)).all(axis=2)


@dataclass(frozen=True, eq=False)
class PhotographSet:
    """Photographs to learn from and to test with, each in the order of their names, and the points of the scene.

    points: float64 [M, 3], world units. colours: uint8 [M, 3], RGB. skipped: images without pose that were left out.
    background: what transparent images were laid over. random: whether the points were drawn at random.
    """

    train: tuple[Photograph, ...]
    test: tuple[Photograph, ...]
    points: F64
    colours: U8
    skipped: int
    background: Colour
    random: bool = False

    @property
    def pixels(self) -> int:
        """Pixels of all photographs to learn from."""
        return sum(p.camera.width * p.camera.height for p in self.train)

    def places(self) -> list[Path]:
        """Returns the image files, and the folders that they are in."""
        files = [photograph.path for photograph in (*self.train, *self.test)]
        return [*files, *dict.fromkeys(file.parent for file in files)]


def read_photographs(
    folder: str | Path,
    size: Size = None,
    background: Colour | None = None,
    seed: int = 0,
    holdout: int = TEST_EVERY,
) -> PhotographSet:
    """The photographs of a COLMAP or NeRF folder; where it is both, COLMAP's, which has points.

    size: (width, height) or the longest side in pixels that images are averaged down to, None for their own.
    background: what transparent images are laid over, 0 to 255, None for white in NeRF's format and black in COLMAP's.
    seed: of points that are drawn where the folder has none (transforms.random_points). holdout: every how many images
    one is for tests, 0 for none.

    Images with index % holdout == 0 by name are for tests, unless the folder has a split of its own. The headers of all
    images are read here. Their pixels are read when they are asked for, and what is wrong in those is raised then.
    Raises PhotographError.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise PhotographError(
            folder, "there is no such folder", "give a folder with COLMAP's or NeRF's cameras and their images"
        )
    try:
        random = False
        if model := find_model(folder):
            shots, points, colours, skipped = read_colmap(folder, model, size)
            test_shots = None
        elif is_transforms(folder):
            shots, test_shots, points, colours, skipped, random = read_transforms(folder, seed)
        else:
            raise PhotographError(
                folder,
                "there are no cameras: neither sparse/0/cameras.bin or .txt (COLMAP) nor transforms.json or "
                "transforms_train.json (NeRF)",
                "give the folder that has them, or run COLMAP",
            )
        if test_shots is None:
            test_shots = shots[::holdout] if holdout else []
            shots = [shot for index, shot in enumerate(shots) if not holdout or index % holdout]
        if not shots:
            raise PhotographError(
                folder, f"no image is left to learn from, {len(test_shots)} are for tests", "give two images or more"
            )
        over = background or (BLACK if model else WHITE)
        train, test = _photographs(shots, size, over), _photographs(test_shots, size, over)
    except OSError as error:
        raise PhotographError(
            error.filename or folder, f"it cannot be read ({error.strerror})", "check the file and its permissions"
        ) from None
    return PhotographSet(train, test, points, colours, skipped, over, random)


def _photographs(shots: Iterable[Shot], size: Size, background: Colour) -> tuple[Photograph, ...]:
    return tuple(_photograph(shot, size, background) for shot in shots)


def _photograph(shot: Shot, size: Size, background: Colour) -> Photograph:
    """The pinhole camera of the wanted size, and how its image is made from the file. Raises PhotographError."""
    stated = shot.camera
    width, height = image_size(shot.path)
    if not same_aspect(width, height, stated.width, stated.height):
        turned = same_aspect(height, width, stated.width, stated.height)
        raise PhotographError(
            shot.path,
            f"the image has {width} x {height} pixels, its camera {stated.width} x {stated.height}: "
            "not the same shape within a pixel",
            "the file was turned after its pose was estimated: restore it as it was"
            if turned
            else "restore the image that the camera was estimated from, or a version of it in another size",
        )
    photographed = stated.resized(width, height)
    camera = (
        photographed if shot.distortion == UNDISTORTED else undistorted_camera(shot.path, photographed, shot.distortion)
    )
    camera = camera.resized(*wanted_size(shot.path, width, height, size))
    return Photograph(camera, partial(_load, shot, photographed, camera), background, shot.path)


def _load(shot: Shot, photographed: Camera, camera: Camera, background: Colour) -> U8:
    image = read_image(shot.path, background)
    if image.shape != (photographed.height, photographed.width, 3):
        raise PhotographError(shot.path, "its size has changed since its header was read", "read the folder again")
    if shot.distortion == UNDISTORTED:
        return shrink(image, camera.width, camera.height)
    return undistorted_image(image, photographed, shot.distortion, camera)
