"""Wrong decoders that a hurried reader of SPEC.md might write: the list of handwritten.toml as mutants."""

from __future__ import annotations

import re
import tomllib
from functools import cache
from pathlib import Path

from .mutant import MODULES, Mutant, text_of

LIST = Path(__file__).with_name("handwritten.toml")


class BugError(ValueError):
    """A bug of the list that cannot be planted."""


def plant(name: str, module: str, old: str, new: str, what: str, requirements: list[str]) -> Mutant:
    """The mutant in which `new` stands for `old`.

    Raises BugError if the text does not occur exactly once, or the name or the module is wrong.
    """
    if module not in MODULES or not re.fullmatch(r"[a-z0-9-]+", name):
        raise BugError(f"{name}: {module} is no module, or the name is not one")
    text = text_of(module)
    if text.count(old) != 1:
        raise BugError(f"{name}: its text occurs {text.count(old)} times in {module}.py")
    line = text[: text.index(old)].count("\n") + 1
    return Mutant(name, module, line, old, new, what, text.replace(old, new), tuple(requirements))


@cache
def bugs() -> tuple[Mutant, ...]:
    """The list; BugError if one of it cannot be planted, or two have one name."""
    found = {}
    for bug in tomllib.loads(LIST.read_text(encoding="utf-8"))["bug"]:
        if bug["id"] in found:
            raise BugError(f"{bug['id']} is there twice")
        found[bug["id"]] = plant(bug["id"], bug["module"], bug["old"], bug["new"], bug["what"], bug["requirements"])
    return tuple(found.values())
