"""Pieces of HTML, and numbers as text. Whatever comes from a file is escaped here."""

from __future__ import annotations

import base64
import html
from collections.abc import Iterable, Sequence

from ...files.text import printable

# The most characters that are shown of a text from a file.
TEXT_MAX = 400
NUMBER, TEXT = "number", "text"


def text(value: object, most: int | None = TEXT_MAX) -> str:
    """Returns a text as HTML: nothing in it is markup, and every character of it can be shown."""
    return html.escape(printable(str(value), most), quote=True)


def tag(name: str, *content: str, **attributes: object) -> str:
    """Returns an element.

    content: HTML. attributes: their values are escaped. `class_` stands for class, and an underscore for a hyphen.
    """
    written = "".join(
        f' {key.rstrip("_").replace("_", "-")}="{text(value, None)}"' for key, value in attributes.items()
    )
    return f"<{name}{written}>{''.join(content)}</{name}>"


def table(columns: Sequence[tuple[str, str]], rows: Iterable[Sequence[str]], **attributes: object) -> str:
    """Returns a table that can be scrolled sideways.

    columns: for each its title, as text, and NUMBER or TEXT. rows: their cells, as HTML. attributes: of the table.
    """
    kinds = [kind for _, kind in columns]
    head = tag("tr", *(tag("th", text(title), class_=kind, scope="col") for title, kind in columns))
    body = "\n".join(
        tag("tr", *(tag("td", cell, class_=kind) for cell, kind in zip(row, kinds, strict=True))) for row in rows
    )
    whole = tag("table", tag("thead", head), "\n", tag("tbody", body), **attributes)
    return tag("div", whole, class_="wide") + "\n"


def image(png: bytes, words: str, **attributes: object) -> str:
    """Returns a picture that the page holds itself. words: what it shows, for those who do not see it."""
    source = f"data:image/png;base64,{base64.b64encode(png).decode()}"
    return (
        f'<img alt="{text(words)}" src="{source}"'
        + "".join(f' {key.rstrip("_")}="{text(value)}"' for key, value in attributes.items())
        + ">"
    )


def count(number: float, digits: int = 0) -> str:
    """Returns a number with commas between thousands."""
    return f"{number:,.{digits}f}"


def share(part: float, whole: float) -> str:
    """Returns a share in percent."""
    return f"{100 * part / whole:.1f} %" if whole else "-"


def size(number: int) -> str:
    """Returns a number of bytes, with its unit."""
    return f"{number:,} {'byte' if number == 1 else 'bytes'}"
