"""The pages of the site, put together in a folder from which Sphinx builds: the manual, and other pages.

In the repository, links between Markdown files are paths, which code hosts follow. Here each becomes a link to the page
that is made of the file, or to a copy of the file.
"""

from __future__ import annotations

import os
import re
import shutil
from pathlib import Path

from . import commands, document

ROOT = Path(__file__).resolve().parents[1]
MANUAL = ROOT / "docs"
# SPEC.md, beside the pages.
SPEC_PAGE = "spec.html"
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
:maxdepth: 1
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
    ("Specification", ("specification",)),
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


def _contents() -> str:
    return "".join(_CONTENTS.format(caption=caption, pages="\n".join(pages)) for caption, pages in ORDER)


def _write(folder: Path, page: str, text: str, source: Path) -> None:
    """Writes a page. text: Markdown with links as in its source. source: the file that it is made of."""
    path = folder / f"{page}.md"
    path.parent.mkdir(parents=True, exist_ok=True)

    def relinked(link: re.Match[str]) -> str:
        place, _, anchor = link[2].partition("#")
        if "://" in link[2] or link[2].startswith("mailto:") or not place:
            return link[0]
        target = Path(os.path.normpath(source.parent / place))
        if target == ROOT / "SPEC.md":
            # Sphinx knows only pages of its own.
            home = _relative(folder / SPEC_PAGE, document.permanent().get(anchor, anchor), path.parent)
            return f'<a href="{home}">{link[1][1:-1]}</a>'
        # A folder has no page. Its name stays.
        found = None if target.is_dir() else _target(target, anchor, folder)
        return f"{link[1]}({_relative(*found, path.parent)})" if found else link[1][1:-1]

    text = document.outside_code(_PLAIN.sub(r"\1text", text), lambda words: _LINK.sub(relinked, words))
    path.write_text(text, encoding="utf-8")


def _relative(target: Path, anchor: str, folder: Path) -> str:
    return Path(os.path.relpath(target, folder)).as_posix() + (f"#{anchor}" if anchor else "")


def _target(path: Path, anchor: str, folder: Path) -> tuple[Path, str]:
    """Returns the file of the site that a file of the repository becomes, and the anchor in it."""
    if path == ROOT / "README.md":
        return folder / "index.md", ""
    if path.parent == MANUAL and path.suffix == ".md":
        return folder / path.name, anchor
    name = path.relative_to(ROOT).as_posix()
    if name in PAGES:
        return folder / f"{PAGES[name]}.md", anchor
    if path.is_relative_to(MANUAL / "pictures"):
        return folder / path.relative_to(MANUAL), ""
    # What is no page is a file to download. Sphinx would make a page of Markdown.
    copy = folder / "files" / (f"{name}.txt" if path.suffix == ".md" else name)
    copy.parent.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(path, copy)
    return copy, ""
