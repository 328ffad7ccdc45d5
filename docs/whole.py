"""SPEC.md on one page, joined from the pages of its chapters that Sphinx has made."""

from __future__ import annotations

import re
from pathlib import Path

from . import chapters

NAME = "whole"
TEXT = "\nThis page has all chapters. [Each has a page of its own](SPEC.md), too.\n"
_ARTICLE = re.compile(r'(<article role="main" id="furo-main-content">)(.*?)(</article>)', re.DOTALL)


def join(folder: Path) -> None:
    """Adds the chapters to the page. folder: of the pages of SPEC.md."""
    path = folder / f"{NAME}.html"
    page = path.read_text(encoding="utf-8")
    names = [chapter.name for chapter in chapters.chapters()]
    bodies = [_article((folder / f"{name}.html").read_text(encoding="utf-8"))[2] for name in names]
    found = _article(page)
    text = "".join([found[2], *bodies])
    # A link to another chapter stays on this page.
    text = re.sub(rf'(?<=href=")(?:{"|".join(names)})\.html(?=#)', "", text)
    path.write_text(f"{page[: found.end(1)]}{text}{page[found.start(3) :]}", encoding="utf-8")


def _article(page: str) -> re.Match[str]:
    found = _ARTICLE.search(page)
    if found is None:
        raise ValueError("a page of Sphinx without an article: its theme has changed")
    return found
