"""Runs SPEC.md's python blocks, which are a decoder together: from the bytes of a file to its digests or its error."""

from __future__ import annotations

import hashlib
import math
import re
from typing import Any

from refcodec.bitstream import tables


def blocks(text: str) -> dict[str, Any]:
    """Returns the names that the python blocks of SPEC.md define, with all that they use.

    These are the constants of 2.5, ASCII of 2.4, the tables of Annex A, the bounds and levels of chapter 11, and SHA256
    of 10.4.
    text: SPEC.md.
    """
    space: dict[str, Any] = {name: _number(value) for name, value, *_ in _rows(text, "### 2.5 ")}
    # The blocks of chapter 14 are of binary64, with Python's functions.
    space["math"] = math
    space["ASCII"] = lambda letters: list(letters.encode("ascii"))
    for block in re.findall(r"^```python\n(.*?)^```", text, re.DOTALL | re.MULTILINE):
        exec(compile(block, "SPEC.md", "exec"), space)
    data = list(tables.tables_file().read_bytes())
    space["SINE"], space["STEP"], space["GAUSS"], space["LAPLACE"] = space["READ_TABLES"](data)
    space["SHA256"] = lambda content: list(hashlib.sha256(bytes(content)).digest())
    space["BOUNDS"] = _bounds(text)
    space["LEVELS"] = [
        {"profile": ("Tiny", "Main").index(profile), **dict(zip(_LEVEL, map(_number, numbers), strict=True))}
        for profile, *numbers in _rows(text, "### 11.2 ")
    ]
    return space


_LEVEL = ("level", "anchor_count", "plane_size", "work")


def _number(text: str) -> Any:
    return eval(text.replace("^", "**"))


def _rows(text: str, heading: str) -> list[list[str]]:
    """Returns the cells of the rows of the first table under a heading, without those of its head."""
    lines = text.partition(f"\n{heading}")[2].splitlines()
    first = next(i for i, line in enumerate(lines) if line.startswith("|---"))
    last = next(i for i in range(first, len(lines)) if not lines[i].startswith("|"))
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines[first + 1 : last]]


def _bounds(text: str) -> list[list[tuple[str, int, int]]]:
    """Returns BOUNDS of 10.4: for each profile (dimension, least, most) by the rows of 11.1's table."""
    profiles: list[list[tuple[str, int, int]]] = [[], []]
    for name, *cells in _rows(text, "### 11.1 "):
        for bounds, cell in zip(profiles, cells, strict=True):
            low, _, high = cell.removeprefix("0, or ").partition(" to ")
            bounds.append((name, int(low), int(high or low)))
    return profiles


def decode(space: dict[str, Any], data: bytes) -> tuple[dict[str, Any] | None, tuple[str, int] | None]:
    """Decodes a file with SPEC.md's blocks. Returns what DECODE_FILE gives, or (name, offset) of the error.

    space: what `blocks` returns. The digests are lists of bytes: of the seven parts, of the scene, and of each chunk.
    """
    try:
        return space["DECODE_FILE"](list(data)), None
    except space["Refused"] as refused:
        name, offset = refused.args
        return None, (name, offset)
