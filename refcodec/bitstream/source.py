"""The bytes of a file: in memory, as they arrive, or by ranges (SPEC.md 10.2)."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Protocol

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
        """Returns the length of the file. It is asked for only after `read` returned too few bytes."""
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
