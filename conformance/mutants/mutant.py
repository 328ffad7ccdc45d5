"""A planted bug, and the text that it is planted in: the blocks of SPEC.md."""

from __future__ import annotations

import ast
from dataclasses import dataclass
from functools import cache

from ..spec_decoder.program import SPEC, source

PATH = str(SPEC)


@dataclass(frozen=True)
class Mutant:
    """A wrong decoder: the blocks of SPEC.md with one change.

    place: the function or constant that is changed. line: where the change begins in the blocks. old, new: the text
    there. source: the changed text of all blocks. requirements: those of SPEC.md that it breaks, if a person chose it.
    """

    id: str
    place: str
    line: int
    old: str
    new: str
    what: str
    source: str
    requirements: tuple[str, ...] = ()

    @property
    def statement(self) -> str:
        """The changed text of the function or constant."""
        first, end = span(definitions()[self.place])
        return self.source[first : end + len(self.source) - len(text())]


@cache
def text() -> str:
    """Returns the text of the blocks."""
    return source(SPEC.read_text(encoding="utf-8"))


@cache
def definitions() -> dict[str, ast.stmt]:
    """Returns the functions and constants of the blocks that decode: those that DECODE_FILE uses, directly or not.

    A statement that defines several names is under the first one.
    """
    names: dict[str, tuple[str, ast.stmt]] = {}
    for statement in ast.parse(text()).body:
        if isinstance(statement, ast.FunctionDef):
            names[statement.name] = statement.name, statement
        elif isinstance(statement, ast.Assign):
            own = [node.id for node in ast.walk(statement.targets[0]) if isinstance(node, ast.Name)]
            names |= dict.fromkeys(own, (own[0], statement))
    used: dict[str, ast.stmt] = {}
    waiting = ["DECODE_FILE"]
    while waiting:
        name, statement = names[waiting.pop()]
        if name not in used:
            used[name] = statement
            waiting += [n.id for n in ast.walk(statement) if isinstance(n, ast.Name) and n.id in names]
    return dict(sorted(used.items(), key=lambda item: item[1].lineno))


def span(node: ast.stmt | ast.expr) -> tuple[int, int]:
    """Returns the first and the last character of a node in the blocks, the last one excluded. The blocks are ASCII."""
    assert node.end_lineno is not None
    assert node.end_col_offset is not None
    return _lines()[node.lineno - 1] + node.col_offset, _lines()[node.end_lineno - 1] + node.end_col_offset


@cache
def _lines() -> list[int]:
    lengths = [len(line) for line in text().splitlines(keepends=True)]
    return [sum(lengths[:n]) for n in range(len(lengths))]
