"""The site of the manual: SPEC.md by chapters, and a build without a warning."""

from __future__ import annotations

import importlib.util
import json
import re
from collections import Counter
from pathlib import Path

import pytest

from docs import chapters, vectors
from docs.__main__ import build
from docs.stage import ORDER, stage
from refcodec.bitstream.errors import REGISTRY
from refcodec.cli.main import GROUPS
from refcodec.inspect import specification

BUILDER = ("sphinx", "myst_parser", "furo")
# Of a requirement, of an error, and of a clause.
PERMANENT = rf"[RDGE]{specification.CLAUSE}-\d+|e\d+|{specification.CLAUSE}"


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
    names = {chapter.name for chapter in chapters.chapters()} | {"whole", "vectors"}
    assert pages == ordered | {f"spec/{name}" for name in names}
    for path in tmp_path.rglob("*.md"):
        bare = chapters.CODE.sub("", path.read_text(encoding="utf-8"))
        for place in re.findall(r"\]\(([^)#\s]+)", bare):
            assert "://" in place or (path.parent / place).is_file(), f"{path.name}: {place}"


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


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory, record: Path) -> Path:
    """The site, built without a warning."""
    if any(importlib.util.find_spec(name) is None for name in BUILDER):
        pytest.skip("the extra `docs` is not installed")
    folder = tmp_path_factory.mktemp("site")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("C3GS_COVERAGE", str(record))
        assert build(folder) == 0
    return folder


def _ids(page: Path) -> Counter[str]:
    return Counter(re.findall(r'<[^>]* id="([^"]*)"', page.read_text(encoding="utf-8")))


def _permanent(page: Path) -> Counter[str]:
    """The permanent anchors of a page, each as often as it is there."""
    ids = _ids(page)
    return Counter({name: ids[name] for name in ids if re.fullmatch(PERMANENT, name)})


@pytest.mark.slow
def test_permanent_anchors(site: Path) -> None:
    """Each clause, requirement and error has one anchor on the whole page and one on the pages of chapters."""
    spec = specification.text()
    stated = {*specification.requirements(spec), *(f"e{kind.code}" for kind in REGISTRY.values())}
    anchors = Counter({*stated, *specification.clauses(spec)})
    folder = site / "spec"
    assert _permanent(folder / "whole.html") == anchors
    pages = [_permanent(folder / f"{chapter.name}.html") for chapter in chapters.chapters()]
    assert sum(pages, Counter()) == anchors
    assert _permanent(folder / "vectors.html") == Counter(stated)
    for name in ("r6-7-1", "67-frame"):
        assert _ids(folder / "06-semantics-and-limits.html")[name] == _ids(folder / "whole.html")[name] == 1


@pytest.mark.slow
def test_links_of_the_specification_resolve(site: Path) -> None:
    """Among them those of each requirement and error to its vectors, on both kinds of pages, and back."""
    ids = {page: _ids(page) for page in (site / "spec").glob("*.html")}
    seen = set()
    for page in ids:
        for place, anchor in re.findall(r'href="([^"#:]*)#([^"]*)"', page.read_text(encoding="utf-8")):
            target = page if not place else (page.parent / place).resolve()
            if anchor and target in ids:
                assert ids[target][anchor] == 1, f"{page.name}: {place}#{anchor}"
                seen.add((page.name, target.name, anchor))
    assert max(ids[site / "spec" / "whole.html"].values()) == 1
    for name in vectors.by_name():
        home = chapters.page_of("103-registry" if name[0] == "e" else chapters.place_of(name))
        for page in ("whole.html", f"{home}.html"):
            assert (page, "vectors.html", name) in seen
        assert ("vectors.html", f"{home}.html", name) in seen


@pytest.mark.slow
def test_vectors_of_a_requirement(site: Path) -> None:
    text = (site / "spec" / "vectors.html").read_text(encoding="utf-8")
    part = text[text.index('id="R6.7-1"') : text.index('id="R6.7-2"')]
    assert len(re.findall("<tr><td>", part)) == len(vectors.by_name()["R6.7-1"]) > 1
    assert "<td>402 frame.reserved at " in part


@pytest.mark.slow
def test_blocks_show_the_vectors_of_their_lines(site: Path) -> None:
    """On both kinds of pages. The search still finds the names in blocks."""
    pages = {path.stem: path.read_text(encoding="utf-8") for path in (site / "spec").glob("*.html")}
    numbers = {name: len(re.findall(r'data-count="\w+"', page)) for name, page in pages.items()}
    assert numbers["07-decoding-process"] > 100
    assert 2 * numbers["whole"] == sum(numbers.values())
    for page in (pages["07-decoding-process"], pages["whole"]):
        assert ".reach::before" in page.partition("</head>")[0]
        assert '<details class="reached"><summary>' in page
    assert re.search(r'[{,]"?word_at"?:', (site / "searchindex.js").read_text(encoding="utf-8"))


@pytest.mark.slow
def test_the_search_works_offline(site: Path) -> None:
    """It finds requirements and errors. No page needs anything from elsewhere."""
    index = json.loads((site / "searchindex.js").read_text(encoding="utf-8").removeprefix("Search.setIndex(")[:-1])
    for words, page, anchor in (
        ("r6.7-1", "spec/06-semantics-and-limits", "R6.7-1"),
        ("frame.range", "spec/10-errors", "e401"),
        ("401", "spec/10-errors", "e401"),
    ):
        assert [[index["docnames"][n], name] for n, name, _ in index["indexentries"][words]] == [[page, anchor]]
    for path in site.rglob("*.html"):
        remote = re.findall(
            r'<(?:script|link|img|iframe)\b[^>]*?(?:src|href)="(?:https?:)?//[^"]*"', path.read_text("utf-8")
        )
        assert not remote, path.name
