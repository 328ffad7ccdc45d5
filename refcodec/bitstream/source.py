"""The bytes of a file: in memory, as they arrive, or by ranges (SPEC.md 10.2)."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import BinaryIO, Protocol

from .errors import BitstreamError


def pad4(length: int) -> int:
    """SPEC 5: returns the least multiple of four that is not below a length."""
    return -(-length // 4) * 4


def padded(content: bytes) -> bytes:
    """SPEC 5: returns some bytes with the padding behind them."""
    return content + bytes(pad4(len(content)) - len(content))


@dataclass(frozen=True)
class Piece:
    """Some bytes of a file. start: the offset of the first one in the file."""

    data: bytes
    start: int

    def __len__(self) -> int:
        return len(self.data)

    def cut(self, first: int, end: int) -> Piece:
        """Returns the bytes from `first` to before `end`, both counted from the start of the piece."""
        return Piece(self.data[first:end], self.start + first)

    def error(self, name: str, at: int, path: str, found: object, allowed: object) -> BitstreamError:
        """Returns the error `name` about byte `at` of the piece. The rest is as in BitstreamError."""
        return BitstreamError(name, self.start + at, path, found, allowed)

    def require_zero(self, name: str, first: int, end: int, path: str) -> None:
        """Raises the error `name` unless the padding from `first` to before `end` is zero. It points at `first`."""
        if any(self.data[first:end]):
            raise self.error(name, first, f"{path}, padding", self.data[first:end].hex(" "), "zeros")


class Source(Protocol):
    """Where the bytes of a file come from."""

    def read(self, start: int, size: int) -> bytes:
        """Returns `size` bytes from `start` on, or fewer where the file ends before."""
        ...

    def length(self) -> int:
        """Returns the length of the file. A decoder asks for it only after `read` returned too few bytes."""
        ...


class WholeFile:
    """A file in memory."""

    def __init__(self, data: bytes) -> None:
        self._data = data

    def read(self, start: int, size: int) -> bytes:
        """As Source.read."""
        return self._data[start : start + size]

    def length(self) -> int:
        """As Source.length."""
        return len(self._data)


class StoredFile:
    """A file on a disk, of which only what is asked for is read."""

    def __init__(self, file: BinaryIO) -> None:
        """file: opened to read bytes. It can be read from any place."""
        self._file = file
        self._length = file.seek(0, 2)

    def read(self, start: int, size: int) -> bytes:
        """As Source.read. Raises OSError."""
        # Memory for all bytes of a read is taken before the first one is read. A size may be a lie of the file.
        size = min(size, self._length - start)
        if size <= 0:
            return b""
        self._file.seek(start)
        return self._file.read(size)

    def length(self) -> int:
        """As Source.length. It is that when the file was opened."""
        return self._length


class Arriving:
    """A file whose bytes arrive in blocks, such as those of a response. It is read from start to end.

    Only the bytes that are asked for are held, and what of the last block lies behind them.
    """

    def __init__(self, blocks: Iterable[bytes]) -> None:
        self._blocks = iter(blocks)
        self._held = bytearray()
        self._start = 0

    def read(self, start: int, size: int) -> bytes:
        """As Source.read. Raises ValueError for bytes before those that were read last."""
        if start < self._start:
            raise ValueError(f"byte {start} was passed; reading is at byte {self._start}")
        while self._start + len(self._held) < start + size:
            block = next(self._blocks, None)
            if block is None:
                break
            self._held += block
            self._pass(start)
        self._pass(start)
        found = bytes(self._held[:size])
        self._pass(start + len(found))
        return found

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
    """A file that is fetched by ranges of bytes, such as over HTTP. Each read is one fetch."""

    def __init__(self, fetch: Callable[[int, int], bytes], length: int) -> None:
        """fetch: takes the first byte and the number of bytes, and returns them. length: that of the file."""
        self._fetch, self._length = fetch, length

    def read(self, start: int, size: int) -> bytes:
        """As Source.read."""
        size = min(size, self._length - start)
        return self._fetch(start, size) if size > 0 else b""

    def length(self) -> int:
        """As Source.length."""
        return self._length


class Held:
    """A source of which some bytes in a row are read at once, and held."""

    def __init__(self, source: Source, start: int, size: int) -> None:
        """start, size: where the bytes are."""
        self._source, self._start, self._end = source, start, start + size
        self._held = source.read(start, size)

    def read(self, start: int, size: int) -> bytes:
        """As Source.read."""
        if self._start <= start and start + size <= self._end:
            return self._held[start - self._start : start - self._start + size]
        return self._source.read(start, size)

    def length(self) -> int:
        """As Source.length."""
        return self._source.length()


class FileBytes:
    """A file as a sequence of bytes, whose slices are read when they are asked for."""

    def __init__(self, source: Source) -> None:
        """source: it can be read from any place."""
        self._source, self._length = source, source.length()

    def __len__(self) -> int:
        return self._length

    def __getitem__(self, part: slice) -> bytes:
        start, stop, _ = part.indices(self._length)
        size = max(0, stop - start)
        # A file that is cut off meanwhile has zeros there, so that every slice has its length.
        return self._source.read(start, size).ljust(size, b"\0")
