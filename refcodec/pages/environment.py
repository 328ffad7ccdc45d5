"""HTML pages from Jinja2 templates: the environment, its filters and the style sheet.

A page extends base.html, and imports macros from parts.html. It is one document that refers to nothing outside itself.
"""

from __future__ import annotations

import base64
import hashlib
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..files.text import printable

if TYPE_CHECKING:
    import jinja2
    from markupsafe import Markup

_FOLDER = Path(__file__).resolve().parent
# The most characters of a text from a file, where the template states no other limit.
_TEXT_MAX = 400


def raw(html: str) -> Markup:
    """Returns text that a template inserts unescaped."""
    from markupsafe import Markup  # noqa: PLC0415

    return Markup(html)


def encoded(data: bytes) -> Markup:
    return raw(base64.b64encode(data).decode())


def _size(number: int) -> str:
    return f"{number:,} {'byte' if number == 1 else 'bytes'}"


def _share(part: float, whole: float) -> str:
    return f"{100 * part / whole:.1f} %" if whole else "-"


def _sha256(text: str) -> Markup:
    return raw(f"'sha256-{encoded(hashlib.sha256(text.encode()).digest())}'")


@cache
def _environment(folder: Path) -> jinja2.Environment:
    # A decoder that makes no page must not wait for the import.
    import jinja2  # noqa: PLC0415

    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader([folder, _FOLDER]),
        autoescape=True,
        # Text from a file cannot inject markup into the page, or control codes into a terminal that shows its source.
        finalize=lambda value: printable(value, lines=True) if type(value) is str else value,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.globals["style"] = raw((_FOLDER / "style.css").read_text(encoding="utf-8"))
    environment.filters |= {
        "count": lambda number, digits=0: f"{number:,.{digits}f}",
        "share": _share,
        "size": _size,
        "cut": lambda text, most=_TEXT_MAX: printable(str(text), most),
        "sha256": _sha256,
        "base64": encoded,
    }
    return environment


def render(template: Path, **values: Any) -> str:
    """Returns the HTML of a page. All values are escaped, unless they are markupsafe.Markup.

    template: a file. values: the variables of the template.
    """
    return _environment(template.resolve().parent).get_template(template.name).render(values)
