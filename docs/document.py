"""SPEC.md as one HTML file, which needs no other file: a page of the manual, and an artefact of a release.

Permanent anchors are `#6.7` of a clause, `#R6.7-1` of a requirement and `#e401` of an error. References to clauses and
requirements are links. Browsers print the file on pages of A4.
"""

import base64
import re
from collections.abc import Callable, Mapping
from functools import cache
from html import escape
from pathlib import Path

from refcodec.bitstream.errors import REGISTRY
from refcodec.inspect import specification

# Code is left as it is: blocks, and words between backquotes.
_CODE = re.compile(r"^ *```.*?^ *```$|`[^`\n]*`", re.DOTALL | re.MULTILINE)
# What comes before the number of a clause that is meant as one. Other numbers with a point are figures.
_BEFORE = r"(?:\(|\| |\b(?:[Cc]lauses?|[Cc]hapters?|of|in|by|that|which|see)\s|\bAnnex(?:es)?\s)"
_NUMBER = r"(?:\d+(?:\.\d+)*|[A-H](?:\.\d+)*)"
_REFERENCE = re.compile(rf"({_BEFORE})({_NUMBER}(?:(?:,\s|\sto\s|\sand\s|,\sand\s){_NUMBER})*)(?![\w.%*^]|\.\d)")
# A whole number is a chapter only behind these words, and not in "of 2".
_CHAPTER = re.compile(r"(?:[Cc]hapters?|Annex(?:es)?)\s$")
# Figures have units.
_UNIT = re.compile(r"\s(?:KB|MB|bytes?|bits?|times|%|s|dB|anchors)\b")
_STATED = re.compile(rf"^- \[([RDGE]{specification.CLAUSE}-\d+)\]", re.MULTILINE)
_CITED = re.compile(rf"\[([RDGE]{specification.CLAUSE}-\d+)\](?!\()")
_HEADING = re.compile(rf"<h(\d)>((?:Annex )?({specification.CLAUSE}):? .*?)</h\1>")


def _outside_code(text: str, change: Callable[[str], str]) -> str:
    """Returns a text of which all but the code was changed. change: receives the text with a mark for each code."""
    kept: list[str] = []

    def keep(code: re.Match[str]) -> str:
        kept.append(code[0])
        return f"\0{len(kept) - 1}\0"

    return re.sub(r"\0(\d+)\0", lambda place: kept[int(place[1])], change(_CODE.sub(keep, text)))


@cache
def _permanent() -> dict[str, str]:
    """The permanent anchor of each clause by that of its heading on code hosts."""
    return {clause.anchor: number for number, clause in specification.own_clauses().items()}


def linked(text: str) -> str:
    """Returns Markdown with anchors where requirements are stated, and links where they and clauses are cited."""
    text = "\n".join(line if line.startswith("#") else _REFERENCE.sub(_numbers, line) for line in text.split("\n"))
    text = _STATED.sub(r'- <a id="\1"></a>**[\1](#\1)**', text)
    return _CITED.sub(r"[\\[\1\\]](#\1)", text)


def _numbers(cited: re.Match[str]) -> str:
    """Returns references with links, such as those in "(5.1 to 5.5, and 6.2)"."""
    if _UNIT.match(cited.string, cited.end()):
        return cited[0]
    chapter = bool(_CHAPTER.match(cited[1]))

    def one(number: re.Match[str]) -> str:
        known = number[0] in specification.own_clauses() and (chapter or "." in number[0])
        return f"[{number[0]}](#{number[0]})" if known else number[0]

    return cited[1] + re.sub(_NUMBER, one, cited[2])


def page(about: Mapping[str, str], root: Path) -> str:
    """Returns the HTML. about: rows of a table at its top. root: the folder of SPEC.md, in which its pictures are."""
    from markdown_it import MarkdownIt  # noqa: PLC0415 (the extras `docs` and `release` have it)

    # Comments are marks for the tools of the repository. The contents take the place of the table of chapters.
    text = _outside_code(specification.text(), lambda words: re.sub(r"<!--.*?-->\n*", "", words, flags=re.DOTALL))
    introduction, first, chapters = text.partition("\n## 1 ")
    text = re.sub(r"^\|.*\n", "", introduction, flags=re.MULTILINE) + first + chapters
    markdown = MarkdownIt("commonmark", {"html": True, "highlight": _highlighted}).enable("table")
    made = _HEADING.sub(r'<h\1 id="\3">\2</h\1>', markdown.render(_outside_code(text, linked)))
    made = re.sub(r'<a href="([^"]+)">(.*?)</a>', _link, made, flags=re.DOTALL)
    made = re.sub(r"<tr>(?=\s*<td>(\d{3})</td>\s*<td>([a-z_.]+)</td>)", _error, made)
    made = re.sub(r'<img src="([^"]+)"', lambda image: f'<img src="{_picture(root / image[1])}"', made)
    heads = re.findall(r'<h2 id="([^"]+)">(.*?)</h2>', made)
    contents = "".join(f'<li><a href="#{anchor}">{words}</a></li>' for anchor, words in heads)
    table = "".join(f"<tr><th>{key}</th><td><code>{escape(value)}</code></td></tr>" for key, value in about.items())
    made = made.replace("</h1>", f"</h1>\n<table>{table}</table>", 1)
    made = made.replace("<h2 ", f"<nav><h2>Contents</h2><ul>{contents}</ul></nav>\n<h2 ", 1)
    title = re.sub(r"<[^>]+>", "", made.partition("</h1>")[0]).strip()
    style = Path(__file__).with_suffix(".css").read_text(encoding="utf-8")
    return (
        f'<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n<title>{title}</title>\n'
        f'<meta name="viewport" content="width=device-width">\n<style>\n{style}</style>\n</head>\n'
        f"<body>\n{made}</body>\n</html>\n"
    )


def _link(link: re.Match[str]) -> str:
    """Returns a link with the permanent anchor. Of links to files, which are not beside the page, the words remain."""
    place, _, anchor = link[1].partition("#")
    if "://" in link[1] or link[1].startswith("mailto:"):
        return link[0]
    return link[2] if place not in ("", "SPEC.md") else f'<a href="#{_permanent().get(anchor, anchor)}">{link[2]}</a>'


def _error(row: re.Match[str]) -> str:
    known = REGISTRY.get(row[2])
    return f'<tr id="e{row[1]}">' if known is not None and str(known.code) == row[1] else row[0]


def _picture(path: Path) -> str:
    return f"data:image/svg+xml;base64,{base64.b64encode(path.read_bytes()).decode()}"


def _highlighted(code: str, language: str, _: str) -> str:
    """Returns the HTML of a block of code in Python; the others stay as they are, which an empty string says."""
    from pygments import highlight  # noqa: PLC0415 (the extras `docs` and `release` have it)
    from pygments.formatters import HtmlFormatter  # noqa: PLC0415
    from pygments.lexers import PythonLexer  # noqa: PLC0415

    return str(highlight(code, PythonLexer(), HtmlFormatter(nowrap=True))) if language == "python" else ""
