"""Which rule a decoder breaks: the planted bugs most like what was seen, or the requirements that separate best."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from .likeness import Compared, Likeness
from .seen import RIGHT, Seen
from .spectrum import Suspect, suspects
from .table import Bug

# A clause is named if its score is at least HIGH, and AHEAD of the next one. Clauses of its most alike bug are passed
# over there. `conformance fingerprints judge` says what that makes of the planted bugs.
HIGH, AHEAD = 0.5, 0.3
# The likeness of a clause is a weighted mean over its MANY most alike bugs. Each has ALSO times the weight of the one
# before it. A wrong decoder is somewhat like many bugs of its clause. By chance it may be like one bug of another.
ALSO, MANY = 0.5, 8
# What a clause has of a bug that breaks it beside another one, of which it is the first.
BESIDE = 0.7
# What a requirement that separates well adds to its clause's score.
SPECTRUM = 0.1
# Two bugs are named for one if together they are so much more like what was seen.
TOGETHER = 0.3
# Failures are alike if verdict and code are, or verdict and parts.
ALIKE = 3
_PARTS = ALSO ** np.arange(MANY)
_PARTS /= _PARTS.sum()
# So many clauses, requirements and bugs at once are told, and so many bugs are tried together.
_LIKELY, _SUSPECTS, _MOST, _TRIED = 3, 5, 3, 40


@dataclass(frozen=True)
class Likely:
    """A planted bug that is like what was seen.

    likeness: 0 to 1. failing: of the vectors that the decoder fails, how many this bug fails with the same verdict and
    code, or the same parts. passing: of those that it passes, how many this bug passes.
    """

    bug: Bug
    likeness: float
    failing: int
    passing: int


@dataclass(frozen=True)
class Clause:
    """A clause of SPEC.md that may be broken. bug: the planted bug of it that is most alike, None if none is."""

    number: str
    score: float
    bug: Likely | None


@dataclass(frozen=True)
class Diagnosis:
    """What the failures of a run say.

    failing, passing: how many vectors were compared. clear: whether the first clause is clearly ahead. clauses: the
    best ones, best first. together: several bugs that explain the failures better than one, that which comes first in
    decoding first; nothing if one does. suspects: requirements, best first.
    """

    failing: int
    passing: int
    clear: bool
    clauses: tuple[Clause, ...]
    together: tuple[Likely, ...]
    suspects: tuple[Suspect, ...]


def _first(ranked: Iterable[Suspect]) -> list[Suspect]:
    """Each requirement once, in the sense in which it separates better."""
    best: dict[str, Suspect] = {}
    for suspect in ranked:
        best.setdefault(suspect.requirement, suspect)
    return list(best.values())


class Diagnostician:
    """Reads failures by a table."""

    def __init__(self, likeness: Likeness, purposes: Mapping[str, Iterable[str]]) -> None:
        """purposes: for each vector the requirements that it was made for."""
        self._likeness = likeness
        self._purposes = purposes
        self._bugs = [likeness.table.bugs[b] for b in likeness.columns]
        self._clause = np.array([bug.clause for bug in self._bugs])

    def diagnose(self, seen: Mapping[str, Seen]) -> Diagnosis | None:
        """Reads what was seen, right or not, on vectors of the table and others; None if none failed.

        If none of the table failed, no bug is like it, and the requirements that separate best are all there is.
        """
        failing = {name: what != RIGHT for name, what in seen.items()}
        if not any(failing.values()):
            return None
        found = self._likeness.compare(seen)
        count = int(found.failing.sum())
        table = self._likeness.table
        ranked = suspects(table, self._purposes, failing)
        clauses = self.clauses(found, ranked)
        cover = self._cover(found) if count else []
        together = [self._likely(found, b) for b in cover] if len(cover) > 1 else []
        if together:
            # What the pair explains leads; the rest follows.
            named = list(dict.fromkeys(one.bug.clause for one in together))
            clauses = sorted(clauses, key=lambda c: named.index(c.number) if c.number in named else len(named))
        best = clauses[0]
        same = best.bug.bug.clauses if best.bug else ()
        second = next((c.score for c in clauses[1:] if c.number not in same), 0.0)
        return Diagnosis(
            count,
            int(found.run.sum()) - count,
            bool(best.score >= HIGH and best.score - second >= AHEAD) or bool(together),
            tuple(clauses[:_LIKELY]),
            tuple(sorted(together, key=lambda one: one.bug.stage)),
            tuple(_first(ranked)[:_SUSPECTS]),
        )

    def clauses(self, found: Compared, ranked: Iterable[Suspect]) -> list[Clause]:
        """The clauses by score: the likeness of their most alike bugs, and how well their requirements separate."""
        best: dict[str, list[tuple[float, int]]] = {}
        for b, bug in enumerate(self._bugs):
            like = float(found.likeness[b])
            for place, number in enumerate(bug.clauses):
                best.setdefault(number, []).append(((BESIDE if place else 1.0) * like, -b))
        separates: dict[str, float] = {}
        for suspect in (s for s in ranked if s.made):
            separates.setdefault(suspect.clause, suspect.score)
        made = []
        for number in {**best, **separates}:
            most = sorted(best.get(number, [(0.0, 0)]), reverse=True)[:MANY]
            mean = float(np.dot([like for like, _ in most], _PARTS[: len(most)]))
            score = mean + SPECTRUM * separates.get(number, 0.0)
            made.append(Clause(number, score, self._likely(found, -most[0][1]) if most[0][0] else None))
        return sorted(made, key=lambda c: (-c.score, c.number))

    def _likely(self, found: Compared, b: int) -> Likely:
        alike = found.level[:, b] >= ALIKE
        fails = self._likeness.cells[:, b] >= 0
        passing = ~found.failing & found.run
        return Likely(
            self._bugs[b], float(found.likeness[b]), int((alike & found.failing).sum()), int((passing & ~fails).sum())
        )

    def _best(self, of: NDArray[np.float64]) -> NDArray[np.intp]:
        """The bug of each clause for which something is largest, the largest ones."""
        ranked = np.argsort(-of, kind="stable")
        _, first = np.unique(self._clause[ranked], return_index=True)
        return ranked[np.sort(first)[:_TRIED]]

    def _cover(self, found: Compared) -> list[int]:
        """The bugs that explain the failures, one or several.

        Where two bugs fail a vector, the decoder shows one of them. So of several bugs each vector has that which is
        most alike.
        """
        total = found.had.sum()

        def alike(chosen: NDArray[np.intp]) -> float:
            common, expected = found.common[:, chosen], found.expected[:, chosen]
            pick = np.argmax(common - 1e-6 * expected, axis=1)[:, None]
            # Of bugs that explain nothing of a vector the most is held against them.
            both = np.take_along_axis(common, pick, 1)[:, 0]
            either = np.where(both > 0, np.take_along_axis(expected, pick, 1)[:, 0], expected.max(1))
            return float(both.sum() / (total + either.sum() - both.sum()))

        # Those that are like the whole, and those all of which is seen, the best of each clause.
        seen_of = found.common.sum(0) / np.maximum(found.expected.sum(0), 1e-9) * (found.common.sum(0) > 0)
        some = np.unique(np.concatenate([self._best(found.likeness), self._best(seen_of)]))
        best = [int(np.argmax(found.likeness))]
        score = alike(np.array(best))
        pairs = {pair: alike(np.array(pair)) for pair in combinations(some.tolist(), 2)}
        two = max(pairs, key=lambda pair: pairs[pair], default=None)
        if two is None or pairs[two] < score + TOGETHER:
            return best
        chosen, score = list(two), pairs[two]
        while len(chosen) < _MOST:
            more = {b: alike(np.array([*chosen, b])) for b in some.tolist() if b not in chosen}
            other = max(more, key=lambda b: more[b], default=None)
            if other is None or more[other] < score + TOGETHER:
                break
            chosen, score = [*chosen, other], more[other]
        return chosen
