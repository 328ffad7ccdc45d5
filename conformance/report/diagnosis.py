"""The diagnosis of a run: wrong numbers, and the requirements that separate failing from passing vectors.

Requirements are ranked by Ochiai's coefficient (R. Abreu, P. Zoeteweij, A. J. C. van Gemund, "On the Accuracy of
Spectrum-based Fault Localization", TAIC PART 2007). For a requirement with a failing and b passing vectors, where f
vectors fail in total, it is a / sqrt(f (a + b)). It is 1 if exactly the failing vectors have the requirement.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from math import sqrt

from refcodec.inspect import specification
from refcodec.inspect.specification import clause_of

from ..runner.run import Digest, Result
from .schema import Diagnosis, Suspect, WrongNumber

# The numbers of clauses and requirements in a diagnosis.
_CLAUSES, _REQUIREMENTS = 3, 5
# The diagnosis of a run of fewer vectors has a warning.
_ENOUGH = 300
# A marked line of annotated bytes, where a decoder stopped. The group is the part of the file.
_SPOT = re.compile(r"> [0-9a-f]+ +(?:[0-9a-f]{2} )+(?:\.\.\. )? +([a-z_]+)")


def suspects(purposes: Mapping[str, Iterable[str]], failing: Mapping[str, bool]) -> list[Suspect]:
    """Returns the requirements of failing vectors, by descending score.

    purposes: the requirements of each vector. failing: whether a vector fails, for each vector that was run.
    """
    fails, passes = Counter[str](), Counter[str]()
    for name, failed in failing.items():
        (fails if failed else passes).update(purposes.get(name, ()))
    total = sum(failing.values())
    own = specification.own_requirements()
    texts = {name: own[name].text if name in own else "" for name in fails}
    ranked = [Suspect(r, a / sqrt(total * (a + passes[r])), a, passes[r], texts[r]) for r, a in fails.items()]
    return sorted(ranked, key=lambda s: (-s.score, s.requirement))


def _title(clause: str) -> str:
    own = specification.own_clauses().get(clause)
    return own.title if own else ""


def _named(clause: str) -> str:
    """Returns such as `7.5.5 (Positional encoding)`."""
    title = _title(clause)
    return f"{clause} ({title})" if title else clause


def _probes(results: Sequence[Result]) -> list[WrongNumber]:
    """Returns the clauses of the first wrong numbers by descending number of vectors, with the simplest vector."""
    by_clause: dict[str, list[tuple[str, str]]] = {}
    for r in sorted(results, key=lambda r: len(r.requirements)):
        if r.probe:
            by_clause.setdefault(r.probe.clauses[0], []).append((r.id, r.probe.text()))
    found = [WrongNumber(clause, _title(clause), len(wrong), *wrong[0]) for clause, wrong in by_clause.items()]
    return sorted(found, key=lambda row: -row.vectors)


def _probe_lines(probes: list[WrongNumber]) -> Iterable[str]:
    total = sum(row.vectors for row in probes)
    for row in probes[:_CLAUSES]:
        yield row.text
        share = f"{row.vectors} of {total} vectors with a wrong number"
        yield f"  read {_named(row.clause)}; {share}, such as {row.vector}"


def _suspect_lines(ranked: list[Suspect], failing: int, run: int) -> Iterable[str]:
    yield f"{failing} of {run} vectors fail; the requirements that best separate them from the others"
    for suspect in ranked:
        counts = f"{suspect.failing} failing and {suspect.passing} passing vectors"
        yield f"  {suspect.requirement}, {_named(clause_of(suspect.requirement))}: {counts}"
    if run < _ENOUGH:
        yield "  run the whole suite: few vectors do not separate requirements"


def _refusal_lines(results: Sequence[Result]) -> Iterable[str]:
    """Yields a line with the parts of valid files in which the decoder stops. Its fault is there or just before."""
    refused = [r for r in results if r.found and r.found.result == "rejected" and isinstance(r.expected, Digest)]
    counts = Counter(spot[1] for r in refused for line in r.hex if (spot := _SPOT.match(line)))
    if counts:
        parts = ", ".join(f"{part} ({count})" for part, count in counts.most_common())
        yield f"  the decoder refuses {len(refused)} valid files, in their {parts}"


def of_results(results: Sequence[Result]) -> Diagnosis | None:
    """Returns the diagnosis of a run, None if no vector failed.

    A wrong number shows that its clause is broken. Without one, requirements are listed.
    """
    failing = {r.id: r.status != "passed" for r in results if r.status not in ("skipped", "unexpected")}
    count = sum(failing.values())
    if not count:
        return None
    ranked = suspects({r.id: r.requirements for r in results}, failing)[:_REQUIREMENTS]
    probes = _probes(results)
    lines = _probe_lines(probes) if probes else _suspect_lines(ranked, count, len(failing))
    return Diagnosis(count, len(failing) - count, (*lines, *_refusal_lines(results)), tuple(probes), tuple(ranked))
