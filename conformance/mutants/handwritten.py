"""Wrong decoders that a hurried reader of SPEC.md might write: the list of handwritten.toml as mutants."""

from __future__ import annotations

import re
import tomllib
from functools import cache
from pathlib import Path

from .mutant import Mutant, definitions, span, text

LIST = Path(__file__).with_name("handwritten.toml")


class BugError(ValueError):
    """A bug of the list that cannot be planted."""


def plant(name: str, place: str, old: str, new: str, what: str, requirements: list[str]) -> Mutant:
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
    line = text()[:at].count("\n") + 1
    source = text()[:at] + new + text()[at + len(old) :]
    return Mutant(name, place, line, old, new, what, source, tuple(requirements))


@cache
def bugs() -> tuple[Mutant, ...]:
    """Returns the mutants of the list. Raises BugError if one cannot be planted, or if two have the same name."""
    mutants: dict[str, Mutant] = {}
    for bug in tomllib.loads(LIST.read_text(encoding="utf-8"))["bug"]:
        if bug["id"] in mutants:
            raise BugError(f"{bug['id']} occurs twice")
        mutants[bug["id"]] = plant(bug["id"], bug["in"], bug["old"], bug["new"], bug["what"], bug["breaks"])
    return tuple(mutants.values())
