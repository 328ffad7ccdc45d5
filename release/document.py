"""SPEC.md as one HTML file, which needs no other file. Browsers print it on pages of A4."""

from __future__ import annotations

import base64
import hashlib
import html
import re
from functools import cache
from pathlib import Path

from docs import chapters
from refcodec.bitstream.errors import REGISTRY
from refcodec.inspect import specification

from .source import Source
from .statements import when

# Targets of MyST before a requirement, in the Markdown of docs.chapters.
_STATED = re.compile(r"^- \((\S+)\)=\n  \*\*\\\[(\S+?)\\\]\*\*", re.MULTILINE)


def page(source: Source, folder: Path) -> list[Path]:
    """Writes the HTML file. Permanent anchors are `#6.7`, `#R6.7-1` and `#e401`, as in the manual. Returns its path."""
    path = folder / f"c3gs-spec-{source.version}.html"
    parts = [_rendered(chapter.text) for chapter in chapters.chapters()]
    manifest = hashlib.sha256((source.folder / "vectors" / "manifest.json").read_bytes()).hexdigest()
    rows = {
        "Version": source.version,
        "Date": when(source.epoch)[:10],
        "Commit": source.commit,
        f"Vectors {source.suite}": f"manifest.json, SHA-256 {manifest}",
    }
    about = "".join(f"<tr><th>{key}</th><td><code>{value}</code></td></tr>" for key, value in rows.items())
    introduction = _rendered(chapters.introduction())
    head, _, rest = introduction.partition("</h1>")
    heads = re.findall(r'<h1 id="([^"]+)">(.*?)</h1>', "".join(parts))
    contents = "".join(f'<li><a href="#{anchor}">{words}</a></li>' for anchor, words in heads)
    body = f"{head}</h1><table>{about}</table>{rest}<nav><h2>Contents</h2><ul>{contents}</ul></nav>{''.join(parts)}"
    body = re.sub(r'<img src="([^"]+)"', lambda found: f'<img src="{_picture(source, found[1])}"', body)
    style = (Path(__file__).parent / "document.css").read_text(encoding="utf-8")
    title = html.escape(re.sub(r"<[^>]+>", "", head).strip())
    path.write_text(
        f'<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n<title>{title}</title>\n'
        f'<meta name="viewport" content="width=device-width">\n<style>\n{style}</style>\n</head>\n'
        f"<body>\n{body}</body>\n</html>\n",
        encoding="utf-8",
    )
    return [path]


@cache
def _places() -> dict[str, str]:
    """The permanent anchor by the anchor that code hosts give, of each clause and requirement."""
    clauses = {clause.anchor: number for number, clause in specification.own_clauses().items()}
    return clauses | {chapters.place_of(name): name for name in specification.own_requirements()}


def _rendered(text: str) -> str:
    """Returns the HTML of a chapter. Links to files, which are not beside the page, are their words only."""
    from markdown_it import MarkdownIt  # noqa: PLC0415 (only the extra `release` has it)

    # Comments are marks for the tools of the repository.
    text = chapters.outside_code(text, lambda words: re.sub(r"<!--.*?-->\n*", "", words, flags=re.DOTALL))
    text = _STATED.sub(r'- <a id="\2"></a>**[\2](SPEC.md#\1)**', text)
    markdown = MarkdownIt("commonmark", {"html": True, "highlight": _highlighted}).enable("table")
    made: str = markdown.render(text)
    made = re.sub(r"<h(\d)>((?:Annex )?([\dA-H](?:[\d.]*\d)?):? .*?)</h\1>", r'<h\1 id="\3">\2</h\1>', made)
    made = re.sub(r'<a href="([^"]+)">(.*?)</a>', _link, made, flags=re.DOTALL)
    return re.sub(r"<tr>(?=\s*<td>(\d{3})</td>\s*<td>([a-z_.]+)</td>)", _error, made)


def _link(found: re.Match[str]) -> str:
    place, _, anchor = found[1].partition("#")
    if "://" in found[1] or found[1].startswith("mailto:"):
        return found[0]
    if place in ("", "SPEC.md") and anchor in _places():
        return f'<a href="#{_places()[anchor]}">{found[2]}</a>'
    return found[2]


def _error(found: re.Match[str]) -> str:
    known = REGISTRY.get(found[2])
    return f'<tr id="e{found[1]}">' if known is not None and str(known.code) == found[1] else found[0]


def _picture(source: Source, name: str) -> str:
    data = (source.folder / name).read_bytes()
    return f"data:image/svg+xml;base64,{base64.b64encode(data).decode()}"


def _highlighted(code: str, language: str, _: str) -> str:
    """Returns the HTML of a block of code in Python; the others stay as they are, which an empty string says."""
    from pygments import highlight  # noqa: PLC0415 (only the extra `release` has it)
    from pygments.formatters import HtmlFormatter  # noqa: PLC0415
    from pygments.lexers import PythonLexer  # noqa: PLC0415

    return str(highlight(code, PythonLexer(), HtmlFormatter(nowrap=True))) if language == "python" else ""
