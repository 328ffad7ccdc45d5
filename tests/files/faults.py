"""Makes the calls fail by which a program changes files, one after another."""

from __future__ import annotations

import builtins
import io
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

_WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT


class Faults:
    """Counts the calls that open a file for writing, write, flush, rename, or make a folder, below one folder.

    points: what was called on what, in order. One of them can be made to fail.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = os.path.realpath(folder)
        self.points: list[str] = []
        self._at = -1
        self._error: Callable[[], BaseException] = RuntimeError
        self._descriptors: dict[int, str] = {}

    def _inside(self, place: Any) -> bool:
        if isinstance(place, int):
            return place in self._descriptors
        folder, name = os.path.split(os.path.abspath(os.fsdecode(place)))
        return f"{os.path.realpath(folder)}/{name}/".startswith(f"{self.folder}/")

    def _point(self, name: str, place: Any) -> None:
        if not self._inside(place):
            return
        shown = self._descriptors[place] if isinstance(place, int) else os.fsdecode(place)
        self.points.append(f"{name} {Path(shown).name}")
        if len(self.points) - 1 == self._at:
            error = self._error()
            if isinstance(error, OSError):
                # As the system's: a descriptor has no name.
                error.filename = None if isinstance(place, int) else shown
            raise error

    @contextmanager
    def watching(self, at: int = -1, error: Callable[[], BaseException] = RuntimeError) -> Iterator[list[str]]:
        """Yields the points as they come. at: the number of the one that fails, or -1. error: makes what it raises."""
        self.points, self._at, self._error = [], at, error
        self._descriptors.clear()
        with pytest.MonkeyPatch.context() as patch:
            for name in ("mkdir", "rename", "replace", "link", "symlink", "chmod", "truncate", "write", "fsync"):
                patch.setattr(os, name, self._failing(name, getattr(os, name)))
            patch.setattr(os, "open", self._open(os.open))
            patch.setattr(os, "close", self._close(os.close))
            for module in (builtins, io):
                patch.setattr(module, "open", self._python_open(io.open))
            yield self.points

    def _failing(self, name: str, real: Callable[..., Any]) -> Callable[..., Any]:
        def call(place: Any, *arguments: Any, **options: Any) -> Any:
            # A folder that exists is no fault.
            if name != "mkdir" or not os.path.isdir(place):
                self._point(name, place)
            return real(place, *arguments, **options)

        return call

    def _open(self, real: Callable[..., int]) -> Callable[..., int]:
        def call(path: Any, flags: int, *arguments: Any, **options: Any) -> int:
            if options.get("dir_fd") is not None:
                return real(path, flags, *arguments, **options)
            if flags & _WRITING:
                self._point("open", path)
            descriptor = real(path, flags, *arguments, **options)
            if self._inside(path):
                self._descriptors[descriptor] = os.fsdecode(path)
            return descriptor

        return call

    def _close(self, real: Callable[[int], None]) -> Callable[[int], None]:
        def call(descriptor: int) -> None:
            self._descriptors.pop(descriptor, None)
            real(descriptor)

        return call

    def _python_open(self, real: Callable[..., Any]) -> Callable[..., Any]:
        def call(file: Any, mode: str = "r", *arguments: Any, **options: Any) -> Any:
            if set(mode) & set("wax+") and not isinstance(file, int):
                self._point("open", file)
            return real(file, mode, *arguments, **options)

        return call
