"""The bugs: texts that are changed in the second decoder or in the decoder in C, and pairs of them."""

from __future__ import annotations

import re
import tomllib
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

CONFORMANCE = Path(__file__).resolve().parent.parent
# The folder of each decoder's sources. The lists have the names of the decoders.
SOURCES = {"independent": CONFORMANCE / "independent", "c": CONFORMANCE / "c"}
PAIRS = Path(__file__).with_name("pairs.toml")


class BugError(ValueError):
    """A bug that cannot be planted."""


@dataclass(frozen=True)
class Bug:
    """One change.

    decoder: a key of SOURCES. file: in its folder. old: the text there that becomes `new`. what: what is wrong then.
    clauses: of SPEC.md, those whose rule is broken. The first one decides, and each of the others is a right answer
    too. requirements: those that are broken, if there are any.
    """

    id: str
    decoder: str
    file: str
    old: str
    new: str
    what: str
    clauses: tuple[str, ...]
    requirements: tuple[str, ...]


@dataclass(frozen=True)
class Wrong:
    """A wrong decoder: one bug, or two of the same decoder. hides: whether the first was chosen to hide the second."""

    bugs: tuple[Bug, ...]
    hides: bool = False

    @property
    def id(self) -> str:
        """The names of its bugs."""
        return "+".join(bug.id for bug in self.bugs)

    @property
    def decoder(self) -> str:
        """The decoder that it is made from, a key of SOURCES."""
        return self.bugs[0].decoder

    @property
    def clauses(self) -> tuple[str, ...]:
        """The right answers."""
        return tuple(dict.fromkeys(clause for bug in self.bugs for clause in bug.clauses))

    def texts(self) -> dict[str, str]:
        """The changed files by name.

        Raises BugError if a text does not occur exactly once. Of a pair the second one is looked for where the first
        one has been planted.
        """
        found: dict[str, str] = {}
        for bug in self.bugs:
            text = found.get(bug.file) or _text(bug.decoder, bug.file)
            if text.count(bug.old) != 1:
                raise BugError(f"{bug.id}: its text occurs {text.count(bug.old)} times in {bug.file}")
            found[bug.file] = text.replace(bug.old, bug.new)
        return found


@cache
def _text(decoder: str, file: str) -> str:
    try:
        return (SOURCES[decoder] / file).read_text(encoding="utf-8")
    except OSError as error:
        raise BugError(f"{file}: {error.strerror}") from None


def _read(name: str) -> dict[str, Any]:
    return tomllib.loads(Path(__file__).with_name(name).read_text(encoding="utf-8"))


@cache
def bugs() -> tuple[Bug, ...]:
    """All bugs, those of the second decoder first. Raises BugError if two have one name."""
    found: dict[str, Bug] = {}
    for decoder in SOURCES:
        for entry in _read(f"{decoder}.toml")["bug"]:
            name = entry["id"]
            if name in found or not re.fullmatch(r"[a-z0-9-]+", name):
                raise BugError(f"{name}: it is there twice, or it is no name")
            file = "decoder.c" if decoder == "c" else f"{entry['module']}.py"
            clauses, requirements = tuple(entry["clauses"]), tuple(entry["requirements"])
            found[name] = Bug(name, decoder, file, entry["old"], entry["new"], entry["what"], clauses, requirements)
    return tuple(found.values())


def pairs() -> tuple[Wrong, ...]:
    """The pairs of pairs.toml, which `python -m conformance.unseen draw` wrote."""
    known = {bug.id: bug for bug in bugs()}
    return tuple(
        Wrong(tuple(known[name] for name in entry["bugs"]), entry["hides"]) for entry in _read(PAIRS.name)["pair"]
    )


def decoders() -> tuple[Wrong, ...]:
    """All wrong decoders: those with one bug, then those with two."""
    return (*(Wrong((bug,)) for bug in bugs()), *pairs())
