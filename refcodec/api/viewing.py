"""Show files in the browser."""

from __future__ import annotations

import io
import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, Unpack

from ..files.outputs import check_apart
from ..files.stage import write_file
from ..statuses import refusing
from . import kinds
from .command import ReadingWords, Report, apply_only, command

if TYPE_CHECKING:
    from .scenes import Scene
    from .shown import Shown


def write_page(
    shown: Shown, path: Path, words: Mapping[str, Any], splats: Mapping[Path, float | None] | None = None
) -> Report:
    """Writes a page that contains the file of a scene.

    words: those of `view` on photographs. splats: files that the page contains, and their PSNR to the scene in dB, None
    if they lose nothing but what their format does.
    """
    from ..formats.common import LINEAR, check_colours
    from ..viewer.page import page

    # A page of a damaged file would show only the error.
    _ = shown.scene
    with refusing(f"{shown.name} cannot be exported"):
        # The page encodes linear light (SPEC [G6.5-2]).
        check_colours(shown.render, LINEAR)
    images, reads = _pictures(shown, words)
    check_apart([path], reads)
    data = shown.file()
    beside = [(path.name, path.read_bytes(), psnr) for path, psnr in (splats or {}).items()]
    made = page(_name(shown.name), data, photographs=images, beside=beside)
    write_file(path, made)
    more = "".join([f", {len(images)} photographs"] * bool(images) + [f", {name}" for name, *_ in beside])
    return Report([f"{path}: {len(made):,} bytes, including the file of {len(data):,}{more}"])


def _pictures(shown: Shown, words: Mapping[str, Any]) -> tuple[list[dict[str, Any]], list[Path]]:
    """Returns the photographs of a page, and the files that were read for them. Raises UsageError."""
    if words.get("photographs") is None:
        return [], []
    from ..viewer.photographs import embedded

    folder, notes = shown.photographs(words["photographs"], {"size": words.get("size")})
    images = embedded(folder)
    shown.remark(*notes)
    return images, folder.places()


def _name(name: str) -> str:
    """Returns the name that a page shows. name: of the file."""
    return os.path.basename(name.partition("?")[0].rstrip("/")) or "scene"


@command("render")
def view(
    file: kinds.Place | Scene,
    *,
    port: kinds.Port = 0,
    no_browser: bool = False,
    photographs: kinds.AnyPath | None = None,
    size: kinds.Size | None = None,
    **words: Unpack[ReadingWords],
) -> None:
    """Show a file in the browser.

    FILE is a file or a scene folder. The browser decodes and draws it. The server answers only this machine
    and serves only the page and the file. Other files can be dropped on the page.
    `refcodec export FILE -o scene.html` writes a page that contains the file and needs no server.
    --photographs needs: pip install 'refcodec[render]'.

    Args:
        port: port of the server (default: a free one).
        no_browser: do not open a browser.
        photographs: add up to 8 held-out photographs to the page, to compare with the scene.

    Examples:
        view scene.c3gs
        view scene.c3gs --photographs photographs
        view scene.c3gs --port 8000 --no-browser
    """
    from ..folder.places import read_whole, shown_name
    from ..viewer.page import page
    from ..viewer.server import FILE, serve
    from .scenes import Scene
    from .shown import Shown

    if photographs is None:
        apply_only({"size": size}, ("size",), "photographs: omit it")
    name, path = shown_name(file), file if isinstance(file, str | os.PathLike) else ""
    images: list[dict[str, Any]] = []
    if isinstance(file, Scene) or os.path.isdir(path) or photographs is not None:
        shown = Shown(file, words)
        data: bytes | None = shown.file()
        images = _pictures(shown, {"photographs": photographs, "size": size})[0]
    else:
        # The page itself reports errors of the file. It gets the file in its state when the page is loaded.
        data = read_whole(file, words)
        # It is not held meanwhile.
        data = None if os.path.isfile(path) else data

    def stored() -> BinaryIO:
        return open(path, "rb") if data is None else io.BytesIO(data)

    serve(page(_name(name), url=FILE, photographs=images), stored, name, port, not no_browser)
