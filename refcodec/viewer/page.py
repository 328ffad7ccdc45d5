"""The page: its HTML and scripts, with the decoder in it, and a file and photographs if they are given."""

import gzip
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ..files.outputs import Kind
from ..pages.environment import encoded, raw, render
from .bundle import bundle

_FOLDER = Path(__file__).resolve().parent
_DECODER = _FOLDER.parent / "web" / "c3gs.wasm"
# The files that this module writes.
PAGE = Kind.signed("a page that refcodec wrote", b"<!doctype html>\n<!-- refcodec viewer -->")


def page(
    name: str,
    file: bytes | None = None,
    url: str | None = None,
    photographs: Sequence[dict[str, Any]] = (),
    beside: Sequence[tuple[str, bytes, float | None]] = (),
) -> bytes:
    """Returns the page, in HTML.

    Args:
        name: the name of the file, which is shown if the file has no title.
        file: the bytes of the file, which become part of the page. Such a page makes no request.
        url: the address of the file, if it is not part of the page. Without both, the user chooses a file.
        photographs: as `photographs.embedded` returns them.
        beside: the scene in other formats, which become part of the page: name, bytes, and PSNR to the scene in dB.
    """
    return render(
        _FOLDER / "page.html",
        settings={
            **{"name": name, "url": url, "photographs": list(photographs)},
            "beside": [
                {"name": own, "length": len(data), "text": encoded(data), "psnr": psnr} for own, data, psnr in beside
            ],
        },
        fetches=file is None,
        wasm=_packed(_DECODER.read_bytes()),
        scene=encoded(file or b""),
        worker=_packed(bundle(_FOLDER / "worker.js").encode()),
        script=raw(bundle(_FOLDER / "page.js")),
    ).encode()


def _packed(data: bytes) -> str:
    return encoded(gzip.compress(data, mtime=0))
