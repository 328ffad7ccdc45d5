"""RESULTS.md, of which each benchmark writes a section."""

from __future__ import annotations

from pathlib import Path

RESULTS = Path(__file__).resolve().parent / "RESULTS.md"
HEADING = "# Measured results\n\nEach section holds the output of the command that it names; the command rewrites it.\n"


def write_section(name: str, title: str, lines: list[str]) -> None:
    """Replaces the section between its markers, or appends it; all other text stays."""
    begin, end = f"<!-- {name}: begin -->", f"<!-- {name}: end -->"
    text = RESULTS.read_text() if RESULTS.exists() else HEADING
    section = "\n".join([begin, f"## {title}", "", *lines, end])
    if begin in text and end in text:
        before, rest = text.split(begin, 1)
        text = before + section + rest.split(end, 1)[1]
    else:
        text = text.rstrip("\n") + "\n\n" + section + "\n"
    RESULTS.write_text(text)
