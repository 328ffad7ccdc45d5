"""The bytes of a file: in memory, as they arrive, or by ranges (SPEC.md 10.2)."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Protocol

from .errors import BitstreamError


def pad4(length: int) -> int:
    """SPEC 5: returns a length rounded up to a multiple of four."""
    return -(-length // 4) * 4


def padded(content: bytes) -> bytes:
    """SPEC 5: returns some bytes followed by their padding."""
    return content + bytes(pad4(len(content)) - len(content))


@dataclass(frozen=True)
class Piece:
    """Some bytes of a file. start: the offset of the first one in the file."""

    data: bytes
    start: int

    def __len__(self) -> int:
        return len(self.data)

    def cut(self, first: int, end: int) -> Piece:
        """Returns the bytes `first` to `end` - 1, counted from the start of the piece."""
        return Piece(self.data[first:end], self.start + first)

    def error(self, name: str, at: int, path: str, found: object, allowed: object) -> BitstreamError:
        """Returns the error `name` at byte `at` of the piece. The other arguments are as in BitstreamError."""
        return BitstreamError(name, self.start + at, path, found, allowed)

    def require_zero(self, name: str, first: int, end: int, path: str) -> None:
        """Raises the error `name` at byte `first` unless the padding, bytes `first` to `end` - 1, is zero."""
        if any(self.data[first:end]):
            raise self.error(name, first, f"{path}, padding", self.data[first:end].hex(" "), "zeros")


class Source(Protocol):
    """The source of a file's bytes."""

    def read(self, start: int, size: int) -> bytes:
        """Returns `size` bytes from `start`, or fewer if the file ends before."""
        ...

    def length(self) -> int:
        """Returns the length of the file. A decoder asks for it only after `read` returned too few bytes."""
        ...


class Readable(Protocol):
    """A file object that is open for reading in binary mode."""

    def read(self, size: int, /) -> bytes:
        """Returns at least one of the next `size` bytes, or none at the end of the file."""
        ...


class SeekableFile(Readable, Protocol):
    """A file object that can be read at any offset."""

    def seek(self, offset: int, whence: int = 0, /) -> int:
        """Moves to an offset from the start, or from the end if `whence` is 2. Returns the position."""
        ...


StrPath = str | os.PathLike[str]
# What names or holds a file: a path, a URL, its bytes, or a file object.
Place = StrPath | bytes | bytearray | memoryview | Readable


class WholeFile:
    """A file in memory."""

    def __init__(self, data: bytes) -> None:
        self._data = data

    def read(self, start: int, size: int) -> bytes:
        return self._data[start : start + size]

    def length(self) -> int:
        return len(self._data)


def read_up_to(file: Readable, size: int) -> bytes:
    """Returns `size` bytes of a file from its position, or fewer if it ends before. Raises OSError."""
    data = file.read(size)
    # A read of a socket or a raw file may return fewer bytes than it could.
    while len(data) < size and (more := file.read(size - len(data))):
        data += more
    return data


class StoredFile:
    """A file on a disk, of which only the requested bytes are read."""

    def __init__(self, file: SeekableFile) -> None:
        """file: opened for reading in binary mode, and seekable."""
        self._file = file
        self._length = file.seek(0, 2)

    def read(self, start: int, size: int) -> bytes:
        """As Source.read. Raises OSError."""
        # A read allocates memory for all its bytes first, and the size is untrusted.
        size = min(size, self._length - start)
        if size <= 0:
            return b""
        self._file.seek(start)
        return read_up_to(self._file, size)

    def length(self) -> int:
        """As Source.length: the length when the file was opened."""
        return self._length


class Arriving:
    """A file whose bytes arrive in blocks, such as those of a response. It is read from start to end.

    Only the requested bytes, and the rest of the last block after them, are held.
    """

    def __init__(self, blocks: Iterable[bytes]) -> None:
        self._blocks = iter(blocks)
        self._held = bytearray()
        self._start = 0

    def read(self, start: int, size: int) -> bytes:
        """As Source.read. Raises ValueError for bytes before those of the last read."""
        if start < self._start:
            raise ValueError(f"byte {start} was passed; reading is at byte {self._start}")
        while self._start + len(self._held) < start + size:
            block = next(self._blocks, None)
            if block is None:
                break
            self._held += block
            self._pass(start)
        self._pass(start)
        data = bytes(self._held[:size])
        self._pass(start + len(data))
        return data

    def _pass(self, to: int) -> None:
        passed = min(to - self._start, len(self._held))
        del self._held[:passed]
        self._start += passed

    def length(self) -> int:
        """As Source.length. Reads to the end of the file."""
        while True:
            self._pass(self._start + len(self._held))
            block = next(self._blocks, None)
            if block is None:
                return self._start
            self._held += block


class Ranges:
    """A file that is fetched by byte ranges, for example over HTTP. Each read is one fetch."""

    def __init__(self, fetch: Callable[[int, int], bytes], length: int) -> None:
        """fetch: returns the bytes for an offset and a number of bytes. length: of the file."""
        self._fetch, self._length = fetch, length

    def read(self, start: int, size: int) -> bytes:
        size = min(size, self._length - start)
        return self._fetch(start, size) if size > 0 else b""

    def length(self) -> int:
        return self._length


class Held:
    """A source of which one range of bytes is read at once, and held."""

    def __init__(self, source: Source, start: int, size: int) -> None:
        """start, size: the range."""
        self._source, self._start, self._end = source, start, start + size
        self._held = source.read(start, size)

    def read(self, start: int, size: int) -> bytes:
        if self._start <= start and start + size <= self._end:
            return self._held[start - self._start : start - self._start + size]
        return self._source.read(start, size)

    def length(self) -> int:
        return self._source.length()


class FileBytes:
    """A file as a sequence of bytes, whose slices are read on access."""

    def __init__(self, source: Source) -> None:
        """source: it can be read at any offset."""
        self._source, self._length = source, source.length()

    def __len__(self) -> int:
        return self._length

    def __getitem__(self, part: slice) -> bytes:
        start, stop, _ = part.indices(self._length)
        size = max(0, stop - start)
        # If the file was truncated meanwhile, zeros keep the length of the slice.
        return self._source.read(start, size).ljust(size, b"\0")
