"""Files that are whole or not there: written beside their places, flushed to the disk, and moved when all are whole."""

from __future__ import annotations

import contextlib
import errno
import io
import os
import stat
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import BinaryIO

# How the names of files begin that are not whole yet.
BESIDE = ".refcodec-"
_BUFFER_BYTES = 1 << 20


class _Descriptor(io.RawIOBase):
    """A file descriptor to write to."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor

    def fileno(self) -> int:
        return self._descriptor

    def writable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def seek(self, offset: int, whence: int = 0, /) -> int:
        return os.lseek(self._descriptor, offset, whence)

    def write(self, data: object) -> int:
        return os.write(self._descriptor, data)  # type: ignore[arg-type]

    def close(self) -> None:
        if not self.closed:
            super().close()
            os.close(self._descriptor)


def _opened(path: Path, flags: int) -> BinaryIO:
    return io.BufferedWriter(_Descriptor(os.open(path, os.O_WRONLY | flags, 0o666)), _BUFFER_BYTES)


def _abandon(file: BinaryIO) -> None:
    """Closes a file without what is not written yet, which would fail again."""
    with contextlib.suppress(OSError, ValueError):
        file.raw.close()  # type: ignore[attr-defined]


@contextlib.contextmanager
def new_file(path: Path) -> Iterator[BinaryIO]:
    """Yields a new file to write to, which is on the disk at the end. Raises OSError, also if something is there."""
    file = _opened(path, os.O_CREAT | os.O_EXCL)
    try:
        yield file
        _settle(file)
    finally:
        _abandon(file)


def _settle(file: BinaryIO) -> None:
    file.flush()
    os.fsync(file.fileno())


def settle_folder(path: Path) -> None:
    """Makes names in a folder last. Systems that cannot open or flush folders keep them in their own way."""
    try:
        descriptor = os.open(path, os.O_RDONLY)
    except PermissionError:
        # A folder that may be written to and not read.
        return
    try:
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


class Stage:
    """Outputs of a run, which get their places together at the end of a `with` block, or never if it fails.

    A link stays, and what it leads to is replaced. A pipe or a device is written to, also at the end.
    """

    def __init__(self) -> None:
        # Of each output the file that is written, its path, and its place.
        self._parts: list[tuple[BinaryIO, Path, Path]] = []
        self._streams: list[tuple[io.BytesIO, Path]] = []
        self._begun: list[Path] = []
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
        beside = place.parent / f"{BESIDE}{os.urandom(8).hex()}"
        self._begun.append(beside)
        file = _opened(beside, os.O_CREAT | os.O_EXCL)
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
            with contextlib.closing(_opened(path, 0)) as out:
                out.write(stream.getbuffer())
        for _, beside, place in self._parts:
            os.replace(beside, place)
        for folder in dict.fromkeys([place.parent for _, _, place in self._parts] + [m.parent for m in self._made]):
            settle_folder(folder)

    def _discard(self, whole: bool) -> None:
        for file, _, _ in self._parts:
            _abandon(file)
        for beside in self._begun:
            with contextlib.suppress(OSError):
                beside.unlink()
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
