"""The diagnosis of a run: wrong numbers, and the requirements that separate failing from passing vectors.

Requirements are ranked by Ochiai's coefficient (R. Abreu, P. Zoeteweij, A. J. C. van Gemund, "On the Accuracy of
Spectrum-based Fault Localization", TAIC PART 2007). For a requirement with a failing and b passing vectors, where f
vectors fail in total, it is a / sqrt(f (a + b)). It is 1 if exactly the failing vectors have the requirement.
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
# The diagnosis of a run of fewer vectors has a warning.
_ENOUGH = 300
# A marked line of annotated bytes, where a decoder stopped. The group is the part of the file.
_SPOT = re.compile(r"> [0-9a-f]+ +(?:[0-9a-f]{2} )+(?:\.\.\. )? +([a-z_]+)")


@dataclass(frozen=True)
class Suspect:
    """A requirement. score: Ochiai's coefficient. failing, passing: the number of its vectors."""

    requirement: str
    score: float
    failing: int
    passing: int


def suspects(purposes: Mapping[str, Iterable[str]], failing: Mapping[str, bool]) -> list[Suspect]:
    """Returns the requirements of failing vectors, by descending score.

    purposes: the requirements of each vector. failing: whether a vector fails, for each vector that was run.
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
    """Returns the clauses of the first wrong numbers by descending number of vectors, with the simplest vector."""
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
    yield f"{failing} of {run} vectors fail; the requirements that best separate them from the others"
    for suspect in ranked:
        counts = f"{suspect.failing} failing and {suspect.passing} passing vectors"
        yield f"  {suspect.requirement}, {_named(clause_of(suspect.requirement))}: {counts}"
    if run < _ENOUGH:
        yield "  run the whole suite: few vectors do not separate requirements"


def _refusal_lines(entries: Sequence[dict[str, Any]]) -> Iterable[str]:
    """Yields a line with the parts of valid files in which the decoder stops. Its fault is there or just before."""
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

    A wrong number shows that its clause is broken. Without one, requirements are listed.
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
