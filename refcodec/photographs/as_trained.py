"""Photographs as texts describe them, and as in the training of a scene, by its training.json."""

import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..bitstream.cameras import NamedCamera
from ..files.documents import DocumentError, read_json
from ..files.present import NotAFileError, is_there
from ..folder.layout import REPORT_FILE
from ..rendering.camera import default_camera
from ..statuses import UsageError
from .photographs import TEST_EVERY, PhotographSet, parse_background, parse_size, read_photographs


def stated_photographs(
    folder: str | os.PathLike[str], size: str, background: str = "auto", holdout: int | None = None
) -> PhotographSet:
    """Returns the photographs of a folder. holdout: None for every eighth image. Raises UsageError."""
    try:
        sides, colour = parse_size(size), parse_background(background)
    except ValueError as error:
        raise UsageError(str(error)) from None
    return read_photographs(os.fspath(folder), sides, colour, holdout=TEST_EVERY if holdout is None else holdout)


def trained_photographs(
    folder: str | os.PathLike[str],
    scene: Path | None,
    camera: NamedCamera,
    words: dict[str, Any],
    offset: NDArray[np.float64],
    compared: str = "",
) -> tuple[PhotographSet, list[str]]:
    """Returns the photographs of a folder as in the training of a scene, and messages on values that are assumed.

    Args:
        folder: of the photographs.
        scene: the scene folder, whose training.json states the size and the held-out photographs. None for a file:
            the size is that of its camera then, and every eighth photograph is held out.
        camera: the default view of the scene.
        words: `size`, `background` and `holdout`, which override these. None stands for no such value.
        offset: what the scene states to be subtracted from the places of its world, float64 [3].
        compared: the name of the scene, if the held-out photographs matter.

    Raises:
        UsageError: the photographs or the report cannot be used.
    """
    trained = {} if scene is None else _trained(scene / REPORT_FILE)
    size, holdout, notes = words.get("size"), words.get("holdout"), []
    if size is None:
        size = trained.get("size") or str(max(camera.width, camera.height))
        source = str(Path(scene or "", REPORT_FILE)) if "size" in trained else "the camera of the scene"
        notes.append(f"photographs are scaled to size {size}, as in {source}; --size full uses them unscaled")
    holdout = trained.get("holdout") if holdout is None else holdout
    if holdout is None and compared:
        notes.append(
            f"the test set of the data set, or every {TEST_EVERY}th photograph, is compared, because {compared} "
            "does not state which ones training held out; --holdout N compares every N-th one, or all with 0"
        )
    photographs = stated_photographs(folder, size, words["background"], holdout)
    return photographs.moved(scene_offset(photographs, camera, offset)), [*notes, *photographs.notes]


def scene_offset(photographs: PhotographSet, camera: NamedCamera, offset: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns what to subtract from the places of photographs to get those of a scene, float64 [3].

    camera: the default view of the scene, which is near the photographs. offset: the stated one, zeros for none: that
    of the photographs then, if any (PhotographSet.offset).
    """
    offset = offset if offset.any() else photographs.offset()
    away = np.median(photographs.centres, axis=0) - default_camera(camera).centre
    return offset if np.linalg.norm(away - offset) < np.linalg.norm(away) else np.zeros(3)


def _trained(path: Path) -> dict[str, Any]:
    """Returns `size` and `holdout` of the settings of a training, where present. Raises UsageError."""
    try:
        if not is_there(path):
            return {}
        report = read_json(path)
        settings = {key: report["settings"][key] for key in ("size", "holdout") if key in report["settings"]}
        size, holdout = settings.get("size", ""), settings.get("holdout", 0)
        if isinstance(size, str) and isinstance(holdout, int) and not isinstance(holdout, bool) and holdout >= 0:
            return settings
        problem = "its size or holdout is invalid"
    except (DocumentError, NotAFileError) as error:
        problem = str(error)
    except (KeyError, TypeError):
        problem = "it has no settings"
    except OSError as error:
        problem = error.strerror or str(error)
    raise UsageError(f"{path} is not a training report ({problem}): remove it, and give --size")
