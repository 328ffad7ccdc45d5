"""The Python blocks and tables of SPEC.md as one program. Its lines have the numbers that they have in SPEC.md."""

import math
import os
import re
import zlib
from collections.abc import Callable, Iterator
from importlib.machinery import SourceFileLoader
from types import CodeType, ModuleType
from typing import Any

from . import support

Names = dict[str, Any]

NAME = f"{__package__}.blocks"
# The place of SPEC.md in an installed package, and in a checkout (refcodec/resources.py).
SPEC = next(place for place in (support.DATA / "SPEC.md", support.DATA.parents[1] / "SPEC.md") if place.is_file())
LEVEL = ("level", "anchor_count", "plane_size", "work")


TAIL = "\nSINE, STEP, GAUSS, LAPLACE = READ_TABLES(table_bytes())\n"


def _number(cell: str) -> str:
    return cell.replace("^", "**")


def _bound(name: str, cell: str) -> str:
    low, _, high = cell.removeprefix("0, or ").partition(" to ")
    return f'("{name}", {low}, {high or low})'


# SPEC 2.5
def _constant(name: str, value: str, *_: str) -> str:
    return f"{name} = {_number(value)}"


# SPEC 10.3: for each name its code, class, clause and meaning. The identifier of the requirement has the clause.
def _error(code: str, name: str, kind: str, requirement: str, meaning: str, _: str) -> str:
    clause = requirement.strip("[R]").partition("-")[0]
    return f'"{name}": ({code}, "{kind}", "{clause}", "{meaning}"),'


# SPEC 11.1: for each profile its dimensions, each with the least and the largest value
def _dimension(name: str, *cells: str) -> str:
    return f"({', '.join(_bound(name, cell) for cell in cells)}),"


# SPEC 11.2
def _level(profile: str, *cells: str) -> str:
    fields = ", ".join(f'"{name}": {_number(cell)}' for name, cell in zip(LEVEL, cells, strict=True))
    return f'{{"profile": {("Tiny", "Main").index(profile)}, {fields}}},'


# Of the clauses whose first table is part of the program: its beginning, a row, and its end.
TABLES: dict[str, tuple[str, Callable[..., str], str]] = {
    "2.5": ("", _constant, ""),
    "10.3": ("ERRORS = {", _error, "}"),
    "11.1": ("BOUNDS = list(zip(*[", _dimension, "]))"),
    "11.2": ("LEVELS = [", _level, "]"),
}


def _lines(text: str) -> Iterator[str]:
    """Yields a line of the program for each line of SPEC.md: an empty one for a line of prose."""
    in_block, table, row = False, None, None
    for line in text.splitlines():
        made = ""
        if line.startswith("```"):
            in_block = line == "```python"
        elif in_block:
            made = line
        elif heading := re.match(r"#+ (\S+)", line):
            table = TABLES.get(heading[1])
        elif table and line.startswith("|---"):
            made, row, end = table
            table = None
        elif row and line.startswith("|"):
            made = row(*(cell.strip() for cell in line.strip("|").split("|")))
        elif row:
            # Behind the last row.
            made, row = end, None
        yield made


def source(text: str) -> str:
    """Returns the program. text: SPEC.md."""
    return "\n".join(_lines(text)) + TAIL


class _Loader(SourceFileLoader):
    """Compiles the program of SPEC.md, and keeps its code as Python keeps that of a module."""

    def source_to_code(self, data: Any, path: Any) -> CodeType:  # type: ignore[override]
        """Returns the code of the program. data: SPEC.md."""
        return compile(source(data.decode("utf-8")), path, "exec", dont_inherit=True)

    def path_stats(self, path: str) -> dict[str, int]:
        """Returns the size of SPEC.md and, instead of its time, a number that changes with it and with this module."""
        stats = [os.stat(file) for file in (path, __file__)]
        times = repr([(own.st_mtime_ns, own.st_size) for own in stats])
        return {"mtime": zlib.crc32(times.encode()), "size": stats[0].st_size}


def code() -> CodeType:
    """Returns the compiled program."""
    compiled = _Loader(NAME, str(SPEC)).get_code(NAME)
    assert compiled is not None
    return compiled


def module(program: CodeType | None = None, **more: Any) -> ModuleType:
    """Returns a new copy of the program as a module.

    program: a changed one, or None. more: names that it uses besides. Raises whatever it raises when it is executed.
    """
    made = ModuleType(NAME, __doc__)
    vars(made).update(math=math, ASCII=support.ascii_bytes, SHA256=support.sha256, table_bytes=support.table_bytes)
    vars(made).update(more)
    exec(program or code(), vars(made))
    return made


def names(program: CodeType | None = None, **more: Any) -> Names:
    """Returns the names of a new copy of the program, in the dictionary that its functions use. They may be replaced.

    They are those of the Python blocks of SPEC.md, the constants of 2.5, the errors of 10.3, the profiles and levels of
    chapter 11, and the tables of Annex A. Arguments and errors are those of `module`.
    """
    return vars(module(program, **more))


blocks: Any = module()
