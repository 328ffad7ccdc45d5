"""RESULTS.md, of which each benchmark writes a section, and what sections have in common."""

from __future__ import annotations

import os
import platform
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

RESULTS = Path(__file__).resolve().parent / "RESULTS.md"
HEADING = "# Measured results\n\nEach section holds the output of the command that it names; the command rewrites it.\n"


def write_section(name: str, title: str, lines: Iterable[str]) -> None:
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


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """The lines of a Markdown table."""
    return ["| " + " | ".join(cells) + " |" for cells in (head, ["---"] * len(head), *rows)]


def machine(*packages: str) -> str:
    """What measured: processor, cores, and the versions of Python, NumPy and other packages."""
    versions = [f"Python {platform.python_version()}", f"numpy {np.__version__}"]
    versions += [f"{name} {__import__(name).__version__}" for name in packages]
    return f"{platform.machine()}, {os.cpu_count()} cores, {', '.join(versions)}."


def kb(value: float) -> str:
    """Bytes as 10^3 bytes."""
    return f"{value / 1000:.1f}"
