"""Whether an optional file exists, is missing, or is something else; and the bytes of a large file."""

import errno
import io
import mmap
import os
import stat
from pathlib import Path
from typing import Any

_KINDS = {
    stat.S_IFDIR: "a directory",
    stat.S_IFIFO: "a pipe",
    stat.S_IFSOCK: "a socket",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
}


class NotAFileError(ValueError):
    """Something other than a file has its path. The text states what, without the path."""


def is_there(path: Path, kind: int = stat.S_IFREG) -> bool:
    """Whether a file exists. False means that nothing has its path, not even a dangling link, a pipe or a folder.

    Args:
        path: the path of an optional file.
        kind: stat.S_IFDIR for a folder instead of a file.

    Raises:
        NotAFileError: something else has the path.
        OSError: the status is not available.
    """
    wanted = "file" if kind == stat.S_IFREG else "directory"
    try:
        mode = os.stat(path).st_mode
    except (FileNotFoundError, NotADirectoryError):
        if path.is_symlink():
            raise NotAFileError(f"it is a link that leads nowhere, not a {wanted}") from None
        return False
    except OSError as error:
        if error.errno == errno.ELOOP:
            raise NotAFileError(f"it is a link in a circle, not a {wanted}") from None
        raise
    actual = stat.S_IFMT(mode)
    if actual != kind:
        raise NotAFileError(f"it is {_KINDS.get(actual, 'a file')}, not a {wanted}")
    return True


class BytesFile(io.RawIOBase):
    """A file of bytes, or of those of a mapped file. They are not copied."""

    def __init__(self, data: mmap.mmap | bytes, place: int = 0) -> None:
        """place: of the first byte that is read."""
        self._data, self._place = memoryview(data), place

    def readable(self) -> bool:
        """As for any file."""
        return True

    def seekable(self) -> bool:
        """As for any file."""
        return True

    def readinto(self, buffer: Any, /) -> int:
        """As for any file."""
        part = self._data[self._place : self._place + len(buffer)]
        buffer[: len(part)] = part
        self._place += len(part)
        return len(part)

    def seek(self, offset: int, whence: int = io.SEEK_SET, /) -> int:
        """As for any file. Raises ValueError for a place before the first byte."""
        place = offset + (0, self._place, len(self._data))[whence]
        if place < 0:
            raise ValueError(f"a negative place, {place}")
        self._place = place
        return place


def mapped(path: Path) -> mmap.mmap | bytes:
    """Returns the bytes of a file, which are read when they are used. Raises OSError."""
    with path.open("rb") as file:
        return mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) if os.fstat(file.fileno()).st_size else b""
