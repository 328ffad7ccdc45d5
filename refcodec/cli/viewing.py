"""The command view, which shows a scene in a browser, and the page of export."""

# Modules that need NumPy are imported where they are used, so that help is instant.
# ruff: noqa: PLC0415

from __future__ import annotations

import argparse
import io
import os
import sys
import threading
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

from ..files.outputs import check_apart, check_file
from ..files.stage import write_file
from ..files.terminal import note, say
from .bounds import add_bounds, read_bounded
from .shared import FILE, RENDER_PACKAGES, UsageError, add_command, encoded, needs, parse_file
from .shown import camera_of, photographs_as_trained, read_shown, render_info

if TYPE_CHECKING:
    from ..bitstream.scene import Scene
    from ..folder.uncompressed import Uncompressed

PAGE_SUFFIX = ".html"


def add_photographs(parser: argparse.ArgumentParser) -> None:
    """Adds the option for the photographs of a page."""
    parser.add_argument(
        "--photographs",
        metavar="FOLDER",
        help="add up to 8 held-out photographs to the page, to compare with the scene",
    )


def _photographs(
    arguments: argparse.Namespace, shown: bytes | Scene | Uncompressed
) -> tuple[list[dict[str, Any]], list[Path]]:
    """Returns the photographs of the page, and the files read for them. Raises UsageError."""
    if arguments.photographs is None:
        return [], []
    try:
        from ..photographs.cameras import PhotographError
        from ..viewer.photographs import embedded
    except ModuleNotFoundError as error:
        raise needs("--photographs", "render", error, RENDER_PACKAGES) from None
    try:
        folder, notes = photographs_as_trained(arguments, arguments.photographs, render_info(shown), camera_of(shown))
        photographs = embedded(folder)
    except PhotographError as error:
        raise UsageError(str(error)) from None
    for line in notes:
        note(f"refcodec: {line}")
    return photographs, folder.places()


def _file_of(arguments: argparse.Namespace, shown: bytes | Scene | Uncompressed) -> bytes:
    """Returns the file for a page. A scene folder is encoded. Raises UsageError."""
    from ..bitstream.scene import Scene

    if isinstance(shown, bytes):
        return shown
    if isinstance(shown, Scene):
        return encoded(arguments, arguments.file, shown)
    raise UsageError(f"{arguments.file} is an uncompressed scene: encode it with refcodec encode, and give the file")


def _name(arguments: argparse.Namespace) -> str:
    """Returns the name that the page shows."""
    return os.path.basename(arguments.file.partition("?")[0].rstrip("/")) or "scene"


def export_page(arguments: argparse.Namespace, output: Path) -> int:
    """Writes a page that contains the file. Returns the exit status. Raises UsageError and BitstreamError."""
    from ..viewer.page import PAGE, page

    check_file(output, PAGE)
    check_apart([output], [arguments.file, arguments.photographs])
    shown = read_shown(arguments)
    if isinstance(shown, bytes):
        # A page of a damaged file would show only the error.
        parse_file(arguments, shown)
    photographs, read = _photographs(arguments, shown)
    check_apart([output], read)
    file = _file_of(arguments, shown)
    data = page(_name(arguments), file, photographs=photographs)
    write_file(output, data)
    more = f" and {len(photographs)} photographs" if photographs else ""
    say(f"{output}: {len(data):,} bytes, including the file of {len(file):,}{more}")
    return 0


def _served(arguments: argparse.Namespace) -> tuple[Callable[[], BinaryIO], list[dict[str, Any]]]:
    """Returns a function that opens the file, and the photographs. Raises UsageError and BitstreamError."""
    path = arguments.file
    if os.path.isdir(path) or arguments.photographs is not None:
        shown = read_shown(arguments)
        return partial(io.BytesIO, _file_of(arguments, shown)), _photographs(arguments, shown)[0]
    # The page itself reports errors of the file. It gets the file in its state when the page is loaded.
    data = read_bounded(arguments)
    if os.path.isfile(path):
        return lambda: open(path, "rb"), []
    return partial(io.BytesIO, data), []


def _view(arguments: argparse.Namespace) -> int:
    import webbrowser

    from ..viewer.page import page
    from ..viewer.server import FILE, Server

    file, photographs = _served(arguments)
    data = page(_name(arguments), url=FILE, photographs=photographs)
    try:
        server = Server(data, file, arguments.port)
    except OSError as error:
        raise UsageError(
            f"port {arguments.port} cannot be used: {error.strerror or error}; choose another one, or omit --port"
        ) from None
    with server:
        say(f"{server.url} shows {arguments.file}. Ctrl-C ends it.")
        sys.stdout.flush()
        if not arguments.no_browser:
            # A text browser requests the page before the call returns.
            threading.Thread(target=webbrowser.open, args=(server.url,), daemon=True).start()
        try:
            server.serve_forever()
        except KeyboardInterrupt:
            # The regular end.
            return 0
    return 0


def _port(text: str) -> int:
    value = int(text)
    if not 0 <= value <= 65535:
        raise argparse.ArgumentTypeError(f"must be from 0 to 65535, not {text}")
    return value


def add(commands: Any) -> None:
    """Adds the command of this module."""
    view = add_command(
        commands,
        "view",
        _view,
        "show a file in the browser",
        ["view scene.c3gs", "view scene.c3gs --photographs photographs", "view scene.c3gs --port 8000 --no-browser"],
        "FILE is a file or a scene folder. The browser decodes and draws it. The server answers only this machine\n"
        "and serves only the page and the file. Other files can be dropped on the page.\n"
        "`refcodec export FILE -o scene.html` writes a page that contains the file and needs no server.\n"
        "--photographs needs: pip install 'refcodec[render]'.",
    )
    view.add_argument("file", metavar="FILE", help=FILE)
    add_bounds(view)
    view.add_argument("--port", type=_port, metavar="N", default=0, help="port of the server (default: a free one)")
    view.add_argument("--no-browser", action="store_true", help="do not open a browser")
    add_photographs(view)
    view.add_argument(
        "--size",
        metavar="WxH",
        help="size of the photographs, longest side, or full for unscaled (default: the training size)",
    )
