"""Where in the second decoder a planted bug is: its statements, the clauses that they cite, and who runs them."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterable, Iterator
from functools import cache

from refcodec.bitstream.errors import REGISTRY
from refcodec.inspect.specification import clause_of, own_requirements

from .mutant import MODULES, Mutant, text_of

# In the order in which a file comes through them: what is wrong in one hides what is wrong in a later one.
STAGES = (
    ("header", "syntax", "dimensions", "limits", "directory"),
    ("conventions", "errors", "tables", "codec"),
    ("frame",),
    ("entropy",),
    ("weights", "networks"),
    ("planes",),
    ("index",),
    ("chunks",),
    ("positions",),
    ("masks",),
    ("context",),
    ("attributes",),
    ("scene", "reconstruction"),
)
# They say how all is written, or in which order it is done.
_GENERAL = ("2.1", "5", "7.1", "10.1", "10.4", "12.3")
_CITED = re.compile(r"\[([RD][\d.]+-\d+)\]|(?<![\w.\[-])(\d+(?:\.\d+)*|Annex [A-G])(?![\w-])")
_RANGE = re.compile(r"\[(R[\d.]+-)(\d+)\] to \[R[\d.]+-(\d+)\]")


@cache
def _known() -> tuple[dict[str, str], dict[str, list[str]], dict[str, list[str]]]:
    """The clause of each requirement, the requirements of each clause, and those of each error."""
    clause: dict[str, str] = {}
    of_clause: dict[str, list[str]] = {}
    of_error: dict[str, list[str]] = {}
    for name, r in own_requirements().items():
        clause[name] = r.clause
        of_clause.setdefault(r.clause, []).append(name)
        if r.error:
            of_error.setdefault(r.error, []).append(name)
    return clause, of_clause, of_error


def _cited(comment: str) -> tuple[list[str], list[str]]:
    """The clauses and the requirements that a comment cites, in its order."""
    spread = _RANGE.sub(
        lambda m: ", ".join(f"[{m[1]}{n}]" for n in range(int(m[2]), int(m[3]) + 1)), comment.partition("SPEC ")[2]
    )
    clauses, named = [], []
    # What follows a colon is prose.
    for requirement, clause in _CITED.findall(spread.partition(":")[0]):
        if requirement:
            named.append(requirement)
        clauses.append(clause_of(requirement) if requirement else clause.removeprefix("Annex "))
    return list(dict.fromkeys(clauses)), named


class Statement:
    """A simple statement, or the head of one with a body: the lines that are its own.

    function: its function's qualified name, or empty at the top of a module or a class. clauses, requirements: those
    that the comments above it cite, the nearest first. errors: names of the registry that stand in it, with their
    lines.
    """

    def __init__(self, module: str, node: ast.stmt, function: str, cited: tuple[list[str], list[str]]) -> None:
        self.module, self.function = module, function
        body = getattr(node, "body", None)
        first = min([node.lineno, *(d.lineno for d in getattr(node, "decorator_list", []))])
        last = body[0].lineno - 1 if body else node.end_lineno or node.lineno
        # The head of `if a: b` shares its line with its body.
        self.lines = range(first, max(first, last) + 1)
        self.clauses, self.requirements = cited
        inside = _own(node)
        constants = [n for part in inside for n in ast.walk(part) if isinstance(n, ast.Constant)]
        self.errors = [(str(n.value), n.lineno) for n in constants if n.value in REGISTRY]
        self.names = {n.id for part in inside for n in ast.walk(part) if isinstance(n, ast.Name)}


def _own(node: ast.stmt) -> list[ast.AST]:
    """What belongs to a statement without the statements in it."""
    return [child for child in ast.iter_child_nodes(node) if not isinstance(child, ast.stmt | ast.ExceptHandler)]


def _comment(lines: list[str], node: ast.stmt) -> str:
    """The comment with SPEC directly above a statement and its decorators, or nothing."""
    at = min([node.lineno, *(d.lineno for d in getattr(node, "decorator_list", []))]) - 2
    found: list[str] = []
    while at >= 0 and lines[at].strip().startswith("#"):
        found.insert(0, lines[at].strip().lstrip("# "))
        at -= 1
    said = " ".join(found)
    return said if "SPEC " in said else ""


def _joined(near: list[str], far: list[str]) -> list[str]:
    return list(dict.fromkeys([*near, *far]))


@cache
def statements(module: str) -> tuple[Statement, ...]:
    """The statements of a module, in the order of its text."""
    source = text_of(module)
    lines = source.splitlines()
    found: list[Statement] = []

    def visit(nodes: Iterable[ast.stmt], function: str, scope: str, above: tuple[list[str], list[str]]) -> None:
        for node in nodes:
            comment = _comment(lines, node)
            own = _cited(comment) if comment else above
            if comment and function:
                # Within a function the nearer comment comes first, and that of the function after it.
                own = _joined(own[0], above[0]), _joined(own[1], above[1])
            inner, name = function, scope
            if isinstance(node, ast.FunctionDef | ast.ClassDef):
                name = f"{scope}.{node.name}" if scope else node.name
            if isinstance(node, ast.FunctionDef):
                inner = name
            # The head of a function is run when the module is read.
            found.append(Statement(module, node, function, own))
            for body in ("body", "orelse", "finalbody"):
                visit(getattr(node, body, []), inner, name, own)
            for handler in getattr(node, "handlers", []):
                visit(handler.body, inner, name, own)

    visit(ast.parse(source).body, "", "", ([], []))
    return tuple(found)


def _changed(mutant: Mutant) -> range:
    """The lines of the text that a bug replaces."""
    return range(mutant.line, mutant.line + mutant.old.count("\n") + 1)


def touched(mutant: Mutant) -> list[Statement]:
    """The statements that a bug changes."""
    changed = _changed(mutant)
    return [s for s in statements(mutant.module) if s.lines.start < changed.stop and changed.start < s.lines.stop]


def reach(mutant: Mutant) -> frozenset[tuple[str, int]] | None:
    """The places, (module, line), of which a file must run one for the bug to change anything; None: any file."""
    found = touched(mutant)
    if not found or any(not s.function for s in found):
        return None
    return frozenset((mutant.module, s.lines.start) for s in found)


def _users(module: str, name: str) -> Iterator[Statement]:
    """Statements in functions that use a name of the top of a module."""
    for other in MODULES:
        if other == module or re.search(rf"from \.{module} import [^#]*?\b{name}\b", text_of(other), re.DOTALL):
            yield from (s for s in statements(other) if s.function and name in s.names)


def rules(mutant: Mutant) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """The clauses and the requirements that a bug breaks, the first one first.

    Of a bug by hand the requirements are stated. Of another one they are those of the errors that its statement names,
    then those that the comments above it cite. A constant breaks what its users cite.
    """
    _, of_clause, of_error = _known()
    if mutant.requirements:
        # The order of checks is broken in a place, and the place comes first.
        named = sorted(mutant.requirements, key=lambda name: name == "D10.2-3")
        return tuple(dict.fromkeys(clause_of(name) for name in named)), tuple(named)
    clauses: list[str] = []
    named = []
    found = touched(mutant)
    if found and all(not s.function for s in found):
        target = re.match(r"\s*(?:class |def )?(\w+)", text_of(mutant.module).splitlines()[found[-1].lines.start - 1])
        if target and not found[-1].clauses:
            found = [*found, *_users(mutant.module, target[1])]
    elif not any(s.clauses for s in found):
        # What a class is made of serves its methods.
        owner = found[0].function.rpartition(".")[0] if found else ""
        found = [*found, *(s for s in statements(mutant.module) if owner and s.function.startswith(f"{owner}."))]
    for s in found:
        # A list of all errors has each on a line of its own.
        near = [error for error, line in s.errors if s.function or line in _changed(mutant)]
        raised = [name for error in near for name in of_error.get(error, [])]
        # Of the requirements with one error the comments may cite some.
        cited = [name for name in raised if name in s.requirements] or raised
        named += cited
        clauses += [clause_of(name) for name in cited]
    for s in found:
        named += [*s.requirements, *(name for c in s.clauses for name in of_clause.get(c, []) if c not in clauses)]
        clauses += s.clauses
    # Clauses of syntax and of order say less than those that demand something.
    order = sorted(dict.fromkeys(clauses), key=lambda c: c in _GENERAL or c.startswith("5."))
    return tuple(order) or ("2.5",), tuple(dict.fromkeys(named))


def stage(module: str) -> int:
    """Where in decoding a module has its part, from 0."""
    return next(number for number, modules in enumerate(STAGES) if module in modules)


def cited(s: Statement) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """The clauses and the requirements of a statement: those of its errors, or else those that comments cite."""
    _, of_clause, of_error = _known()
    named = [name for error, _ in s.errors for name in of_error.get(error, [])]
    named = [name for name in named if name in s.requirements] or named
    if not named:
        named = [*s.requirements, *(name for c in s.clauses for name in of_clause.get(c, []) if name[0] == "D")]
    return tuple(s.clauses), tuple(dict.fromkeys(named))


def places() -> list[Statement]:
    """The statements of all functions, which a file runs or not."""
    return [s for module in MODULES for s in statements(module) if s.function]


def lines() -> dict[tuple[str, int], tuple[str, int]]:
    """For each (module, line) of a function the place that it belongs to."""
    return {(s.module, line): (s.module, s.lines.start) for s in places() for line in s.lines}
