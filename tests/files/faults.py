"""Makes the calls fail by which a program changes files, one after another."""

import builtins
import io
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

_WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT
_NAMELESS = os.O_TMPFILE
_CALLS = ("rename", "replace", "link", "symlink", "chmod", "truncate", "write", "fsync")


class Faults:
    """Counts the calls that open a file for writing, write, flush, rename, or make a folder, below one folder.

    points: the name and the object of each call, in order. One of them can be made to fail.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = os.path.realpath(folder)
        self.points: list[str] = []

    @contextmanager
    def watching(self, at: int = -1, error: Callable[[], BaseException] = RuntimeError) -> Iterator[list[str]]:
        """Yields the points as they come. at: the number of the one that fails, or -1. error: makes its exception."""
        self.points = []

        def point(name: str, place: Any) -> None:
            numbered = isinstance(place, int)
            path = os.readlink(f"/proc/self/fd/{place}") if numbered else os.path.abspath(os.fsdecode(place))
            folder, last = os.path.split(path)
            if not f"{os.path.realpath(folder)}/{last}/".startswith(f"{self.folder}/"):
                return
            self.points.append(f"{name} {last}")
            if len(self.points) - 1 == at:
                raised = error()
                if isinstance(raised, OSError):
                    # As the system's: a descriptor has no name.
                    raised.filename = None if numbered else path
                raise raised

        def failing(name: str, real: Callable[..., Any], changes: Callable[..., Any]) -> Callable[..., Any]:
            def call(place: Any, *arguments: Any, **options: Any) -> Any:
                if changes(place, *arguments, **options):
                    point(name, place)
                return real(place, *arguments, **options)

            return call

        def creates(path: Any, flags: int, *_: Any, dir_fd: int | None = None) -> bool:
            # filelock 4.3 asks a file system for its locks by a file without a name, and goes on if it cannot have one.
            return dir_fd is None and bool(flags & _WRITING) and flags & _NAMELESS != _NAMELESS

        def opens(file: Any, mode: str = "r", *_: Any, **__: Any) -> bool:
            return bool(set(mode) & set("wax+")) and not isinstance(file, int)

        with pytest.MonkeyPatch.context() as patch:
            for name in _CALLS:
                patch.setattr(os, name, failing(name, getattr(os, name), lambda *_, **__: True))
            patch.setattr(os, "mkdir", failing("mkdir", os.mkdir, lambda path, *_: not os.path.isdir(path)))
            patch.setattr(os, "open", failing("open", os.open, creates))
            for module in (builtins, io):
                patch.setattr(module, "open", failing("open", io.open, opens))
            yield self.points
