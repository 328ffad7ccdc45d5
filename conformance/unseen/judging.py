"""A diagnosis judged by records that it has never seen: how often the clause that it names is the right one."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cache
from typing import Any

from ..diagnosis import words
from ..manifest import Manifest, load
from .bugs import Wrong
from .records import FAILED

# What a diagnosis says of a record: clauses of SPEC.md, the likeliest first, each with whether it stands by it.
Named = Sequence[tuple[str, bool]]
Diagnosis = Callable[[dict[str, Any]], Named]
# A person reads so many clauses before giving up.
READ = 3


@dataclass(frozen=True)
class Row:
    """What a diagnosis said of one wrong decoder. failing: vectors that it fails."""

    wrong: Wrong
    failing: int
    named: tuple[tuple[str, bool], ...]

    @property
    def first(self) -> bool:
        """Whether the first clause is a right one."""
        return self._right(1)

    @property
    def among(self) -> bool:
        """Whether a right clause is among the first three."""
        return self._right(READ)

    @property
    def misled(self) -> bool:
        """Whether a wrong clause is named with confidence."""
        return any(sure and clause not in self.wrong.clauses for clause, sure in self.named)

    @property
    def sure(self) -> bool:
        """Whether any clause is named with confidence."""
        return any(sure for _, sure in self.named)

    def _right(self, count: int) -> bool:
        return any(clause in self.wrong.clauses for clause, _ in self.named[:count])


def frequent(record: dict[str, Any]) -> Named:
    """The baseline: the clauses that the failing vectors name most often.

    It stands by the first if no other one is named as often.
    """
    counts = Counter(clause for v in record["vectors"] if v["status"] in FAILED for clause in v["clauses"])
    ranked = counts.most_common()
    ahead = len(ranked) == 1 or (len(ranked) > 1 and ranked[0][1] > ranked[1][1])
    return [(clause, ahead and n == 0) for n, (clause, _) in enumerate(ranked)]


def spectrum(record: dict[str, Any]) -> Named:
    """The clauses ranked by the Ochiai measure of spectrum-based fault localisation.

    It is the number of failing vectors that name a clause, over the geometric mean of all failing vectors and all that
    name it (Abreu, Zoeteweij, van Gemund: On the accuracy of spectrum-based fault localization, TAIC PART 2007). It
    stands by a clause whose vectors are exactly those that fail, which have the measure 1.
    """
    bad = [v for v in record["vectors"] if v["status"] in FAILED]
    wrong = Counter(clause for v in bad for clause in v["clauses"])
    every = Counter(clause for v in record["vectors"] for clause in v["clauses"])
    squares = {clause: Fraction(count * count, len(bad) * every[clause]) for clause, count in wrong.items()}
    return [(clause, squares[clause] == 1) for clause in sorted(squares, key=lambda clause: -squares[clause])]


@cache
def _manifest() -> Manifest:
    return load()


def told(record: dict[str, Any]) -> Named:
    """What the runner tells of a record today: clauses of wrong numbers, of bugs together, and of all bugs, in turn.

    It stands by those that it says the failures are of. A record's own diagnosis may be by another table.
    """
    said = words.of_record(_manifest(), record["vectors"], record["runner"]["grade"])
    if said is None:
        return []
    probed, ranked = ([one["clause"] for one in said[of]] for of in ("probes", "clauses"))
    together = [bug["clauses"][0] for bug in said["together"]]
    sure = (probed[:1] or together or ranked[:1]) if said["clear"] else []
    return [(clause, clause in sure) for clause in dict.fromkeys([*probed, *together, *ranked])]


def judged(found: Iterable[tuple[Wrong, dict[str, Any]]], diagnosis: Diagnosis) -> list[Row]:
    """What a diagnosis says of each record."""
    return [
        Row(wrong, sum(v["status"] in FAILED for v in record["vectors"]), tuple(diagnosis(record)))
        for wrong, record in found
    ]


def _shown(row: Row) -> str:
    named = ", ".join(f"{clause}!" if sure else clause for clause, sure in row.named[:READ])
    result = "first" if row.first else "among three" if row.among else "no"
    result += ", misled" if row.misled else ""
    return f"| {row.wrong.id} | {', '.join(row.wrong.clauses)} | {row.failing} | {named} | {result} |"


def groups(rows: Sequence[Row]) -> dict[str, list[Row]]:
    """The rows that the summary has lines for."""
    single = [row for row in rows if len(row.wrong.bugs) == 1]
    both = [row for row in rows if len(row.wrong.bugs) > 1]
    return {
        "second decoder": [row for row in single if row.wrong.decoder == "independent"],
        "decoder in C": [row for row in single if row.wrong.decoder == "c"],
        "both": single,
        "pairs at random": [row for row in both if not row.wrong.hides],
        "pairs, one hidden": [row for row in both if row.wrong.hides],
        "all pairs": both,
    }


def table(rows: Sequence[Row]) -> Iterator[str]:
    """The rows as Markdown, and the summary. A mark behind a clause says that the diagnosis stands by it."""
    yield "| wrong decoder | right clauses | vectors failed | named | right |"
    yield "|---|---|---:|---|---|"
    yield from map(_shown, rows)
    yield ""
    yield "| wrong decoders | number | right clause first | among three | confident | a wrong one with confidence |"
    yield "|---|---:|---:|---:|---:|---:|"
    for name, members in groups(rows).items():
        if members:
            shares = (sum(getattr(row, what) for row in members) for what in ("first", "among", "sure", "misled"))
            yield f"| {name} | {len(members)} | {' | '.join(_share(n, len(members)) for n in shares)} |"


def _share(count: int, of: int) -> str:
    return f"{count} ({100 * count / of:.0f} %)"
