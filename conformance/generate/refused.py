"""Files with one fault each."""

from __future__ import annotations

from refcodec import codec

from ..files import Target, repair
from .recipes import Book, Refused
from .scenes import scene


def add(book: Book) -> None:
    """Adds the vectors."""

    def base() -> Target:
        return Target(codec.emit(scene("refused")))

    book.add("malformed-truncated-19", "19 bytes", lambda: Refused(base().data[:19], "prologue.truncated", 19), features="prologue")
    book.add(
        "malformed-signature", "another signature", lambda: Refused(b"?" + base().data[1:], "prologue.signature", 0), features="prologue"
    )
    book.add("unsupported-profile", "profile 7", lambda: Refused(repair(base().put(20, b"\7")), "header.profile", 20), features="header")
    book.add("invalid-up-axis", "up_axis 6", lambda: _set(base(), "render_info.up_axis", b"\6", "header.render_info"), features="header")


def _set(t: Target, path: str, value: bytes, name: str) -> Refused:
    return Refused(repair(t.put(t.at(path), value)), name, t.at(path))
