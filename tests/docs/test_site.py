"""The site of the manual: SPEC.md by chapters, and a build without a warning."""

from __future__ import annotations

import importlib.util
import re
from pathlib import Path

import pytest

from docs import chapters
from docs.__main__ import build
from docs.stage import ORDER, stage
from refcodec.inspect import specification

BUILDER = ("sphinx", "myst_parser", "furo")


def test_chapters_are_the_whole_specification() -> None:
    """Without the links that were put in, and with its levels of headings, each line is that of SPEC.md."""
    made = chapters.outside_code("".join(c.text for c in chapters.chapters()), _without_links)
    whole = specification.text()
    wanted = chapters.outside_code(
        whole[whole.index("\n## 1 ") + 1 :], lambda text: re.sub(r"^##", "#", text, flags=re.M)
    )
    assert made == wanted


def _without_links(text: str) -> str:
    text = re.sub(r"\[(\\\[)?([\w.-]+)(\\\])?\]\(SPEC\.md#[\w.-]+\)", _bracketed, text)
    return re.sub(r"\(\S+\)=\n  \*\*\\\[(\S+)\\\]\*\*", r"[\1]", text)


def _bracketed(found: re.Match[str]) -> str:
    return f"[{found[2]}]" if found[1] else found[2]


def test_references_to_clauses_are_links() -> None:
    """Also of ranges and lists. Figures with a point are none."""
    text = {chapter.name: chapter.text for chapter in chapters.chapters()}
    assert "[7.5.1](SPEC.md#751-frame) to [7.5.5](SPEC.md#755-positional-encoding)" not in text["01-scope"]
    assert "([10.3](SPEC.md#103-registry))" in text["02-conventions"]
    assert "(chapter [5](SPEC.md#5-syntax))" in text["01-scope"]
    assert "(chapters [7](SPEC.md#7-decoding-process) and [8](SPEC.md#8-entropy-coder))" in text["01-scope"]
    assert "[\\[R6.6-2\\]](SPEC.md#r6-6-2)" in text["12-extension-rules"]
    assert "- (r6-6-2)=\n  **\\[R6.6-2\\]** Each" in text["06-semantics-and-limits"]
    for figure in ("takes 2.5 KB instead", "takes 4.0 to 4.1 bits", "6.7 to 7.9."):
        assert figure in text["annex-c-rationale"]


def test_every_requirement_has_a_place() -> None:
    text = "".join(chapter.text for chapter in chapters.chapters())
    wanted = sorted(map(chapters.place_of, specification.requirements(specification.text())))
    assert sorted(re.findall(r"^- \((\S+)\)=$", text, re.MULTILINE)) == wanted
    assert set(re.findall(r"\]\(SPEC\.md#([rdg]\d[^)]+)\)", text)) <= set(wanted)


def test_staged_links_lead_somewhere(tmp_path: Path) -> None:
    """Every page is in the order of pages, and every link of one leads to a file of the site."""
    stage(tmp_path)
    pages = {path.relative_to(tmp_path).with_suffix("").as_posix() for path in tmp_path.rglob("*.md")}
    ordered = {page for _, part in ORDER for page in part} | {"index"}
    assert pages == ordered | {f"spec/{chapter.name}" for chapter in chapters.chapters()}
    for path in tmp_path.rglob("*.md"):
        bare = chapters.CODE.sub("", path.read_text(encoding="utf-8"))
        for place in re.findall(r"\]\(([^)#\s]+)", bare):
            assert "://" in place or (path.parent / place).is_file(), f"{path.name}: {place}"


@pytest.mark.slow
@pytest.mark.skipif(
    any(importlib.util.find_spec(name) is None for name in BUILDER), reason="the extra `docs` is not installed"
)
def test_the_site_is_built_without_a_warning(tmp_path: Path) -> None:
    assert build(tmp_path / "site") == 0
    page = (tmp_path / "site" / "spec" / "07-decoding-process.html").read_text(encoding="utf-8")
    assert 'href="06-semantics-and-limits.html#r6-8-4"' in page
    assert (tmp_path / "site" / "index.html").is_file()
