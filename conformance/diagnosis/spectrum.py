"""The requirements that tell failing vectors from passing ones: fault localisation by the spectrum of what each runs.

The measure is Ochiai's coefficient (R. Abreu, P. Zoeteweij, A. J. C. van Gemund, "On the Accuracy of Spectrum-based
Fault Localization", TAIC PART 2007): of an element that a failing and b passing vectors exercise, where f vectors fail
in all, it is a / sqrt(f (a + b)). It is 1 if exactly the failing vectors exercise it.

A vector exercises a requirement in two senses. It was made for it, as the manifest says. Or the unchanged second
decoder runs code for it that cites it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from refcodec.inspect.specification import clause_of

from .table import Table

Bits = NDArray[np.bool_]


@dataclass(frozen=True)
class Suspect:
    """A requirement. score: Ochiai's coefficient. failing, passing: how many vectors of each sort exercise it.

    made: whether these are the vectors that were made for it, or those whose decoding runs code for it.
    """

    requirement: str
    score: float
    failing: int
    passing: int
    made: bool

    @property
    def clause(self) -> str:
        """Where it stands in SPEC.md."""
        return clause_of(self.requirement)


def ochiai(exercised: Bits, failing: Bits, run: Bits) -> tuple[NDArray[np.float64], NDArray, NDArray]:
    """The coefficient of each column of `exercised`, and how many failing and passing vectors exercise it.

    exercised: [vectors, elements]. failing, run: [vectors]; vectors that were not run do not count.
    """
    fails, passes = exercised[failing & run].sum(0), exercised[~failing & run].sum(0)
    below = np.sqrt((failing & run).sum() * (fails + passes))
    return np.divide(fails, below, out=np.zeros(len(fails)), where=below > 0), fails, passes


def of_code(table: Table) -> tuple[list[str], Bits]:
    """The requirements that code cites, and [vectors, requirements] whether a vector runs code of each."""
    names = sorted({name for place in table.places for name in place.requirements})
    cites = np.array([[name in place.requirements for name in names] for place in table.places], bool)
    cites = cites.reshape(len(table.places), len(names))
    return names, (table.runs.astype(np.uint16) @ cites.astype(np.uint16)) > 0


def suspects(table: Table, purposes: Mapping[str, Iterable[str]], failing: Mapping[str, bool]) -> list[Suspect]:
    """The requirements that failing vectors exercise, in either sense, those that separate best first.

    purposes: for each vector the requirements that it was made for. failing: for each vector that was run, in the table
    or not, whether it fails.
    """
    names = list(failing)
    fails = np.array([failing[name] for name in names], bool)
    known = sorted({r for name in names for r in purposes.get(name, ())})
    column = {name: number for number, name in enumerate(known)}
    made = np.zeros((len(names), len(known)), bool)
    for number, name in enumerate(names):
        made[number, [column[r] for r in purposes.get(name, ())]] = True
    found = [(known, ochiai(made, fails, np.ones(len(names), bool)), True)]
    cited, exercised = of_code(table)
    run = np.array([name in failing for name in table.names])
    some = np.array([failing.get(name, False) for name in table.names])
    found.append((cited, ochiai(exercised, some, run), False))
    told = [
        Suspect(name, float(score), int(a), int(b), sense)
        for requirements, columns, sense in found
        for name, score, a, b in zip(requirements, *columns, strict=True)
        if a
    ]
    return sorted(told, key=lambda s: (-s.score, not s.made, s.requirement))
