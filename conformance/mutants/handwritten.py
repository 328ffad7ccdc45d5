"""Wrong decoders that a person thought of: the list of handwritten.toml as mutants."""

import re
import tomllib
from functools import cache
from pathlib import Path

from .mutant import Mutant, definitions, planted, span, text

LIST = Path(__file__).with_name("handwritten.toml")
CHANGED = re.compile(r"\[-(.*?)-\]|\{\+(.*?)\+\}", re.DOTALL)


class BugError(ValueError):
    """A bug of the list that cannot be planted."""


def plant(name: str, place: str, old: str, new: str, what: str, requirements: tuple[str, ...] = ()) -> Mutant:
    """Returns the mutant with `new` instead of `old` in a function or constant of the blocks.

    Raises BugError if `old` does not occur exactly once there, or if the name or the place is not valid.
    """
    if place not in definitions() or not re.fullmatch(r"[a-z0-9-]+", name):
        raise BugError(f"{name}: {place} is not a function or constant that decodes, or the name is not valid")
    first, end = span(definitions()[place])
    own = text()[first:end]
    if own.count(old) != 1:
        raise BugError(f"{name}: its text occurs {own.count(old)} times in {place}")
    at = first + own.index(old)
    return planted(name, place, (at, at + len(old)), new, what, requirements)


def read(name: str, place: str, entry: str) -> Mutant:
    """Returns the mutant of an entry of the list. Raises BugError."""
    head, *changes = re.split(r" \| |\n", entry, maxsplit=1)
    (requirements, colon, what), change = head.partition(": "), "".join(changes)
    old, new = CHANGED.sub(r"\1", change), CHANGED.sub(r"\2", change)
    if not colon or old == new:
        raise BugError(f"{name} is not requirements, a text and a change")
    return plant(name, place, old, new, what, tuple(requirements.split(", ")))


@cache
def bugs() -> tuple[Mutant, ...]:
    """Returns the mutants of the list. Raises BugError if one cannot be planted, or if two have the same name."""
    mutants: dict[str, Mutant] = {}
    for place, entries in tomllib.loads(LIST.read_text(encoding="utf-8")).items():
        for name, entry in entries.items():
            if name in mutants:
                raise BugError(f"{name} occurs twice")
            mutants[name] = read(name, place, entry)
    return tuple(mutants.values())
