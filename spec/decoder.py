"""Makes the second decoder, conformance/spec_decoder/blocks.py, from the Python blocks and tables of SPEC.md."""

from __future__ import annotations

import re
from collections.abc import Iterator

from .made import ROOT, Made

SPEC = ROOT / "SPEC.md"
TARGET = ROOT / "conformance" / "spec_decoder" / "blocks.py"
HEAD = '''"""The Python blocks of SPEC.md: a decoder from the bytes of a file to its digests or its error.

`python -m spec` made this file from SPEC.md. Do not edit it.
"""
# mypy: ignore-errors
# ruff: noqa
# fmt: off

import math

from .support import ascii_bytes as ASCII
from .support import sha256 as SHA256
from .support import table_bytes
'''
TAIL = "\nSINE, STEP, GAUSS, LAPLACE = READ_TABLES(table_bytes())\n"
# Functions for clauses without a block, and these clauses.
CLAUSES = {
    "DECODE_SYMBOL": "8.2", "DECODE_VALUES": "8.6", "WORLD": "9.1", "DECODE_ATTRIBUTES": "7.7, 7.8, 7.9",
    "DECODE_FILE": "10.1, 15.4", "CHECK_DIRECTORY": "12.1, 13.1",
}  # fmt: skip
LEVEL = ("level", "anchor_count", "plane_size", "work")


def _rows(text: str, heading: str) -> list[list[str]]:
    """Returns the cells of the body rows of the first table under a heading."""
    lines = text.partition(f"\n{heading}")[2].splitlines()
    first = next(i for i, line in enumerate(lines) if line.startswith("|---"))
    last = next(i for i in range(first, len(lines)) if not lines[i].startswith("|"))
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines[first + 1 : last]]


def _number(text: str) -> str:
    return text.replace("^", "**")


def _bounds(text: str) -> Iterator[str]:
    """Yields BOUNDS of Annex H: for each profile (dimension, least, most) by the rows of 11.1's table."""
    rows = _rows(text, "### 11.1 ")
    yield "BOUNDS = ["
    for profile in (1, 2):
        yield "    ["
        for row in rows:
            low, _, high = row[profile].removeprefix("0, or ").partition(" to ")
            yield f'        ("{row[0]}", {low}, {high or low}),'
        yield "    ],"
    yield "]"


def _levels(text: str) -> Iterator[str]:
    yield "LEVELS = ["
    for profile, *numbers in _rows(text, "### 11.2 "):
        fields = ", ".join(f'"{name}": {_number(cell)}' for name, cell in zip(LEVEL, numbers, strict=True))
        yield f'    {{"profile": {("Tiny", "Main").index(profile)}, {fields}}},'
    yield "]"


def _errors(text: str) -> Iterator[str]:
    """Yields ERRORS: for each name its code, class, clause and meaning, by the rows of 10.3's table."""
    yield "ERRORS = {"
    for code, name, kind, _, clause, meaning, _ in _rows(text, "### 10.3 "):
        yield f'    "{name}": ({code}, "{kind}", "{clause}", "{meaning}"),'
    yield "}"


def module(text: str) -> str:
    """Returns the module. text: SPEC.md."""
    lines = [HEAD, "# SPEC 2.5"]
    lines += [f"{name} = {_number(value)}" for name, value, *_ in _rows(text, "### 2.5 ")]
    lines += ["", "# SPEC 10.3", *_errors(text), "", "# SPEC 11.1", *_bounds(text), "", "# SPEC 11.2", *_levels(text)]
    clause = ""
    for heading, block in re.findall(r"^(#{2,} [^\n]*)$|^```python\n(.*?)^```", text, re.DOTALL | re.MULTILINE):
        if heading:
            clause = heading.lstrip("# ").partition(":")[0].removeprefix("Annex ").split()[0]
        else:
            # Each function cites its clause, so that `refcodec explain` finds it.
            own = f"Annex {clause}" if clause.isalpha() else clause

            def cited(match: re.Match[str], own: str = own) -> str:
                return f"# SPEC {own}{', ' if match[2] in CLAUSES else ''}{CLAUSES.get(match[2], '')}\n{match[0]}"

            lines += ["", re.sub(r"^(def|class) (\w+)", cited, block.rstrip("\n"), flags=re.MULTILINE), ""]
    return "\n".join(lines).rstrip("\n") + "\n\n" + TAIL


def made() -> Iterator[Made]:
    """Yields the module."""
    yield Made.text(TARGET, module(SPEC.read_text(encoding="utf-8")))
