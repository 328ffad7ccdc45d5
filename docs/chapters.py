"""SPEC.md on pages of its own, one for each chapter and annex, with links between its clauses.

Nothing is copied by hand: the pages are made from SPEC.md each time that the manual is built.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from itertools import pairwise

from refcodec.inspect import specification

# Code is left as it is: blocks, and words between backquotes.
CODE = re.compile(r"^ *```.*?^ *```$|`[^`\n]*`", re.DOTALL | re.MULTILINE)
# What comes before the number of a clause that is meant as one. Other numbers with a point are figures.
_BEFORE = r"(?:\(|\| |\b(?:[Cc]lauses?|[Cc]hapters?|of|in|by|that|which|see)\s|\bAnnex(?:es)?\s)"
_NUMBER = r"(?:\d+(?:\.\d+)*|[A-H](?:\.\d+)*)"
_REFERENCE = re.compile(rf"({_BEFORE})({_NUMBER}(?:(?:,\s|\sto\s|\sand\s|,\sand\s){_NUMBER})*)(?![\w.%*^]|\.\d)")
# A whole number is a chapter only behind these words, and not in "of 2".
_CHAPTER = re.compile(r"(?:[Cc]hapters?|Annex(?:es)?)\s$")
# Figures have units.
_UNIT = re.compile(r"\s(?:KB|MB|bytes?|bits?|times|%|s|dB|anchors)\b")
_REQUIREMENT = re.compile(rf"\[([RDGE]{specification.CLAUSE}-\d+)\](?!\()")


# What changes some Markdown.
Change = Callable[[str], str]


@dataclass(frozen=True)
class Chapter:
    """A chapter or an annex. name: of its page. text: its Markdown, with its heading as the title."""

    name: str
    text: str


def _page(part: str) -> str:
    """Returns the name of a chapter's page, such as 07-decoding-process or annex-a-tables. part: its Markdown."""
    heading = re.sub(r" \((?:normative|informative)\)$", "", part.partition("\n")[0].removeprefix("## "))
    words = specification.anchor(heading)
    number, _, name = words.partition("-")
    return f"{int(number):02d}-{name}" if number.isdigit() else words


@cache
def chapters() -> list[Chapter]:
    """Returns the chapters and annexes of SPEC.md in order. The links between clauses are those of SPEC.md itself."""
    found = []
    for part in _parts()[1:]:
        text = outside_code(outside_code(part, _linked), _raised)
        found.append(Chapter(_page(part), text))
    return found


def _raised(text: str) -> str:
    """Returns text with headings of one level less: a page begins with one of the first level."""
    return re.sub(r"^#(?=#)", "", text, flags=re.MULTILINE)


def introduction() -> str:
    """Returns what stands before the first chapter, without the table of chapters."""
    return re.sub(r"^\|.*\n", "", _parts()[0], flags=re.MULTILINE)


def page_of(anchor: str) -> str | None:
    """Returns the page that has a heading or a requirement of SPEC.md, or None. anchor: that of either."""
    return _anchors().get(anchor)


def _parts() -> list[str]:
    """Returns what stands before the first chapter, and each chapter with its heading."""
    text = specification.text()
    bare = CODE.sub(lambda block: re.sub(r"^#", " ", block[0], flags=re.MULTILINE), text)
    starts = [0, *(head.start() for head in re.finditer(r"^## ", bare, re.MULTILINE)), len(text)]
    return [text[start:end] for start, end in pairwise(starts)]


@cache
def _clauses() -> dict[str, str]:
    """The anchor of each clause by its number."""
    return {number: clause.anchor for number, clause in specification.clauses(specification.text()).items()}


@cache
def _anchors() -> dict[str, str]:
    """The page of each clause and of each requirement by its anchor."""
    found: dict[str, str] = {}
    for part in _parts()[1:]:
        found |= {clause.anchor: _page(part) for clause in specification.clauses(part).values()}
        found |= {place_of(name): _page(part) for name in specification.requirements(part)}
    return found


def outside_code(text: str, change: Change) -> str:
    """Returns a text of which all but the code was changed. change: told of the text with a mark for each code."""
    kept: list[str] = []

    def keep(code: re.Match[str]) -> str:
        kept.append(code[0])
        return f"\0{len(kept) - 1}\0"

    return re.sub(r"\0(\d+)\0", lambda place: kept[int(place[1])], change(CODE.sub(keep, text)))


def _linked(text: str) -> str:
    """Returns text with a link for each reference to a clause or a requirement."""
    lines = text.split("\n")
    # Headings have no links, and where a requirement is stated is what the others lead to.
    return "\n".join(line if line.startswith("#") else _line(line) for line in lines)


def _line(line: str) -> str:
    stated = re.match(r"- \[([RDGE]\S+)\] ", line)
    if stated:
        return f"- ({place_of(stated[1])})=\n  **\\[{stated[1]}\\]**{_line(line[len(stated[1]) + 4 :])}"
    line = _REFERENCE.sub(_numbers, line)
    return _REQUIREMENT.sub(lambda found: f"[\\[{found[1]}\\]](SPEC.md#{place_of(found[1])})", line)


def place_of(requirement: str) -> str:
    """Returns the anchor of a requirement, such as r6-7-1 for R6.7-1."""
    return requirement.lower().replace(".", "-")


def _numbers(found: re.Match[str]) -> str:
    """Returns references with links, such as those in "(5.1 to 5.5, and 6.2)"."""
    if _UNIT.match(found.string, found.end()):
        return found[0]
    chapter = bool(_CHAPTER.match(found[1]))

    def one(number: re.Match[str]) -> str:
        known = number[0] in _clauses() and (chapter or "." in number[0])
        return f"[{number[0]}](SPEC.md#{_clauses()[number[0]]})" if known else number[0]

    return found[1] + re.sub(_NUMBER, one, found[2])
