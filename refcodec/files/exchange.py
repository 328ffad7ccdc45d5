"""Puts new files and folders into a folder in place of old ones: all of them, or none."""

from __future__ import annotations

import contextlib
import os
import shutil
from collections.abc import Callable, Iterable
from pathlib import Path

from .lock import hold_folder
from .stage import errors_of, settle_folder

# The folder inside the folder in which new files are written. They are moved out when all of them are whole.
INCOMING = ".c3gs-incoming"


def exchange(path: Path, write: Callable[[Path], None], replaced: Callable[[], Iterable[Path]], last: str) -> None:
    """Replaces what a folder holds of one kind. The folder is made if it is not there. What else is in it stays.

    Runs that write to one folder at once take turns. One that fails, or is interrupted, leaves the folder as it was.
    One that is killed while it moves files leaves a folder without `last`. The next one writes to it all the same.

    Args:
        path: the folder.
        write: writes the new files into the folder that it is given.
        replaced: returns the paths that have to go, of which some need not be there. It is called when no other run
            writes to the folder, and raises what forbids to write there.
        last: the name without which the folder does not count as whole. It goes first, and comes last.

    Raises:
        OSError: a file cannot be written.
    """
    with hold_folder(path, wait=True):
        gone = [place for place in replaced() if os.path.lexists(place)]
        incoming = path / INCOMING
        new, old = incoming / "new", incoming / "old"
        try:
            # What is there is of a run that was killed. Others wait for the lock.
            shutil.rmtree(incoming, ignore_errors=True)
            for folder in (incoming, new, old):
                with errors_of(path, folder):
                    os.mkdir(folder)
            with errors_of(path, new):
                write(new)
            moves = [(place, old / place.name) for place in sorted(gone, key=lambda p: p.name != last)]
            moves += [(place, path / place.name) for place in sorted(new.iterdir(), key=lambda p: p.name == last)]
            with errors_of(path, new):
                _move(moves)
            settle_folder(path)
            settle_folder(path.parent)
        finally:
            shutil.rmtree(incoming, ignore_errors=True)


def _move(moves: Iterable[tuple[Path, Path]]) -> None:
    """Renames files in turn. If one cannot be renamed, the others get their names back."""
    begun: list[tuple[Path, Path]] = []
    try:
        for source, target in moves:
            begun.append((source, target))
            os.rename(source, target)
    except BaseException:
        for source, target in reversed(begun):
            # The one that failed is where it was.
            with contextlib.suppress(FileNotFoundError):
                os.rename(target, source)
        raise
