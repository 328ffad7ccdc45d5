"""Files that are whole or not there: written beside their places, flushed to the disk, and moved when all are whole."""

from __future__ import annotations

import contextlib
import errno
import io
import os
import re
import shutil
import stat
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import BinaryIO

from .held import locked, taken

# How the names of folders begin that hold what is not whole yet.
BESIDE = ".refcodec-"
_BESIDE = re.compile(re.escape(BESIDE) + "[0-9a-f]{16}")
_BUFFER_BYTES = 1 << 20


@contextlib.contextmanager
def errors_of(shown: Path, beside: Path | None = None) -> Iterator[None]:
    """Lets an OSError that names no file, or one that is not whole yet, name what people know.

    shown: the output. beside: where it, or what is in it, is until it is whole.
    """
    try:
        yield
    except OSError as error:
        if error.filename is None:
            error.filename = str(shown)
        elif beside is not None and Path(os.fsdecode(error.filename)).is_relative_to(beside):
            error.filename = str(shown / Path(os.fsdecode(error.filename)).relative_to(beside))
        raise


class _Descriptor(io.RawIOBase):
    """A file descriptor to write to. shown: the name of the file in errors, which the system does not give."""

    def __init__(self, descriptor: int, shown: Path) -> None:
        self._descriptor, self.shown = descriptor, shown

    def fileno(self) -> int:
        return self._descriptor

    def writable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def seek(self, offset: int, whence: int = 0, /) -> int:
        return os.lseek(self._descriptor, offset, whence)

    def write(self, data: object) -> int:
        with errors_of(self.shown):
            return os.write(self._descriptor, data)  # type: ignore[arg-type]

    def close(self) -> None:
        if not self.closed:
            super().close()
            os.close(self._descriptor)


def _opened(path: Path, flags: int, shown: Path) -> BinaryIO:
    return io.BufferedWriter(_Descriptor(os.open(path, os.O_WRONLY | flags, 0o666), shown), _BUFFER_BYTES)


def _abandon(file: BinaryIO) -> None:
    """Closes a file without what is not written yet, which would fail again."""
    with contextlib.suppress(OSError, ValueError):
        file.raw.close()  # type: ignore[attr-defined]


@contextlib.contextmanager
def new_file(path: Path) -> Iterator[BinaryIO]:
    """Yields a new file to write to, which is on the disk at the end. Raises OSError, also if something is there."""
    file = _opened(path, os.O_CREAT | os.O_EXCL, path)
    try:
        yield file
        _settle(file)
    finally:
        _abandon(file)


def _settle(file: BinaryIO) -> None:
    file.flush()
    with errors_of(file.raw.shown):  # type: ignore[attr-defined]
        os.fsync(file.fileno())


def settle_folder(path: Path) -> None:
    """Makes names in a folder last. Systems that cannot open or flush folders keep them in their own way."""
    try:
        descriptor = os.open(path, os.O_RDONLY)
    except PermissionError:
        # A folder that may be written to and not read.
        return
    try:
        with errors_of(path):
            os.fsync(descriptor)
    except OSError as error:
        if error.errno not in (errno.EINVAL, errno.ENOTSUP, errno.EBADF):
            raise
    finally:
        os.close(descriptor)


def make_folder(path: Path, made: list[Path]) -> None:
    """Makes a folder, and those that it is in. Raises OSError. made: gets each new one, also if a later one fails."""
    missing = []
    while not path.is_dir():
        if os.path.lexists(path):
            raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR), str(path))
        missing.append(path)
        path = path.parent
    for folder in reversed(missing):
        made.append(folder)
        try:
            os.mkdir(folder)
        except FileExistsError:
            # Another run was faster. Whatever else is there is an error.
            made.pop()
            if not folder.is_dir():
                raise


def remove_folders(made: list[Path]) -> None:
    """Removes the folders of make_folder that are empty."""
    for folder in reversed(made):
        with contextlib.suppress(OSError):
            folder.rmdir()


@contextlib.contextmanager
def folder_beside(folder: Path) -> Iterator[Path]:
    """Yields a new folder in a folder, for what is not whole yet. It is removed at the end, with all that is in it.

    Those of processes that were killed are removed, too. A process holds the lock of its own ones as long as it lives.
    Raises OSError.
    """
    _remove_dead(folder)
    path = folder / f"{BESIDE}{os.urandom(8).hex()}"
    descriptor = None
    try:
        with errors_of(folder, path):
            while descriptor is None:
                # Another process takes it for a dead one's before it is locked, and removes it.
                with contextlib.suppress(FileExistsError):
                    os.mkdir(path)
                descriptor = locked(path, os.O_RDONLY, True)
        yield path
    finally:
        shutil.rmtree(path, ignore_errors=True)
        if descriptor is not None:
            os.close(descriptor)


def _remove_dead(folder: Path) -> None:
    """Removes what killed processes left in a folder."""
    try:
        found = [entry.path for entry in os.scandir(folder) if _BESIDE.fullmatch(entry.name)]
    except OSError:
        # A folder that may be written to and not listed, or none.
        return
    for path in found:
        descriptor = taken(path)
        if descriptor is not None:
            shutil.rmtree(path, ignore_errors=True)
            os.close(descriptor)


class Stage:
    """Outputs of a run, which get their places together at the end of a `with` block, or never if it fails.

    A link stays, and what it leads to is replaced. A pipe or a device is written to, also at the end.
    """

    def __init__(self) -> None:
        # Of each output the file that is written, its path, and its place.
        self._parts: list[tuple[BinaryIO, Path, Path]] = []
        self._streams: list[tuple[io.BytesIO, Path]] = []
        # Where the outputs of a folder are until they are whole.
        self._beside: dict[Path, Path] = {}
        self._folders = contextlib.ExitStack()
        self._made: list[Path] = []
        self._cancelled = False

    def __enter__(self) -> Stage:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        whole = False
        try:
            if error is None and not self._cancelled:
                self._commit()
                whole = True
        finally:
            self._discard(whole)

    def open(self, path: Path) -> BinaryIO:
        """Returns a file to write to, which will be at a path. Folders that it is in are made. Raises OSError."""
        if _is_stream(path):
            stream = io.BytesIO()
            self._streams.append((stream, path))
            return stream
        place = Path(os.path.realpath(path))
        make_folder(place.parent, self._made)
        if place.parent not in self._beside:
            try:
                self._beside[place.parent] = self._folders.enter_context(folder_beside(place.parent))
            except OSError as error:
                error.filename = str(path)
                raise
        beside = self._beside[place.parent] / str(len(self._parts))
        with errors_of(path, beside):
            file = _opened(beside, os.O_CREAT | os.O_EXCL, path)
        self._parts.append((file, beside, place))
        return file

    def write(self, path: Path, data: bytes) -> None:
        """Gives a path its content, which is on the disk at once. Raises OSError."""
        file = self.open(path)
        file.write(data)
        if not isinstance(file, io.BytesIO):
            # A run may have more outputs than it may have open files.
            _settle(file)
            file.close()

    def cancel(self) -> None:
        """Lets the block end without outputs, though it does not fail."""
        self._cancelled = True

    def _commit(self) -> None:
        for file, _, _ in self._parts:
            if not file.closed:
                _settle(file)
                file.close()
        for stream, path in self._streams:
            with contextlib.closing(_opened(path, 0, path)) as out:
                out.write(stream.getbuffer())
        for file, beside, place in self._parts:
            with errors_of(file.raw.shown, beside):  # type: ignore[attr-defined]
                os.replace(beside, place)
        for folder in dict.fromkeys([place.parent for _, _, place in self._parts] + [m.parent for m in self._made]):
            settle_folder(folder)

    def _discard(self, whole: bool) -> None:
        for file, _, _ in self._parts:
            _abandon(file)
        self._folders.close()
        self._beside.clear()
        if not whole:
            remove_folders(self._made)


def _is_stream(path: Path) -> bool:
    try:
        mode = os.stat(path).st_mode
    except OSError:
        return False
    return not (stat.S_ISREG(mode) or stat.S_ISDIR(mode))


def write_file(path: Path, data: bytes) -> None:
    """Writes a file, which gets its name only when it is whole. Raises OSError."""
    with Stage() as stage:
        stage.write(path, data)
