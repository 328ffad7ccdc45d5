"""Every link in a Markdown file leads to an existing file and heading, and lines of prose are not too long."""

import os
import re
from collections import Counter
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
# What is made, installed or kept beside the project's own files.
_NOT_OURS = {"build", "dist", "out", "node_modules"}
_FENCE = re.compile(r"^ *(`{3,}).*?^ *\1 *$", re.DOTALL | re.MULTILINE)
_LINK = re.compile(r"\]\(([^)\s]+)(?: \"[^\"]*\")?\)|<(?:img|a|source)\b[^>]*?\b(?:src|href|srcset)=\"([^\"]+)\"")


def markdown_files() -> list[Path]:
    paths = []
    for folder, folders, files in os.walk(ROOT):
        folders[:] = [name for name in folders if not name.startswith(".") and name not in _NOT_OURS]
        paths += [Path(folder, name) for name in files if name.endswith(".md")]
    return sorted(paths)


def links(text: str) -> list[str]:
    """The targets of a text's links. Those in code are none."""
    bare = re.sub(r"`[^`\n]*`", "code", _FENCE.sub("", text))
    return [link or source for link, source in _LINK.findall(bare)]


def anchors(text: str) -> set[str]:
    """The anchors that code hosts give the headings of a text."""
    counts: Counter[str] = Counter()
    anchors = set()
    for heading in re.findall(r"^#{1,6} +(.*?) *#*$", _FENCE.sub("", text), re.MULTILINE):
        words = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading)
        name = re.sub(r"[^\w\- ]", "", words.lower()).replace(" ", "-")
        anchors.add(f"{name}-{counts[name]}" if counts[name] else name)
        counts[name] += 1
    return anchors


@cache
def _anchors_of(path: Path) -> set[str]:
    return anchors(path.read_text(encoding="utf-8"))


def wrong(path: Path, text: str) -> list[str]:
    """The links of a file that lead nowhere."""
    broken = []
    for link in links(text):
        place, _, anchor = link.partition("#")
        if re.match(r"[a-z]+:", place):
            continue
        target = (path.parent / place).resolve() if place else path
        inside = target.is_relative_to(ROOT) and target.exists()
        if not inside or (anchor and target.suffix == ".md" and anchor not in _anchors_of(target)):
            broken.append(link)
    return broken


@pytest.mark.parametrize("path", markdown_files(), ids=lambda path: path.relative_to(ROOT).as_posix())
def test_links_lead_somewhere(path: Path) -> None:
    assert wrong(path, path.read_text(encoding="utf-8")) == []


def test_a_wrong_link_is_seen() -> None:
    right = (
        "[a](../README.md) [b](../SPEC.md#67-frame) `[no](link)` [`c`](index.md) ![d](pictures/)\n```\n[x](y)\n```\n"
    )
    bad = ["none.md", "../SPEC.md#68-frame", "../../elsewhere.md", "#none", "picture.png"]
    text = right + " ".join(f"[w]({link})" for link in bad[:4]) + f'<img alt="p" src="{bad[4]}">'
    assert wrong(ROOT / "docs" / "index.md", text) == bad
    assert anchors("# `a_b` c: d\n## x\n## x\n```\n# no\n```\n") == {"a_b-c-d", "x", "x-1"}


def test_prose_has_at_most_120_columns() -> None:
    """The hook `columns` of .pre-commit-config.yaml, over all files."""
    hook = (ROOT / ".pre-commit-config.yaml").read_text(encoding="utf-8").partition("- id: columns")[2]
    too_long, left_out = (re.findall(rf"^ +{key}: '?(.+?)'?$", hook, re.MULTILINE)[0] for key in ("entry", "exclude"))
    assert re.match(too_long, "word " * 25)
    assert [
        f"{path}:{number}"
        for path in markdown_files()
        if not re.search(left_out, path.relative_to(ROOT).as_posix())
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1)
        if re.match(too_long, line)
    ] == []


def test_every_picture_has_its_command() -> None:
    page = (ROOT / "docs" / "pictures" / "README.md").read_text(encoding="utf-8")
    for path in (ROOT / "docs" / "pictures").glob("*.[jp]*g"):
        assert f"| [{path.name}]({path.name}) | `" in page
        assert path.stat().st_size < 200_000
