"""The site of the manual: SPEC.md on one page, and a build without a warning."""

import importlib.util
import os
import re
from collections import Counter
from html import unescape
from pathlib import Path

import pytest

from docs import commands, document
from docs.__main__ import ROOT, SPEC_PAGE, build
from refcodec.bitstream.errors import REGISTRY
from refcodec.cli.parser import GROUPS
from refcodec.inspect import specification

BUILDER = ("sphinx", "myst_parser", "furo")
SPEC = specification.text()
# Those of requirements, errors and clauses.
ANCHORS = {*specification.requirements(SPEC), *specification.clauses(SPEC), *(f"e{e.code}" for e in REGISTRY.values())}


@pytest.fixture(scope="module")
def page() -> str:
    """The page of SPEC.md."""
    pytest.importorskip("markdown_it")
    pytest.importorskip("pygments")
    return document.page({"Commit": "<x>"}, ROOT)


def test_the_page_has_each_anchor_once(page: str) -> None:
    """Every link on it leads to one of them, and it needs no other file."""
    assert Counter(re.findall(r'<[^>]* id="([^"]*)"', page)) == Counter(ANCHORS)
    targets = re.findall(r'href="(.*?)"', page)
    assert {target for target in targets if not target.startswith(("https:", "mailto:"))} <= {f"#{a}" for a in ANCHORS}
    assert set(re.findall(r'src="([^:]*):', page)) == {"data"}
    assert "<tr><th>Commit</th><td><code>&lt;x&gt;</code></td></tr>" in page


def test_the_page_has_the_words_of_the_specification(page: str) -> None:
    """Each block of code in its order, and each paragraph of plain words."""
    words = unescape(re.sub(r"<[^>]+>", "", page))
    at = 0
    for block in re.findall(r"^```\w*\n(.*?)^```$", SPEC, re.DOTALL | re.MULTILINE):
        at = words.index(block, at)
    paragraphs = [part for part in SPEC.split("\n\n") if re.fullmatch(r"[A-Z][^|`*\[\]<>]+", part)]
    assert len(paragraphs) > 100
    assert [part for part in paragraphs if part not in words] == []


def test_references_to_clauses_are_links() -> None:
    """Also of ranges and lists. Figures with a point are none."""
    for text, links in (
        ("follows (7.5.1 to 7.5.5)", "follows ([7.5.1](#7.5.1) to [7.5.5](#7.5.5))"),
        ("in chapters 7 and 8", "in chapters [7](#7) and [8](#8)"),
        ("## 7 Decoding of 7.1", "## 7 Decoding of 7.1"),
        ("as [R6.6-2] says", "as [\\[R6.6-2\\]](#R6.6-2) says"),
        ("- [R6.6-2] Each, by 6.6", '- <a id="R6.6-2"></a>**[R6.6-2](#R6.6-2)** Each, by [6.6](#6.6)'),
        ("takes 2.5 KB, of 4.0 to 4.1 bits", "takes 2.5 KB, of 4.0 to 4.1 bits"),
        ("one of 2, and 99.9", "one of 2, and 99.9"),
    ):
        assert document.linked(text) == links


def test_the_page_of_commands() -> None:
    """It has the help of every command, whatever the terminal."""
    text = commands.sections()
    heads = re.findall(r"^## (.+)$", text, re.MULTILINE)
    assert {f"refcodec {name}" for names in GROUPS.values() for name in names} < set(heads)
    assert "conformance run" in heads
    assert len(re.findall(r"^usage: ", text, re.MULTILINE)) == len(heads)
    assert max(map(len, text.splitlines())) <= 120


@pytest.mark.slow
def test_the_site_is_built_without_a_warning(tmp_path: Path) -> None:
    """Every link leads to a file and an anchor of the site, and no page needs anything from elsewhere."""
    if any(importlib.util.find_spec(name) is None for name in BUILDER):
        pytest.skip("the extra `docs` is not installed")
    assert build(tmp_path) == 0
    pages = {path: path.read_text("utf-8") for path in tmp_path.rglob("*.html")}
    ids = {path: set(re.findall(r' id="([^"]*)"', text)) for path, text in pages.items()}
    for path, text in pages.items():
        assert not re.findall(r'<(?:script|link|img|iframe)\b[^>]*?(?:src|href)="(?:https?:)?//[^"]*"', text), path.name
        for place, anchor in re.findall(r'href="([^"#:?]*)[^"#:]*#?([^":]*)"', text):
            target = Path(os.path.normpath(path.parent / place)) if place else path
            assert target.exists(), f"{path.name}: {place}"
            assert not anchor or anchor in ids.get(target, anchor), f"{path.name}: {place}#{anchor}"
    for name in ("SPEC.html", SPEC_PAGE, "docs/commands.html"):
        assert tmp_path / name in pages
