"""The pages of the site, put together in a folder from which Sphinx builds: the manual, SPEC.md, and other pages.

In the repository, links between Markdown files are paths, which code hosts follow. Here each becomes a link to the page
that is made of the file, or to a copy of the file.
"""

from __future__ import annotations

import os
import re
import shutil
from pathlib import Path

from . import chapters, commands, vectors, whole

ROOT = Path(__file__).resolve().parents[1]
MANUAL = ROOT / "docs"
# Other files of the repository that are pages of the site, and the names of these.
PAGES = {
    "conformance/README.md": "more/conformance",
    "implementations/README.md": "more/implementations",
    "implementations/MATRIX.md": "more/matrix",
    "vectors/README.md": "more/vectors",
    "refcodec/viewer/README.md": "more/viewer",
    "refcodec/web/README.md": "more/web",
    "benchmarks/RESULTS.md": "more/results",
    "ARCHITECTURE.md": "more/architecture",
    "CONTRIBUTING.md": "more/contributing",
    "CHANGELOG.md": "more/changelog",
    "SECURITY.md": "more/security",
}
_CONTENTS = """
```{{toctree}}
:hidden:
:maxdepth: {depth}
:caption: {caption}

{pages}
```
"""
# The place of the commands in their page.
_COMMANDS = "<!-- commands -->\n"
# The pages of the manual in their order.
ORDER = (
    ("First steps", ("first-steps", "look-inside", "commands", "python", "python-names")),
    ("By job", ("photographs", "method", "models", "page", "programs", "comparison", "decoder", "certify", "extend")),
    ("Specification", ("specification", "spec/index")),
    ("More", tuple(PAGES.values())),
)
# Languages of code blocks that the highlighter does not know, or reads more strictly than they are meant.
_PLAIN = re.compile(r"^( *```)(?:mermaid|jsonc?)$", re.MULTILINE)
# Brackets within the words are escaped: an interval such as [0, 1) in the text before must not begin a link.
_LINK = re.compile(r"(!?\[(?:\\.|[^\[\]\\])*\])\(([^)\s]+)\)", re.DOTALL)


def stage(folder: Path) -> None:
    """Fills an empty folder with the pages of the site, and what they show and lead to."""
    shutil.copytree(MANUAL / "pictures", folder / "pictures", ignore=shutil.ignore_patterns("README.md"))
    for path in sorted(MANUAL.glob("*.md")):
        text = path.read_text(encoding="utf-8").replace(_COMMANDS, commands.sections())
        _write(folder, path.stem, text + _contents() if path.stem == "index" else text, path)
    for name, page in PAGES.items():
        _write(folder, page, (ROOT / name).read_text(encoding="utf-8"), ROOT / name)
    pages = "\n".join([*(chapter.name for chapter in chapters.chapters()), f"One page <{whole.NAME}>", "vectors"])
    contents = _CONTENTS.format(depth=2, caption="Chapters", pages=pages)
    _write(folder, "spec/index", chapters.introduction() + contents, ROOT / "SPEC.md")
    for chapter in chapters.chapters():
        _write(folder, f"spec/{chapter.name}", chapter.text, ROOT / "SPEC.md")
    _write(folder, f"spec/{whole.NAME}", chapters.introduction() + whole.TEXT, ROOT / "SPEC.md")
    _write(folder, "spec/vectors", vectors.page(), MANUAL / "specification.md")


def _contents() -> str:
    return "".join(_CONTENTS.format(depth=1, caption=caption, pages="\n".join(pages)) for caption, pages in ORDER)


def _write(folder: Path, page: str, text: str, source: Path) -> None:
    """Writes a page. text: Markdown with links as in its source. source: the file that it is made of."""
    path = folder / f"{page}.md"
    path.parent.mkdir(parents=True, exist_ok=True)

    def relinked(link: re.Match[str]) -> str:
        target = _target(link[2], source, folder)
        if target is None:
            # A folder has no page. Its name stays.
            return link[1][1:-1]
        return f"{link[1]}({target if isinstance(target, str) else _relative(*target, path.parent)})"

    text = chapters.outside_code(_PLAIN.sub(r"\1text", text), lambda words: _LINK.sub(relinked, words))
    path.write_text(text, encoding="utf-8")


def _relative(target: Path, anchor: str, folder: Path) -> str:
    return Path(os.path.relpath(target, folder)).as_posix() + (f"#{anchor}" if anchor else "")


def _target(link: str, source: Path, folder: Path) -> str | tuple[Path, str] | None:
    """Returns what a link of a file leads to: itself, a file of the site with an anchor, or None for a folder."""
    place, _, anchor = link.partition("#")
    own = source == ROOT / "SPEC.md"
    if "://" in link or link.startswith("mailto:") or (not place and not (own and chapters.page_of(anchor))):
        return link
    path = Path(os.path.normpath(source.parent / place)) if place else source
    if path == ROOT / "SPEC.md":
        page = chapters.page_of(anchor)
        return folder / "spec" / (f"{page}.md" if page else "index.md"), anchor if page else ""
    if path == ROOT / "README.md":
        return folder / "index.md", ""
    if path.parent == MANUAL and path.suffix == ".md":
        return folder / path.name, anchor
    name = path.relative_to(ROOT).as_posix()
    if name in PAGES:
        return folder / f"{PAGES[name]}.md", anchor
    if path.is_relative_to(MANUAL / "pictures"):
        return folder / path.relative_to(MANUAL), ""
    if path.is_dir():
        return None
    # What is no page is a file to download. Sphinx would make a page of Markdown.
    copy = folder / "files" / (f"{name}.txt" if path.suffix == ".md" else name)
    copy.parent.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(path, copy)
    return copy, ""
