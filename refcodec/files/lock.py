"""Locks between processes, of the places that they write to."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

from .held import locked
from .stage import make_folder, remove_folders


@contextlib.contextmanager
def hold_folder(folder: Path, wait: bool = False) -> Iterator[None]:
    """Holds the lock of a folder, which is made if it is not there, and removed if it was made and is empty at the end.

    Args:
        folder: the folder.
        wait: whether to wait for a run that holds it.

    Raises:
        UsageError: another run holds it, and is not waited for.
        OSError: the folder cannot be made.
    """
    made: list[Path] = []
    descriptor = None
    try:
        while descriptor is None:
            make_folder(folder, made)
            descriptor = locked(folder, os.O_RDONLY, wait)
        yield
    finally:
        # Under the lock, so that no run finds the folder and then loses it.
        remove_folders(made)
        if descriptor is not None:
            os.close(descriptor)


@contextlib.contextmanager
def hold_file(path: Path) -> Iterator[None]:
    """Holds the lock of a file that is there only as long. Folders that it is in are made, and removed as hold_folder.

    Raises UsageError if another run holds it, and OSError if it cannot be made.
    """
    made: list[Path] = []
    descriptor = None
    try:
        make_folder(path.parent, made)
        while descriptor is None:
            descriptor = locked(path, os.O_RDWR | os.O_CREAT, False)
        yield
    finally:
        if descriptor is not None:
            with contextlib.suppress(OSError):
                path.unlink()
            os.close(descriptor)
        remove_folders(made)
