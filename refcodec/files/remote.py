"""Files behind a URL, fetched by byte ranges (fsspec, the extra `http`).

Servers are not trusted: any answer but the requested range is refused in one line.
"""

# fsspec is imported where it is used, because files on a disk do not need it.
# ruff: noqa: PLC0415

from __future__ import annotations

import contextlib
import os
import re
from collections.abc import Iterator
from time import monotonic
from types import TracebackType
from typing import Any

from ..statuses import UsageError
from .text import printable

# The bytes that are fetched first and kept: the header with its directory, and the next sections of most files.
HEAD_BYTES = 1 << 16
# The longest silence of a server, in seconds; the seconds that all its answers may take beside the time of their bytes;
# and the minimum bytes a second.
TIMEOUT, TOTAL_TIMEOUT, BYTES_A_SECOND = 30.0, 300.0, 1 << 14
_RANGE = "Content-Range"
# RFC 9110, 8.8: headers that change with the file.
_VALIDATORS = ("ETag", "Last-Modified")
_CONTENT_RANGE = re.compile(r"bytes (\d{1,18})-\d{1,18}/(\d{1,18})", re.ASCII)


def is_url(path: str) -> bool:
    """Whether a path is a URL, and not the name of an existing file."""
    return "://" in path and not os.path.lexists(path)


class RemoteFile:
    """A file behind a URL, and a context manager. Each read behind the first HEAD_BYTES is one fetch."""

    def __init__(self, url: str) -> None:
        """Fetches the head. Raises UsageError if that fails, or a package is missing."""
        self._url = url
        with self._refusing():
            try:
                from fsspec.core import url_to_fs

                system, path = url_to_fs(url)
            except ImportError as error:
                text = f"a URL needs another package ({error}): pip install 'refcodec[http]'"
                raise UsageError(printable(text, 300)) from None
            web = "http" in (system.protocol if isinstance(system.protocol, tuple) else (system.protocol,))
            self._ranges: _Web | _Stored = _Web(system, path) if web else _Stored(system, path)
            self._head, self._length = self._ranges.head()

    def __enter__(self) -> RemoteFile:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._ranges.close()

    def read(self, start: int, size: int) -> bytes:
        """Returns `size` bytes from `start` on, or fewer at the end of the file. Raises UsageError."""
        size = min(size, self._length - start)
        if size <= 0:
            return b""
        if start + size <= len(self._head):
            return self._head[start : start + size]
        with self._refusing():
            return self._ranges.fetch(start, size)

    def length(self) -> int:
        return self._length

    @contextlib.contextmanager
    def _refusing(self) -> Iterator[None]:
        try:
            yield
        except (UsageError, MemoryError):
            raise
        # Each package behind fsspec has its own errors. After any of them, the file cannot be read.
        except Exception as error:
            text = " ".join(str(error).split()) or type(error).__name__
            raise UsageError(f"cannot read {printable(self._url, 200)}: {printable(text, 200)}") from None


class _Stored:
    """A file of another system than the web, such as an object store, which opens seekable files."""

    def __init__(self, system: Any, path: str) -> None:
        self._file = system.open(path, "rb", cache_type="none")

    def head(self) -> tuple[bytes, int]:
        """Returns the first bytes, and the length of the file."""
        length = self._file.seek(0, 2)
        return self.fetch(0, min(HEAD_BYTES, length)), length

    def fetch(self, start: int, size: int) -> bytes:
        """Returns a range of bytes. Raises ValueError for another length."""
        self._file.seek(start)
        data: bytes = self._file.read(size)
        return _whole(data, size)

    def close(self) -> None:
        """Closes the file."""
        self._file.close()


class _Web:
    """A file of a web server with range requests (RFC 9110, chapter 14)."""

    def __init__(self, system: Any, path: str) -> None:
        self._system, self._path, self._length = system, path, -1
        self._validators: dict[str, str] = {}
        # The seconds and the bytes of all answers.
        self._spent, self._got = 0.0, 0

    def head(self) -> tuple[bytes, int]:
        """Returns the first bytes, and the file length that the server states."""
        data, self._length, self._validators = self._asked(0, HEAD_BYTES)
        return _whole(data, min(HEAD_BYTES, self._length)), self._length

    def fetch(self, start: int, size: int) -> bytes:
        """Returns a range of bytes. Raises ValueError for another length, or a changed file."""
        data, length, validators = self._asked(start, size)
        if length != self._length:
            raise ValueError(f"it changed while it was read: its length was {self._length} bytes, and is {length} now")
        for name, before in self._validators.items():
            if name in validators and validators[name] != before:
                now = validators[name]
                raise ValueError(f"it changed while it was read: its {name} was {before}, and is {now} now")
        return _whole(data, size)

    def close(self) -> None:
        """Does nothing: fsspec closes the connections."""

    def _asked(self, start: int, size: int) -> tuple[bytes, int, dict[str, str]]:
        """Returns the answer, cut after one excess byte, and the stated file length and validators.

        Raises ValueError if there is no such answer.
        """
        import aiohttp
        from fsspec.exceptions import FSTimeoutError

        began = monotonic()
        try:
            return self._answer(start, size)
        except FileNotFoundError:
            raise ValueError("the server answers 404 Not Found") from None
        except aiohttp.ClientResponseError as error:
            # An empty file has no range.
            if error.status == 416 and start == 0 and error.headers and error.headers.get(_RANGE) == "bytes */0":
                return b"", 0, {}
            answer = f"answers {error.status} {error.message}" if error.status else "redirects too often"
            raise ValueError(f"the server {answer}") from None
        except FSTimeoutError as error:
            if isinstance(error.__cause__, aiohttp.ServerTimeoutError):
                raise ValueError(f"the server sends nothing for {TIMEOUT:.0f} s") from None
            raise ValueError(f"the server sends fewer than {BYTES_A_SECOND} bytes a second") from None
        except aiohttp.ClientConnectorError:
            raise
        except (aiohttp.ClientConnectionError, aiohttp.ClientPayloadError, ConnectionError) as error:
            raise ValueError(f"the connection broke ({error})") from None
        finally:
            self._spent, self._got = self._spent + monotonic() - began, self._got + size

    def _answer(self, start: int, size: int) -> tuple[bytes, int, dict[str, str]]:
        import aiohttp
        from fsspec.exceptions import FSTimeoutError

        headers = {"Range": f"bytes={start}-{start + size - 1}", "Accept-Encoding": "identity"}
        left = TOTAL_TIMEOUT + (self._got + size) / BYTES_A_SECOND - self._spent
        if left <= 0:
            raise FSTimeoutError
        timeout = aiohttp.ClientTimeout(total=left, sock_connect=TIMEOUT, sock_read=TIMEOUT)
        # A block size of 0 gives a stream, which reads no more than requested.
        with self._system.open(self._path, "rb", block_size=0, size=size, headers=headers, timeout=timeout) as stream:
            if stream.r.status != 206:
                raise ValueError("the server does not send ranges of bytes: download the file, and give its name")
            text = stream.r.headers.get(_RANGE, "")
            stated = _CONTENT_RANGE.fullmatch(text)
            if stated is None or int(stated[1]) != start:
                raise ValueError(f"the server sends another range than the one from {start} on ({text})")
            data = bytearray()
            while len(data) <= size and (block := stream.read(size + 1 - len(data))):
                data += block
            validators = {name: value for name in _VALIDATORS if (value := stream.r.headers.get(name))}
            return bytes(data), int(stated[2]), validators


def _whole(data: bytes, size: int) -> bytes:
    if len(data) != size:
        more = "more" if len(data) > size else f"{len(data)}"
        raise ValueError(f"the server sends {more} bytes where it should send {size}")
    return data
