"""Puts a scene into a folder in place of the scene before."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

from ..files.stage import exchange
from .layout import SCENE_FILE, SceneFolderError, is_free, scene_files


def replace_scene(path: Path, write: Callable[[Path], None]) -> None:
    """Replaces the scene of a folder as a whole (files.stage.exchange). The folder is made if it is not there.

    Args:
        path: the folder.
        write: writes the new files into the folder that it is given.

    Raises:
        SceneFolderError: the path is of a file, or of a folder with something else in it.
        OSError: a file cannot be written.
    """

    def replaced() -> list[Path]:
        if not is_free(path, uncompressed=True):
            raise SceneFolderError(
                path, "it exists and is not a scene folder", "choose another folder, or empty this one"
            )
        files = scene_files(path)
        for file in files:
            if file.is_dir() and not file.is_symlink():
                raise SceneFolderError(file, "it is a directory", "move it, or choose another folder")
        return files

    if os.path.lexists(path) and not path.is_dir():
        replaced()
    exchange(path, write, replaced, SCENE_FILE)
