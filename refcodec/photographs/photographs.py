"""Folders of posed photographs, from COLMAP or in NeRF's format, as cameras, images and points.

Nothing here needs a GPU, torch or pickle. Whatever a folder holds, the outcome is a PhotographSet or one
PhotographError.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from math import inf
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..files.text import counted
from ..folder.georeference import far_offset
from ..rendering.camera import moved
from .cameras import F64, U8, UNDISTORTED, Camera, PhotographError, Shot
from .colmap import MASKS, find_models, read_colmap
from .images import (
    Size,
    image_size,
    is_transparent,
    parse_background,
    parse_size,
    read_image,
    same_aspect,
    shrink,
    wanted_size,
)
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

# Every eighth image is held out, as usual for real scenes.
TEST_EVERY = 8
Colour = tuple[int, int, int]

# The background: white if a pixel is transparent, as in 3DGS for NeRF's synthetic scenes.
WHITE, BLACK = (255, 255, 255), (0, 0, 0)
# Points are outliers beyond so many times the size of the scene: the median distance of the cameras from their middle,
# or the distance from there of this share of the points, if that is more. So a sky of many points is none.
OUTLYING, BULK = 100, 0.95
# The longest side of a camera is at most so many times that of its image, whose shape could otherwise be any.
LEAST = 16


@dataclass(frozen=True, eq=False)
class Photograph:
    """A camera and its photograph.

    load: reads the image, blended over a background, 0 to 255 each. background: the one for transparent pixels. path:
    of the file. mask_path, load_mask: the file of the mask, and what reads it, None if there is none.
    """

    camera: Camera
    load: Callable[[Colour], U8]
    background: Colour
    path: Path
    mask_path: Path | None = None
    load_mask: Callable[[], NDArray[np.bool_]] | None = None

    @cached_property
    def image(self) -> U8:
        """The image, uint8 [H, W, 3], RGB, of the size of the camera. It is cached. Raises PhotographError."""
        return self.load(self.background)

    @cached_property
    def mask(self) -> NDArray[np.bool_] | None:
        """Whether each pixel counts, bool [H, W]; None without a mask. It is cached. Raises PhotographError."""
        return self.load_mask() if self.load_mask else None

    def empty(self) -> NDArray[np.bool_]:
        """Whether each pixel is fully transparent, bool [H, W]. Raises PhotographError."""
        white, black = (self.image if self.background == over else self.load(over) for over in (WHITE, BLACK))
        return ((white == 255) & (black == 0)).all(axis=2)


@dataclass(frozen=True, eq=False)
class PhotographSet:
    """Photographs for training and held-out ones, both in order of their names, and the points of the scene.

    points: float64 [M, 3], world units. colours: uint8 [M, 3], RGB. skipped: number of images without pose.
    background: that of transparent images. opaque: whether nothing is known behind the images: none is transparent, and
    no background was stated. random: whether the points were drawn at random. notes: what was chosen, ignored or left
    out.
    """

    train: tuple[Photograph, ...]
    test: tuple[Photograph, ...]
    points: F64
    colours: U8
    skipped: int
    background: Colour
    opaque: bool = False
    random: bool = False
    notes: tuple[str, ...] = ()

    @property
    def centres(self) -> F64:
        """The places of all cameras, float64 [n, 3], world units."""
        return np.array([p.camera.centre for p in (*self.train, *self.test)])

    def offset(self) -> F64:
        """Returns what to subtract from all places so that float32 can hold them, float64 [3] (far_offset)."""
        return far_offset(np.concatenate([self.centres, self.points]))

    def moved(self, offset: F64) -> PhotographSet:
        """Returns the photographs at places from which an offset is subtracted, float64 [3]."""
        if not offset.any():
            return self
        pairs = [zip(some, moved([p.camera for p in some], offset), strict=True) for some in (self.train, self.test)]
        train, test = (tuple(replace(p, camera=camera) for p, camera in pair) for pair in pairs)
        return replace(self, train=train, test=test, points=self.points - offset)

    def over(self, background: Colour) -> PhotographSet:
        """Returns the photographs over another background."""
        train, test = (tuple(replace(p, background=background) for p in some) for some in (self.train, self.test))
        return replace(self, train=train, test=test, background=background)

    @property
    def pixels(self) -> int:
        """The number of pixels of all training photographs."""
        return sum(p.camera.width * p.camera.height for p in self.train)

    def places(self) -> list[Path]:
        """Returns the image files and their folders."""
        files = [path for p in (*self.train, *self.test) for path in (p.path, p.mask_path) if path]
        return [*files, *dict.fromkeys(file.parent for file in files)]


def read_photographs(
    folder: str | Path, size: Size = None, background: Colour | None = None, seed: int = 0, holdout: int = TEST_EVERY
) -> PhotographSet:
    """Reads the photographs of a COLMAP or NeRF folder. If it is both, COLMAP is used, because it has points.

    size: (width, height) or the longest side in pixels to which images are averaged down, None for their own.
    background: that of transparent images, 0 to 255, None for white if one is transparent, and else the mean colour of
    the points. seed: for random points if the folder has none (transforms.random_points). holdout: the period of
    held-out images, 0 for none. Of several COLMAP models, that of the most images is read. Points far from all others
    are left out.

    Images with index % holdout == 0 by name are held out, unless the folder has its own split. The headers of all
    images are read here, their pixels on request, with errors raised then. Raises PhotographError.
    """
    folder = Path(folder)
    if not folder.is_dir():
        fault = "the folder is a file" if folder.exists() else "the folder does not exist"
        raise PhotographError(folder, fault, "give a folder with COLMAP's or NeRF's cameras and their images")
    try:
        random, notes = False, []
        if models := find_models(folder):
            shots, points, colours, skipped = read_colmap(folder, models[0][1], size)
            for count, other in models[1:]:
                notes.append(f"{other} with {count} images is not used: {models[0][1]} has {models[0][0]}")
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
                folder, f"no image is left for training: {len(test_shots)} are held out", "give two images or more"
            )
        opaque = background is None and not any(is_transparent(shot.path) for shot in (*shots, *test_shots))
        mean: Colour = tuple(np.rint(colours.mean(axis=0)).astype(int).tolist()) if len(colours) else BLACK
        over = background or (mean if opaque else WHITE)
        notes += _unused(folder, [*shots, *test_shots], size)
        train, test = (tuple(_photograph(shot, size, over) for shot in some) for some in (shots, test_shots))
    except OSError as error:
        raise PhotographError(
            error.filename or folder, f"it cannot be read ({error.strerror})", "check the file and its permissions"
        ) from None
    made = PhotographSet(train, test, points, colours, skipped, over, opaque, random)
    near, more = far_points(points, made.centres)
    if not near.any():
        raise PhotographError(folder, f"{more[0]}, and none is left", "estimate the points and the poses again")
    return replace(made, points=points[near], colours=colours[near], notes=(*notes, *more))


def _unused(folder: Path, shots: list[Shot], size: Size) -> Iterator[str]:
    """Yields notes on missing masks, and on images that are smaller than the others, compared with their cameras."""
    bare = [shot.camera.name for shot in shots if not shot.mask]
    if bare and (len(bare) < len(shots) or (folder / MASKS).is_dir()):
        where = f"{MASKS}/{bare[0]}.png beside a COLMAP model, or mask_path of a frame of transforms.json"
        yield f"{counted(len(bare), 'photograph')} of {len(shots)} without a mask ({where}): all of their pixels count"
    sides = [max(image_size(shot.path)) for shot in shots]
    shares = [side / max(shot.camera.width, shot.camera.height) for side, shot in zip(sides, shots, strict=True)]
    needed = inf if size is None else size if isinstance(size, int) else max(size)
    if small := [i for i, side in enumerate(sides) if side < needed and shares[i] < 0.9 * max(shares)]:
        what = f"{counted(len(small), 'image')} of {len(shots)} smaller than the others for the size of their cameras"
        yield f"{what}, such as {shots[small[0]].path}: they blur the scene, restore or remove them"


def far_points(points: F64, centres: F64) -> tuple[NDArray[np.bool_], list[str]]:
    """Returns whether points [M, 3] belong to a scene with cameras at centres [n, 3], bool [M], and a note if not all.

    Reconstructions have a few points that are far from all others, or NaN or infinite. They would decide the extent of
    the scene.
    """
    if not len(points):
        return np.ones(0, bool), []
    with np.errstate(over="ignore", invalid="ignore"):
        middle = np.median(centres, axis=0)
        away, around = (np.nan_to_num(np.linalg.norm(p - middle, axis=1), nan=inf) for p in (points, centres))
        size = max(float(np.median(around)), float(np.quantile(away, BULK, method="lower")))
    finite = np.isfinite(away)
    near = finite & ((away <= OUTLYING * size) | (size == 0))
    why = [] if finite.all() else ["NaN or infinite"]
    if (far := away[finite & ~near]).size:
        why.append(f"up to {far.max():.3g} units away: more than {OUTLYING} times the size of the scene")
    text = f"{counted(int((~near).sum()), 'point')} of {len(points)} left out, {' or '.join(why)}"
    return near, [text] if why else []


def excluded(photographs: Sequence[Photograph]) -> dict[str, Any]:
    """Returns excluded, the share of pixels that masks exclude, and masks, a text on it. Raises PhotographError."""
    masks = [p.mask for p in photographs if p.mask is not None]
    share = sum(int((~m).sum()) for m in masks) / sum(p.camera.width * p.camera.height for p in photographs)
    text = f"masks: {counted(len(masks), 'photograph')}, {100 * share:.3g} % of pixels are excluded"
    return {"excluded": share, "masks": text if masks else ""}


def _photograph(shot: Shot, size: Size, background: Colour) -> Photograph:
    """Returns the pinhole camera of the given size, and the function that makes its image. Raises PhotographError."""
    stated = shot.camera
    width, height = image_size(shot.path)
    large = LEAST * max(width, height) >= max(stated.width, stated.height)
    if not (large and same_aspect(width, height, stated.width, stated.height)):
        turned = large and same_aspect(height, width, stated.width, stated.height)
        raise PhotographError(
            shot.path,
            f"the image has {width} x {height} pixels, its camera {stated.width} x {stated.height}: "
            f"not the same shape within a pixel, or less than 1/{LEAST}",
            "the file was rotated after its pose was estimated: restore it as it was"
            if turned
            else f"restore the image that the camera was estimated from, or one at least 1/{LEAST} of its size",
        )
    camera = stated.resized(width, height)
    if shot.distortion != UNDISTORTED:
        camera = undistorted_camera(shot.path, camera, shot.distortion)
    camera = camera.resized(*wanted_size(shot.path, width, height, size))
    load = partial(_load, shot, (height, width, 3), camera)
    load_mask = partial(_load_mask, shot, shot.mask, camera) if shot.mask else None
    return Photograph(camera, load, background, shot.path, shot.mask, load_mask)


def _load(shot: Shot, shape: tuple[int, ...], camera: Camera, background: Colour) -> U8:
    image = read_image(shot.path, background)
    if image.shape != shape:
        raise PhotographError(shot.path, "its size has changed since the folder was read", "read the folder again")
    return _seen(image, shot, camera)


def _load_mask(shot: Shot, mask: Path, camera: Camera) -> NDArray[np.bool_]:
    """As Photograph.mask: a pixel counts if all of it does. Black does not, as in COLMAP and nerfstudio."""
    used = read_image(mask, BLACK).any(axis=2, keepdims=True)
    counts = _seen(np.repeat(used * np.uint8(255), 3, axis=2), shot, camera)[..., 0] == 255
    same = same_aspect(used.shape[1], used.shape[0], shot.camera.width, shot.camera.height)
    if not (same and counts.any()):
        problem = "black, which is excluded, is everywhere" if same else f"it has not the shape of {shot.path}"
        raise PhotographError(mask, f"the mask cannot be used: {problem}", "make it again, or remove the photograph")
    return np.asarray(counts)


def _seen(image: U8, shot: Shot, camera: Camera) -> U8:
    """Returns the photograph or mask [H, W, 3] of a shot as `camera` would have taken it."""
    if shot.distortion == UNDISTORTED:
        return shrink(image, camera.width, camera.height)
    photographed = shot.camera.resized(image.shape[1], image.shape[0])
    return undistorted_image(image, photographed, shot.distortion, camera)
