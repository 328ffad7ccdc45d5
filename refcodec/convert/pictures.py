"""The pictures of a splat file from which a scene is trained, or by which its Gaussians are coded."""

import os
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..bitstream.batches import Progress
from ..formats.splats import Splats
from ..formats.table import splats_up
from ..photographs.images import parse_background, parse_size
from ..rendering.camera import Camera, level_up
from ..statuses import UsageError
from . import views
from .notes import CAMERAS_FILE, read_cameras, read_cameras_of

F64 = NDArray[np.float64]


def stated_cameras(
    source: Path, file: str | os.PathLike[str] | None, note: Callable[[str], None] = lambda text: None
) -> list[Camera]:
    """Returns the cameras of a cameras.json: the given file, or that of the splat's model; else none.

    3DGS writes it beside its folder point_cloud. One that `export` wrote beside other splats is none. note: receives
    that. Raises UsageError.
    """
    if file is not None:
        cameras = read_cameras(Path(file))
        if not cameras:
            raise UsageError(f"{os.fspath(file)} has no cameras: give a cameras.json of 3DGS, or omit --cameras")
        return cameras
    beside = [source.parent / CAMERAS_FILE]
    if source.parent.parent.name == "point_cloud":
        beside.append(source.parent.parent.parent / CAMERAS_FILE)
    for place in beside:
        cameras, names = read_cameras_of(place)
        if cameras and names and source.name not in names:
            note(f"refcodec: {place} is of {', '.join(names)}: --cameras {place} uses it for {source.name}")
        elif cameras:
            return cameras
    return []


def up_of(source: Path, up: str | None, cameras: Sequence[Camera] = ()) -> F64:
    """Returns the up direction of splats: that of an axis such as +z, of the file, or of their cameras; else -y."""
    return views.AXES[up] if up else splats_up(source, level_up(cameras))


def chosen_cameras(cameras: list[Camera], splats: Splats, up: F64, size: str, count: int) -> dict[str, list[Camera]]:
    """Returns cameras by purpose: a selection of the given ones, or else cameras around and among the splats.

    size: the sides of pictures. Raises UsageError.
    """
    try:
        sides = parse_size(size)
    except ValueError as error:
        raise UsageError(str(error)) from None
    side = max(sides) if isinstance(sides, tuple) else sides
    if cameras:
        return views.given(cameras, count, side)
    return views.generated(splats, up, side or views.SIDE, count, max(count // views.TEST_EVERY, views.JUDGES))


def draw_pictures(
    splats: Splats,
    cameras: list[Camera],
    folder: Path,
    up: F64,
    size: str,
    count: int,
    background: str,
    progress: Progress,
) -> None:
    """Writes the pictures of splats to a folder. Arguments and errors: as for the functions above."""
    try:
        colour = parse_background(background)
    except ValueError as error:
        raise UsageError(str(error)) from None
    chosen = chosen_cameras(cameras, splats, up, size, count)
    views.write_photographs(splats, chosen, folder, progress, colour)


def check_pictures(pictures: Path, output: Path) -> None:
    """Raises UsageError unless pictures can be kept in a new folder outside the scene."""
    if os.path.lexists(pictures):
        raise UsageError(f"{pictures} exists: choose another folder for the pictures")
    place, scene = Path(os.path.realpath(pictures)), Path(os.path.realpath(output))
    if place.is_relative_to(scene) or scene.is_relative_to(place):
        raise UsageError(
            f"{pictures} and {output} are the same folder or nested: choose another folder for the pictures"
        )
