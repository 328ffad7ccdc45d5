"""The diagnosis of a run: wrong numbers, and the requirements that tell failing vectors from passing ones.

Requirements are ranked by Ochiai's coefficient (R. Abreu, P. Zoeteweij, A. J. C. van Gemund, "On the Accuracy of
Spectrum-based Fault Localization", TAIC PART 2007). Of a requirement that a failing and b passing vectors were made
for, where f vectors fail in all, it is a / sqrt(f (a + b)). It is 1 if exactly the failing vectors were made for it.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from math import sqrt
from typing import Any

from refcodec.inspect import specification
from refcodec.inspect.specification import clause_of

from ..runner.traces import Probe

# The numbers of clauses and requirements in a diagnosis.
_CLAUSES, _REQUIREMENTS = 3, 5
# Fewer vectors tell little. The diagnosis then says so.
_ENOUGH = 300
# In the annotated bytes of a file, the place where a decoder stopped, up to its part.
_SPOT = re.compile(r"> [0-9a-f]+ +(?:[0-9a-f]{2} )+(?:\.\.\. )? +([a-z_]+)")


@dataclass(frozen=True)
class Suspect:
    """A requirement. score: Ochiai's coefficient. failing, passing: the vectors of each sort that were made for it."""

    requirement: str
    score: float
    failing: int
    passing: int


def suspects(purposes: Mapping[str, Iterable[str]], failing: Mapping[str, bool]) -> list[Suspect]:
    """Returns the requirements that failing vectors were made for, those that separate best first.

    purposes: for each vector the requirements that it was made for. failing: for each vector that was run, whether it
    fails.
    """
    fails, passes = Counter[str](), Counter[str]()
    for name, failed in failing.items():
        (fails if failed else passes).update(purposes.get(name, ()))
    total = sum(failing.values())
    ranked = [Suspect(r, a / sqrt(total * (a + passes[r])), a, passes[r]) for r, a in fails.items()]
    return sorted(ranked, key=lambda s: (-s.score, s.requirement))


def _title(clause: str) -> str:
    own = specification.own_clauses().get(clause)
    return own.title if own else ""


def _named(clause: str) -> str:
    """Returns such as `7.5.5 (Positional encoding)`."""
    title = _title(clause)
    return f"{clause} ({title})" if title else clause


def _probes(entries: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Returns the clauses of the first wrong numbers, that of most vectors first, each with its simplest vector."""
    by_clause: dict[str, list[dict[str, Any]]] = {}
    for entry in sorted((e for e in entries if e["probe"]), key=lambda e: len(e["requirements"])):
        by_clause.setdefault(entry["probe"]["clauses"][0], []).append(entry)
    return [
        {
            "clause": clause,
            "title": _title(clause),
            "vectors": len(wrong),
            "vector": wrong[0]["id"],
            "text": Probe(**{**wrong[0]["probe"], "clauses": tuple(wrong[0]["probe"]["clauses"])}).text(),
        }
        for clause, wrong in sorted(by_clause.items(), key=lambda item: -len(item[1]))
    ]


def _probe_lines(probes: list[dict[str, Any]]) -> Iterable[str]:
    total = sum(row["vectors"] for row in probes)
    for row in probes[:_CLAUSES]:
        yield row["text"]
        share = f"{row['vectors']} of {total} vectors with a wrong number"
        yield f"  read {_named(row['clause'])}; {share}, such as {row['vector']}"


def _suspect_lines(ranked: list[Suspect], failing: int, run: int) -> Iterable[str]:
    yield f"{failing} of {run} vectors fail; the requirements that tell them from the others, the best first"
    for suspect in ranked:
        counts = f"{suspect.failing} failing vectors were made for it, and {suspect.passing} passing ones"
        yield f"  {suspect.requirement}, {_named(clause_of(suspect.requirement))}: {counts}"
    if run < _ENOUGH:
        yield "  run the whole suite: the requirements of few vectors tell little"


def _refusal_lines(entries: Sequence[dict[str, Any]]) -> Iterable[str]:
    """Yields a line with the parts of valid files in which the decoder stops: it goes wrong there, or just before."""
    refused = [
        e
        for e in entries
        if e["found"] and e["found"]["result"] == "rejected" and e["expected"]["result"] == "accepted"
    ]
    counts = Counter(spot[1] for e in refused for line in e["hex"] if (spot := _SPOT.match(line)))
    if counts:
        parts = ", ".join(f"{part} ({count})" for part, count in counts.most_common())
        yield f"  the decoder refuses {len(refused)} valid files, in their {parts}"


def of_record(entries: Sequence[dict[str, Any]]) -> dict[str, Any] | None:
    """Returns the diagnosis of a record's entries as JSON, None if no vector failed.

    A wrong number decides: the clause that it is from is broken. Without one, requirements are listed.
    """
    failing = {e["id"]: e["status"] != "passed" for e in entries if e["status"] not in ("skipped", "unexpected")}
    if not any(failing.values()):
        return None
    ranked = suspects({e["id"]: e["requirements"] for e in entries}, failing)[:_REQUIREMENTS]
    probes = _probes(entries)
    count = sum(failing.values())
    lines = _probe_lines(probes) if probes else _suspect_lines(ranked, count, len(failing))
    own = specification.own_requirements()
    return {
        "failing": count,
        "passing": len(failing) - count,
        "text": [*lines, *_refusal_lines(entries)],
        "probes": probes,
        "requirements": [
            vars(s) | {"score": round(s.score, 3), "text": own[s.requirement].text if s.requirement in own else ""}
            for s in ranked
        ],
    }
