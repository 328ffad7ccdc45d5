"""Selects vectors by expressions such as `class:malformed,invalid code:1*,2*`."""

from collections.abc import Callable, Iterable
from fnmatch import fnmatchcase

from msgspec import UnsetType

from ..manifest import Rejected, Vector

_VALUES: dict[str, Callable[[Vector], Iterable[str]]] = {
    "id": lambda v: [v.id],
    "class": lambda v: [v.klass],
    "operation": lambda v: [v.operation],
    "profile": lambda v: [v.profile or "none"],
    "level": lambda v: ["none" if v.level is None else str(v.level)],
    "feature": lambda v: v.features,
    "requirement": lambda v: v.requirements,
    "flag": lambda v: v.flags,
    "minor_at_most": lambda v: [] if isinstance(v.minor_at_most, UnsetType) else [str(v.minor_at_most)],
    "code": lambda v: [str(v.expectation.code)] if isinstance(v.expectation, Rejected) else [],
}
HELP = (
    "select vectors: terms such as class:valid or id:escape-*, separated by spaces, must all hold; commas separate "
    f"alternatives, * and ? are wildcards, a leading ! negates; names: {', '.join(_VALUES)}; "
    "a vector is selected if any of several --select holds"
)


class SelectionError(Exception):
    """An expression with a syntax error."""


def _term(text: str) -> Callable[[Vector], bool]:
    wanted = not text.startswith("!")
    name, colon, patterns = text.removeprefix("!").partition(":")
    if not colon:
        name, patterns = "id", name
    if name not in _VALUES:
        raise SelectionError(f"{name}: not one of {', '.join(_VALUES)}")
    values = _VALUES[name]
    return lambda v: (
        wanted == any(fnmatchcase(value, pattern) for value in values(v) for pattern in patterns.split(","))
    )


def select(vectors: Iterable[Vector], expressions: Iterable[str]) -> list[Vector]:
    """Returns the vectors that any expression selects; all without expressions. Raises SelectionError."""
    choices = [[_term(term) for term in expression.split()] for expression in expressions]
    return [v for v in vectors if not choices or any(all(term(v) for term in terms) for terms in choices)]
