"""The page: its HTML, style and scripts, with the decoder in it, and a file and photographs if they are given."""

from __future__ import annotations

import base64
import gzip
import hashlib
import json
from collections.abc import Sequence
from pathlib import Path
from string import Template
from typing import Any

from ..files.outputs import Kind
from .bundle import bundle

_FOLDER = Path(__file__).resolve().parent
_DECODER = _FOLDER.parent / "web" / "c3gs.wasm"
# The files that this module writes.
PAGE = Kind.signed("a page that refcodec wrote", b"<!doctype html>\n<!-- refcodec viewer -->")


def page(
    name: str, file: bytes | None = None, url: str | None = None, photographs: Sequence[dict[str, Any]] = ()
) -> bytes:
    """Returns the page, in HTML.

    Args:
        name: of the file, which is shown where the file has no title.
        file: its bytes, which become part of the page. Such a page asks for nothing from anywhere.
        url: where the page finds the file, if it is no part of it. Without both, people choose one.
        photographs: as `photographs.embedded` gives them.
    """
    settings = {"name": name, "url": url, "photographs": list(photographs)}
    style = (_FOLDER / "style.css").read_text(encoding="utf-8")
    script = bundle(_FOLDER / "page.js")
    # Line feeds belong to what is hashed, as they stand in page.html.
    text = Template((_FOLDER / "page.html").read_text(encoding="utf-8")).substitute(
        policy=_policy("\n" + style, "\n" + script, file is None),
        style=style,
        # A text of others must not end the element that holds it.
        settings=json.dumps(settings).replace("<", "\\u003c"),
        wasm=_packed(_DECODER.read_bytes()),
        scene="" if file is None else _base64(file),
        worker=_packed(bundle(_FOLDER / "worker.js").encode()),
        script=script,
    )
    return text.encode()


def _policy(style: str, script: str, fetches: bool) -> str:
    """Returns the Content-Security-Policy: the page's own script and style, and at most files of its own server."""
    rules = {
        "default-src": "'none'",
        "script-src": f"{_hash(script)} 'wasm-unsafe-eval'",
        "worker-src": "blob:",
        "style-src": _hash(style),
        "img-src": "data:",
        "connect-src": "'self'" if fetches else "'none'",
        "base-uri": "'none'",
        "form-action": "'none'",
    }
    return "; ".join(f"{rule} {value}" for rule, value in rules.items())


def _hash(text: str) -> str:
    return f"'sha256-{_base64(hashlib.sha256(text.encode()).digest())}'"


def _packed(data: bytes) -> str:
    return _base64(gzip.compress(data, mtime=0))


def _base64(data: bytes) -> str:
    return base64.b64encode(data).decode()
