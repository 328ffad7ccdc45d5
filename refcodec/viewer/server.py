"""A local server of one page and one file, reachable only from this machine."""

from __future__ import annotations

import io
import os
import re
import sys
from collections.abc import Callable
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any, BinaryIO

ADDRESS = "127.0.0.1"
# The path of the file.
FILE = "scene.c3gs"
_BLOCK = 1 << 16
_RANGE = re.compile(r"bytes=(\d{0,18})-(\d{0,18})", re.ASCII)


class Server(ThreadingHTTPServer):
    """Serves the page at / and the file at /scene.c3gs, also ranges of its bytes (RFC 9110, chapter 14)."""

    page: bytes
    file: Callable[[], BinaryIO]

    daemon_threads = True

    def __init__(self, page: bytes, file: Callable[[], BinaryIO], port: int = 0) -> None:
        """Listens. page: HTML. file: opens the file. port: 0 for a free one. Raises OSError."""
        self.page, self.file = page, file
        super().__init__((ADDRESS, port), _Handler)

    @property
    def url(self) -> str:
        """The address of the page."""
        return f"http://{ADDRESS}:{self.server_port}/"

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Ignores clients that disconnect. Other errors are faults."""
        if not isinstance(sys.exception(), (ConnectionError, TimeoutError)):
            super().handle_error(request, client_address)


class _Handler(BaseHTTPRequestHandler):
    server: Server
    protocol_version = "HTTP/1.1"
    # Seconds after which a connection that sends nothing ends.
    timeout = 60

    def do_GET(self) -> None:
        """Answers with the page, the file or a range of it."""
        # DNS rebinding: a page of another site would send the name of that site.
        port = self.server.server_port
        if self.headers.get("Host") not in (f"{ADDRESS}:{port}", f"localhost:{port}"):
            self.send_error(HTTPStatus.FORBIDDEN)
            return
        path = self.path.partition("?")[0]
        if path == "/":
            self._send(io.BytesIO(self.server.page), "text/html; charset=utf-8", False)
        elif path == f"/{FILE}":
            try:
                file = self.server.file()
            except OSError:
                self.send_error(HTTPStatus.NOT_FOUND)
                return
            with file:
                self._send(file, "application/octet-stream", True)
        else:
            self.send_error(HTTPStatus.NOT_FOUND)

    def do_HEAD(self) -> None:
        """Answers as do_GET, without the content."""
        self.do_GET()

    def _send(self, file: BinaryIO, kind: str, ranges: bool) -> None:
        length = file.seek(0, os.SEEK_END)
        found = self._range(length) if ranges else None
        start, end = found or (0, length)
        if start >= end and found is not None:
            self.send_response(HTTPStatus.REQUESTED_RANGE_NOT_SATISFIABLE)
            self.send_header("Content-Range", f"bytes */{length}")
            start = end = 0
        elif found is not None:
            self.send_response(HTTPStatus.PARTIAL_CONTENT)
            self.send_header("Content-Range", f"bytes {start}-{end - 1}/{length}")
        else:
            self.send_response(HTTPStatus.OK)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(end - start))
        if ranges:
            self.send_header("Accept-Ranges", "bytes")
        # The file may change between requests.
        self.send_header("Cache-Control", "no-store")
        self.send_header("X-Content-Type-Options", "nosniff")
        self.send_header("Cross-Origin-Resource-Policy", "same-origin")
        self.end_headers()
        if self.command == "HEAD":
            return
        file.seek(start)
        while start < end and (block := file.read(min(_BLOCK, end - start))):
            start += len(block)
            try:
                self.wfile.write(block)
            except OSError:
                # The page was closed.
                self.close_connection = True
                return
        # The file became shorter than the stated length.
        self.close_connection = self.close_connection or start < end

    def _range(self, length: int) -> tuple[int, int] | None:
        """Returns the requested range of bytes, start and end, or None for all.

        Several ranges, and invalid forms, count as none. A range with no byte of the file is empty.
        """
        found = _RANGE.fullmatch(self.headers.get("Range", ""))
        if found is None or not (found[1] or found[2]):
            return None
        if not found[1]:
            return max(length - int(found[2]), 0), length if int(found[2]) else 0
        start = int(found[1])
        if found[2] and int(found[2]) < start:
            return None
        return start, min(int(found[2]) + 1, length) if found[2] else length

    def log_message(self, format: str, *args: object) -> None:
        """Does not log requests."""
