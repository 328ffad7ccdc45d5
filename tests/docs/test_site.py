"""The site of the manual: SPEC.md on one page, and a build without a warning."""

from __future__ import annotations

import importlib.util
import re
from collections import Counter
from html import unescape
from pathlib import Path

import pytest

from docs import document
from docs.stage import ORDER, ROOT, SPEC_PAGE, stage
from refcodec.bitstream.errors import REGISTRY
from refcodec.cli.main import GROUPS
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


def test_staged_links_lead_somewhere(tmp_path: Path) -> None:
    """Every page is in the order of pages, and every link of one leads to a file of the site, or into SPEC.md."""
    stage(tmp_path)
    pages = {path.relative_to(tmp_path).with_suffix("").as_posix() for path in tmp_path.rglob("*.md")}
    assert pages == {page for _, part in ORDER for page in part} | {"index"}
    for path in tmp_path.rglob("*.md"):
        bare = document.CODE.sub("", path.read_text(encoding="utf-8"))
        for place in re.findall(r"\]\(([^)#\s]+)", bare):
            assert "://" in place or (path.parent / place).is_file(), f"{path.name}: {place}"
        for place, anchor in re.findall(r'<a href="([^"#]*)#?([^"]*)">', bare):
            assert (path.parent / place).resolve() == tmp_path / SPEC_PAGE
            assert anchor in {"", *ANCHORS}, f"{path.name}: {anchor}"


def test_the_page_of_commands(tmp_path: Path) -> None:
    """It has the help of every command, whatever the terminal."""
    stage(tmp_path)
    text = (tmp_path / "commands.md").read_text(encoding="utf-8")
    heads = re.findall(r"^## (.+)$", text, re.MULTILINE)
    assert {f"refcodec {name}" for names in GROUPS.values() for name in names} < set(heads)
    assert "conformance run" in heads
    assert len(re.findall(r"^usage: ", text, re.MULTILINE)) == len(heads)
    assert "<!--" not in text
    assert max(map(len, text.splitlines())) <= 120


@pytest.mark.slow
def test_the_site_is_built_without_a_warning(tmp_path: Path) -> None:
    """No page needs anything from elsewhere."""
    if any(importlib.util.find_spec(name) is None for name in BUILDER):
        pytest.skip("the extra `docs` is not installed")
    from docs.__main__ import build  # noqa: PLC0415

    assert build(tmp_path) == 0
    assert (tmp_path / SPEC_PAGE).is_file()
    for path in tmp_path.rglob("*.html"):
        text = path.read_text("utf-8")
        assert not re.findall(r'<(?:script|link|img|iframe)\b[^>]*?(?:src|href)="(?:https?:)?//[^"]*"', text), path.name
