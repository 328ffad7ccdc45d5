"""A local server of one page and one file, reachable only from this machine."""

import contextlib
import io
import os
import sys
import threading
import webbrowser
from collections.abc import Callable
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any, BinaryIO

from ..files.terminal import say
from ..statuses import UsageError

ADDRESS = "127.0.0.1"
# The path of the file.
FILE = "scene.c3gs"
_BLOCK = 1 << 16


class Server(ThreadingHTTPServer):
    """Serves the page at / and the file at /scene.c3gs."""

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
        """Answers with the page or the file."""
        # DNS rebinding: a page of another site would send the name of that site.
        port, path = self.server.server_port, self.path.partition("?")[0]
        if self.headers.get("Host") not in (f"{ADDRESS}:{port}", f"localhost:{port}"):
            self.send_error(HTTPStatus.FORBIDDEN)
        elif path == "/":
            self._send(io.BytesIO(self.server.page), "text/html; charset=utf-8")
        elif path == f"/{FILE}":
            try:
                file = self.server.file()
            except OSError:
                self.send_error(HTTPStatus.NOT_FOUND)
                return
            with file:
                self._send(file, "application/octet-stream")
        else:
            self.send_error(HTTPStatus.NOT_FOUND)

    def do_HEAD(self) -> None:
        """Answers as do_GET, without the content."""
        self.do_GET()

    def _send(self, file: BinaryIO, kind: str) -> None:
        left = file.seek(0, os.SEEK_END)
        self.send_response(HTTPStatus.OK)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(left))
        # The file may change between requests.
        self.send_header("Cache-Control", "no-store")
        self.send_header("X-Content-Type-Options", "nosniff")
        self.send_header("Cross-Origin-Resource-Policy", "same-origin")
        self.end_headers()
        if self.command == "HEAD":
            return
        file.seek(0)
        while left and (block := file.read(min(_BLOCK, left))):
            left -= len(block)
            try:
                self.wfile.write(block)
            except OSError:
                # The page was closed.
                self.close_connection = True
                return
        # The file became shorter than the stated length.
        self.close_connection = self.close_connection or left > 0

    def log_message(self, format: str, *args: object) -> None:
        """Does not log requests."""


def serve(page: bytes, file: Callable[[], BinaryIO], shown: str, port: int = 0, browser: bool = True) -> None:
    """Serves a page and a file until Ctrl-C, and prints the address.

    page, file, port: as for Server. shown: the name of the file. browser: whether a browser is opened. Raises
    UsageError if the port cannot be used.
    """
    try:
        server = Server(page, file, port)
    except OSError as error:
        problem = f"port {port} cannot be used: {error.strerror or error}"
        raise UsageError(f"{problem}; choose another one, or omit --port") from None
    with server:
        say(f"{server.url} shows {shown}. Ctrl-C ends it.")
        sys.stdout.flush()
        if browser:
            # A text browser requests the page before the call returns.
            threading.Thread(target=webbrowser.open, args=(server.url,), daemon=True).start()
        # Ctrl-C is the regular end.
        with contextlib.suppress(KeyboardInterrupt):
            server.serve_forever()
