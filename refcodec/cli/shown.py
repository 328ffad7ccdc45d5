"""The scene that render and eval draw, and its photographs as in its training."""

# Modules that need NumPy are imported where they are used, so that help is instant.
# ruff: noqa: PLC0415

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..files.documents import DocumentError, read_json
from ..files.present import NotAFileError, is_there
from ..statuses import UsageError
from .bounds import check_folder, read_bounded
from .shared import check_scene_folder, read_photographs_of, uncompressed_of

if TYPE_CHECKING:
    from ..bitstream.cameras import NamedCamera
    from ..bitstream.header import RenderInfo
    from ..bitstream.scene import Scene
    from ..folder.uncompressed import Uncompressed
    from ..photographs.photographs import PhotographSet


def read_shown(arguments: argparse.Namespace) -> bytes | Scene | Uncompressed:
    """Returns the bytes of the command's file, or the scene of its folder.

    Raises BitstreamError for a file whose container is rejected, UsageError and SceneFolderError.
    """
    from ..bitstream.codec import parse_container
    from ..folder.read import read_folder

    path = Path(arguments.file)
    if path.is_dir():
        check_folder(arguments, path)
        check_scene_folder(path)
        return uncompressed_of(arguments.file) or read_folder(path)
    data = read_bounded(arguments)
    parse_container(data)
    return data


def render_info(shown: bytes | Scene | Uncompressed) -> RenderInfo:
    """Returns the render information (SPEC 6.5) of the result of read_shown."""
    from ..bitstream.codec import parse_container

    return parse_container(shown).render if isinstance(shown, bytes) else shown.render


def camera_of(shown: bytes | Scene | Uncompressed) -> NamedCamera:
    """Returns the default view of the result of read_shown: at the world origin for a file without cameras."""
    from ..bitstream.cameras import NamedCamera, cameras
    from ..bitstream.codec import parse_ancillary
    from ..rendering.view import default_view

    if isinstance(shown, bytes):
        return next(iter(cameras(parse_ancillary(shown))), NamedCamera())
    return default_view(shown)


def photographs_as_trained(
    arguments: argparse.Namespace, folder: str, render: RenderInfo, camera: NamedCamera
) -> tuple[PhotographSet, list[str]]:
    """Returns the photographs of a folder as in the training of the scene, unless options override it.

    training.json of a scene folder states the size and the held-out photographs. Otherwise the size is that of the
    scene's camera, and every eighth photograph is held out. Also returns messages on values that are assumed: the size,
    and for a command with --holdout the compared photographs. Raises UsageError.
    """
    from ..folder.layout import REPORT_FILE
    from ..photographs.photographs import TEST_EVERY

    path = Path(arguments.file) / REPORT_FILE
    trained = _trained(path)
    size, notes = arguments.size, []
    if size is None:
        size = trained.get("size") or str(max(camera.width, camera.height))
        source = str(path) if "size" in trained else "the camera of the scene"
        notes.append(f"photographs are scaled to size {size}, as in {source}; --size full uses them unscaled")
    background = getattr(arguments, "background", None) or ",".join(map(str, render.background))
    holdout = getattr(arguments, "holdout", None)
    holdout = trained.get("holdout") if holdout is None else holdout
    if holdout is None and "holdout" in arguments:
        notes.append(
            f"the test set of the data set, or every {TEST_EVERY}th photograph, is compared, because {arguments.file} "
            "does not state which ones training held out; --holdout N compares every N-th one, or all with 0"
        )
    return read_photographs_of(folder, size, background, holdout), notes


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
