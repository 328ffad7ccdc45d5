"""A planted bug, and the text that it is planted in: the blocks of SPEC.md."""

import ast
import hashlib
import re
from collections import Counter
from dataclasses import dataclass
from functools import cache

from ..spec_decoder.program import SPEC, source

PATH = str(SPEC)


@dataclass(frozen=True)
class Mutant:
    """A wrong decoder: the blocks of SPEC.md with one change.

    place: the function or constant that is changed. line: of SPEC.md, where the change begins. old, new: the text
    there. source: the changed text of all blocks. requirements: those of SPEC.md that it breaks.
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

    @property
    def tree(self) -> tuple[str, str]:
        """The place and its syntax tree, as text: mutants with the same ones are the same decoder."""
        return self.place, ast.dump(ast.parse(self.statement))


def planted(
    name: str, place: str, at: tuple[int, int], new: str, what: str, requirements: tuple[str, ...] = ()
) -> Mutant:
    """Returns the mutant with a new text at a span of characters."""
    first, end = at
    line = text()[:first].count("\n") + 1
    return Mutant(name, place, line, text()[first:end], new, what, text()[:first] + new + text()[end:], requirements)


class Names:
    """Gives the mutants of operators names that depend on the change only, and not on other changes of the blocks."""

    def __init__(self, seed: str) -> None:
        self._seed, self._times = seed, Counter[str]()

    def name(self, scope: str, operator: str, old: str, new: str) -> str:
        """Returns the name of a change in a function. Equal changes of one function are counted."""
        key = f"{scope}\n{operator}\n{old}\n{new}"
        self._times[key] += 1
        digest = hashlib.sha256(f"{self._seed}\n{key}\n{self._times[key]}".encode()).hexdigest()
        return f"{scope}-{operator}-{digest[:8]}"


@cache
def text() -> str:
    """Returns the text of the blocks."""
    return source(SPEC.read_text(encoding="utf-8"))


@cache
def _statements() -> dict[str, tuple[str, ast.stmt]]:
    """Returns the functions and constants of the blocks by their names, each with the first name of its statement."""
    names: dict[str, tuple[str, ast.stmt]] = {}
    for statement in ast.parse(text()).body:
        if isinstance(statement, ast.FunctionDef):
            names[statement.name] = statement.name, statement
        elif isinstance(statement, ast.Assign):
            own = [node.id for node in ast.walk(statement.targets[0]) if isinstance(node, ast.Name)]
            names |= dict.fromkeys(own, (own[0], statement))
    return names


def _used(waiting: list[str]) -> dict[str, ast.stmt]:
    """Returns the functions and constants that the named ones use, directly or not, and these."""
    used: dict[str, ast.stmt] = {}
    while waiting:
        name, statement = _statements()[waiting.pop()]
        if name not in used:
            used[name] = statement
            waiting += [n.id for n in ast.walk(statement) if isinstance(n, ast.Name) and n.id in _statements()]
    return used


@cache
def definitions() -> dict[str, ast.stmt]:
    """Returns the functions and constants of the blocks that decode: those that DECODE_FILE uses, directly or not.

    A statement that defines several names is under the first one.
    """
    return dict(sorted(_used(["DECODE_FILE"]).items(), key=lambda item: item[1].lineno))


@cache
def used_at_load() -> set[str]:
    """Returns the functions and constants without which the blocks cannot be loaded: constants are made of them."""
    constants = [statement for _, statement in _statements().values() if isinstance(statement, ast.Assign)]
    names = [n.id for each in constants for n in ast.walk(each.value) if isinstance(n, ast.Name)]
    return set(_used([name for name in names if name in _statements()]))


@cache
def demanded() -> tuple[dict[str, str], dict[str, tuple[str, ...]]]:
    """Returns the requirement of each error, and the requirements that name each function."""
    spec = SPEC.read_text(encoding="utf-8")
    of_errors = dict(re.findall(r"^\| \d+ \| ([\w.]+) \| \w+ \| \[(R[\d.]+-\d+)\]", spec, re.MULTILINE))
    of_functions: dict[str, tuple[str, ...]] = {}
    for name, words in re.findall(r"^- \[(D[789][\d.]*-\d+)\]((?:.|\n(?!- |\n))*)", spec, re.MULTILINE):
        for word in set(re.findall(r"\b[A-Z][A-Z0-9_]+\b", words)) & set(definitions()):
            of_functions[word] = (*of_functions.get(word, ()), name)
    return of_errors, of_functions


@cache
def around(place: str) -> frozenset[str]:
    """Returns the requirements of a function's errors and those that name it, or else those of its nearest users."""
    of_errors, of_functions = demanded()
    words = {
        name: {getattr(n, "value", getattr(n, "id", None)) for n in ast.walk(s)} for name, s in definitions().items()
    }
    near, done, broken = {place}, set[str](), set[str]()
    while near and not broken:
        for name in near:
            broken.update(of_functions.get(name, ()), (of_errors[word] for word in of_errors if word in words[name]))
        done |= near
        near = {user for user in words if near & words[user]} - done
    return frozenset(broken)


def span(node: ast.AST) -> tuple[int, int]:
    """Returns the first and the last character of a node in the blocks, the last one excluded. The blocks are ASCII."""
    assert isinstance(node, ast.stmt | ast.expr)
    assert node.end_lineno is not None
    assert node.end_col_offset is not None
    return _lines()[node.lineno - 1] + node.col_offset, _lines()[node.end_lineno - 1] + node.end_col_offset


@cache
def _lines() -> list[int]:
    starts = [0]
    for line in text().splitlines(keepends=True):
        starts.append(starts[-1] + len(line))
    return starts
