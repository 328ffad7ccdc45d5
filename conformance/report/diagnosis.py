"""The diagnosis of a run: the clauses whose numbers are wrong, and the parts in which the decoder stops."""

import re
from collections import Counter
from collections.abc import Iterator, Sequence

from refcodec.inspect import specification

from ..runner.run import Digest, Result
from .schema import Diagnosis, WrongNumber

# The number of clauses in a diagnosis.
_CLAUSES = 3
# A marked line of annotated bytes, where a decoder stopped. The group is the part of the file.
_SPOT = re.compile(r"> [0-9a-f]+ +(?:[0-9a-f]{2} )+(?:\.\.\. )? +([a-z_]+)")


def _probes(results: Sequence[Result]) -> list[WrongNumber]:
    """Returns the clauses of the first wrong numbers by descending number of vectors, with the simplest vector."""
    titles = specification.own_clauses()
    by_clause: dict[str, list[tuple[str, str]]] = {}
    for r in sorted(results, key=lambda r: len(r.requirements)):
        if r.probe:
            by_clause.setdefault(r.probe.clauses[0], []).append((r.id, r.probe.text()))
    numbers = [
        WrongNumber(clause, titles[clause].title if clause in titles else "", len(wrong), *wrong[0])
        for clause, wrong in by_clause.items()
    ]
    return sorted(numbers, key=lambda row: -row.vectors)


def _lines(probes: list[WrongNumber], results: Sequence[Result]) -> Iterator[str]:
    total = sum(row.vectors for row in probes)
    for row in probes[:_CLAUSES]:
        yield row.text
        share = f"{row.vectors} of {total} vectors with a wrong number"
        yield f"  read {row.clause}{row.title and f' ({row.title})'}; {share}, such as {row.vector}"
    # The fault is in these parts or just before.
    refused = [r for r in results if r.found and r.found.result == "rejected" and isinstance(r.expected, Digest)]
    counts = Counter(spot[1] for r in refused for line in r.hex if (spot := _SPOT.match(line)))
    if counts:
        parts = ", ".join(f"{part} ({count})" for part, count in counts.most_common())
        yield f"the decoder refuses {len(refused)} valid files, in their {parts}"


def of_results(results: Sequence[Result]) -> Diagnosis | None:
    """Returns the diagnosis of a run, None if no vector failed."""
    failing = [r.status != "passed" for r in results if r.status not in ("skipped", "unexpected")]
    if not any(failing):
        return None
    probes = _probes(results)
    return Diagnosis(sum(failing), len(failing) - sum(failing), tuple(_lines(probes, results)), tuple(probes))
