"""Writes the major version, which refcodec/bitstream/header.py defines, wherever else it stands."""

import re
from collections.abc import Iterator

from refcodec.bitstream.header import MAJOR

from .made import ROOT, Made

FILES = (
    *("refcodec/bitstream/header.py", "refcodec/__init__.py", "SPEC.md", "spec/c3gs.ksy"),
    *("refcodec/web/container.js", "refcodec/web/c3gs.js", "examples/plugin-js/container.js"),
    *("conformance/c/decoder.c", "conformance/manifest.py", "vectors/manifest.schema.json"),
)
# What stands before the number: a constant, a field of the manifest, or a title.
_BEFORE = (
    r"^\| MAJOR \| |MAJOR = |MAJOR, MINOR\]? = \[?|format_version: Literal\[|\"format_version\": \{\s+\"const\": "
    r"|[Ff]ormat version |\(SPEC\.md, version "
)


def made(major: int = MAJOR) -> Iterator[Made]:
    """Yields the files that state a major version, with this one. Raises SystemExit for a file that states none."""
    for name in FILES:
        stated = (ROOT / name).read_text(encoding="utf-8")
        text, count = re.subn(rf"({_BEFORE})\d+\b", rf"\g<1>{major}", stated, flags=re.MULTILINE)
        if not count:
            raise SystemExit(f"{name} does not state the major version")
        yield Made.text(ROOT / name, text)
