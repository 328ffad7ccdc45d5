"""Files that are whole or missing: written beside their places, flushed to the disk, and renamed when all are whole."""

# filelock is imported where it is used, so that help is instant.
# ruff: noqa: PLC0415

from __future__ import annotations

import contextlib
import errno
import io
import os
import re
import shutil
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from types import TracebackType
from typing import BinaryIO

from .lock import BESIDE, errors_of, hold_file, hold_folder

# The folder inside a folder in which exchange() keeps new and old files.
INCOMING = f"{BESIDE}incoming"
_TEMPORARY = re.compile(rf"({re.escape(BESIDE)}[0-9a-f]{{16}})(\.lock)?")
_BUFFER_BYTES = 1 << 20


class _File(io.FileIO):
    """A new file, whose errors name an output. shown: the output."""

    def __init__(self, path: Path, shown: Path) -> None:
        self.shown = shown
        with errors_of(shown):
            super().__init__(path, "x", opener=lambda name, flags: os.open(name, flags, 0o666))

    def write(self, data: object) -> int:
        with errors_of(self.shown):
            return os.write(self.fileno(), data)  # type: ignore[arg-type]


@contextlib.contextmanager
def new_file(path: Path, shown: Path | None = None) -> Iterator[BinaryIO]:
    """Yields a new file to write to, which is on the disk at the end. Raises OSError, also if the path exists.

    shown: the name in errors; None stands for the path.
    """
    raw = _File(path, shown or path)
    file = io.BufferedWriter(raw, _BUFFER_BYTES)
    try:
        yield file
        file.flush()
        with errors_of(raw.shown):
            os.fsync(raw.fileno())
    finally:
        # Closing the buffer would write again what could not be written.
        with contextlib.suppress(OSError):
            raw.close()


def _settle_folder(path: Path) -> None:
    """Flushes the names in a folder to the disk, if the run may open it and the system can. Raises OSError."""
    with contextlib.suppress(PermissionError), errors_of(path), contextlib.ExitStack() as opened:
        descriptor = os.open(path, os.O_RDONLY)
        opened.callback(os.close, descriptor)
        try:
            os.fsync(descriptor)
        except OSError as error:
            if error.errno not in (errno.EINVAL, errno.ENOTSUP, errno.EBADF):
                raise


@contextlib.contextmanager
def folder_beside(folder: Path) -> Iterator[Path]:
    """Yields a new folder in a folder, for files that are not whole yet. At the end it is removed with its contents.

    A process holds a lock on each of its own. Those of killed processes are removed first. Raises OSError.
    """
    _remove_dead(folder)
    path = folder / f"{BESIDE}{os.urandom(8).hex()}"
    with contextlib.ExitStack() as held:
        held.enter_context(hold_file(Path(f"{path}.lock"), wait=True, shown=folder))
        held.callback(shutil.rmtree, path, ignore_errors=True)
        with errors_of(folder):
            path.mkdir()
        yield path


def _remove_dead(folder: Path) -> None:
    """Removes the temporary folders of killed processes. A folder that cannot be listed is left alone."""
    from filelock import FileLock

    with contextlib.suppress(OSError):
        for name in {temporary[1] for entry in os.scandir(folder) if (temporary := _TEMPORARY.fullmatch(entry.name))}:
            with contextlib.suppress(OSError), FileLock(folder / f"{name}.lock", timeout=0):
                shutil.rmtree(folder / name, ignore_errors=True)
                (folder / f"{name}.lock").unlink()


class Stage:
    """Outputs of a run, which get their places together at the end of a `with` block, or never if it fails.

    A link stays, and its target is replaced. A pipe or a device is written to, also at the end.
    """

    def __init__(self, turns: Path | None = None) -> None:
        """turns: a folder, in which runs replace files in turn."""
        self._turns = turns
        # Of each output the temporary file, the place, and the path in messages.
        self._moves: list[tuple[Path, Path, Path]] = []
        self._streams: list[tuple[io.BytesIO, Path]] = []
        # The temporary folder of each folder with outputs.
        self._beside: dict[Path, Path] = {}
        self._files, self._folders = contextlib.ExitStack(), contextlib.ExitStack()
        self._cancelled = False

    def __enter__(self) -> Stage:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with self._folders:
            self._files.__exit__(kind, error, trace)
            if error is None and not self._cancelled:
                with hold_folder(self._turns, wait=True) if self._turns else contextlib.nullcontext():
                    self._commit()

    def open(self, path: Path) -> BinaryIO:
        """Returns a file to write to, which will be at a path. Missing folders are made. Raises OSError."""
        return self._files.enter_context(self._file(path))

    def write(self, path: Path, data: bytes) -> None:
        """Writes the content of a path, and keeps no file open. Missing folders are made. Raises OSError."""
        with self._file(path) as file:
            file.write(data)

    def cancel(self) -> None:
        """Makes the block end without outputs, though it does not fail."""
        self._cancelled = True

    @contextlib.contextmanager
    def _file(self, path: Path) -> Iterator[BinaryIO]:
        if os.path.exists(path) and not os.path.isfile(path) and not os.path.isdir(path):
            self._streams.append((io.BytesIO(), path))
            yield self._streams[-1][0]
            return
        place = Path(os.path.realpath(path))
        if place.parent not in self._beside:
            self._beside[place.parent] = self._folders.enter_context(folder_beside(place.parent))
        temporary = self._beside[place.parent] / place.name
        with new_file(temporary, path) as file:
            yield file
        self._moves.append((temporary, place, path))

    def _commit(self) -> None:
        for stream, path in self._streams:
            with errors_of(path), path.open("wb") as out:
                out.write(stream.getbuffer())
        for temporary, place, path in self._moves:
            with errors_of(path):
                os.replace(temporary, place)
        for folder in dict.fromkeys(above for _, place, _ in self._moves for above in list(place.parents)[:2]):
            _settle_folder(folder)


def write_file(path: Path, data: bytes) -> None:
    """Writes a file, which gets its name when it is whole. Raises OSError."""
    with Stage() as stage:
        stage.write(path, data)


def exchange(path: Path, write: Callable[[Path], None], replaced: Callable[[], Iterable[Path]], last: str) -> None:
    """Replaces the files of one kind in a folder. A missing folder is made. Other entries stay.

    Runs that write to one folder take turns. A run that fails or is interrupted leaves the folder as it was. A run that
    is killed while it renames files leaves a folder without `last`, which the next run replaces.

    Args:
        path: the folder.
        write: writes the new files into the folder that it is given.
        replaced: returns the paths to remove, which may be missing. It is called when no other run writes to the
            folder, and raises an exception if the folder must not be written to.
        last: the name without which the folder does not count as whole. It is removed first and added last.

    Raises:
        OSError: a file cannot be written.
    """
    incoming = path / INCOMING
    new, old = incoming / "new", incoming / "old"
    with hold_folder(path, wait=True), errors_of(path), contextlib.ExitStack() as cleanup:
        gone = [place for place in replaced() if os.path.lexists(place)]
        # A killed run may have left it.
        shutil.rmtree(incoming, ignore_errors=True)
        cleanup.callback(shutil.rmtree, incoming, ignore_errors=True)
        for folder in (incoming, new, old):
            folder.mkdir()
        write(new)
        moves = [(place, old / place.name) for place in sorted(gone, key=lambda p: p.name != last)]
        moves += [(place, path / place.name) for place in sorted(new.iterdir(), key=lambda p: p.name == last)]
        with contextlib.ExitStack() as undo:
            for source, target in moves:
                undo.callback(_move_back, source, target)
                os.rename(source, target)
            undo.pop_all()
        _settle_folder(path)
        _settle_folder(path.parent)


def _move_back(source: Path, target: Path) -> None:
    """Undoes a renaming, which may not have happened."""
    with contextlib.suppress(FileNotFoundError):
        os.rename(target, source)
