"""How good the diagnosis is, by the planted bugs themselves: each is held out with its siblings, and diagnosed."""

from __future__ import annotations

import random
import statistics
import time
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from ..manifest import Manifest
from .diagnose import AHEAD, HIGH, TOGETHER, Diagnosis, Diagnostician
from .likeness import Likeness
from .seen import RIGHT, Seen
from .table import Table, read


def _rest(table: Table, held: Iterable[int]) -> np.ndarray:
    """The bugs that are left without some, and without those of their lines."""
    places = {table.bugs[b].place for b in held}
    return np.array([b for b, bug in enumerate(table.bugs) if bug.place not in places], np.intp)


def _purposes(manifest: Manifest) -> dict[str, tuple[str, ...]]:
    return {v.id: v.requirements for v in manifest.vectors}


def row(table: Table, bug: int) -> dict[str, Seen]:
    """What a bug of the table does to all of its vectors."""
    return {name: table.seen(v, bug) for v, name in enumerate(table.names)}


def held_out(table: Table, purposes: Mapping[str, Iterable[str]], bug: int) -> Diagnosis | None:
    """The diagnosis of a bug by a table that has neither it nor a bug of its line."""
    return Diagnostician(Likeness(table, _rest(table, [bug])), purposes).diagnose(row(table, bug))


def _outcome(found: Diagnosis | None, right: set[str]) -> tuple[bool, bool, bool, bool]:
    """Whether a right clause is first, is among three, whether one is named clearly, and a wrong one is."""
    if found is None:
        return False, False, False, False
    numbers = [clause.number for clause in found.clauses]
    first = bool(numbers) and numbers[0] in right
    return first, any(number in right for number in numbers), found.clear, found.clear and not first


def _figures(told: Sequence[tuple[bool, bool, bool, bool]], what: str) -> str:
    sums = np.array(told, bool).reshape(len(told), 4).mean(0) * 100
    return (
        f"{what}: {len(told)}; the right clause first {sums[0]:.1f} %, among three {sums[1]:.1f} %; "
        f"named clearly {sums[2]:.1f} %, wrongly so {sums[3]:.1f} %"
    )


def cost(place: Path, manifest: Manifest) -> Iterator[str]:
    """A line on what a diagnosis takes: the size of a table, and the processor's time to read it and to use it."""
    began = time.process_time()
    table = read(place)
    opened = time.process_time() - began
    spent = []
    for bug in range(0, len(table.bugs), max(1, len(table.bugs) // 20)):
        seen = row(table, bug)
        began = time.process_time()
        Diagnostician(Likeness(table), _purposes(manifest)).diagnose(seen)
        spent.append(time.process_time() - began)
    yield (
        f"{place.stat().st_size} bytes, read in {opened:.2f} s; a diagnosis takes {statistics.median(spent):.2f} s, "
        f"at most {max(spent):.2f} s of a processor"
    )


def alone(table: Table, manifest: Manifest, count: int, seed: int) -> Iterator[str]:
    """Lines on bugs of a table, each held out with the bugs of its line. count: of a sample, 0 for all of them."""
    purposes = _purposes(manifest)
    shown = [b for b in range(len(table.bugs)) if (table.cells[:, b] >= 0).any()]
    yield f"{len(table.bugs)} planted bugs, {len(table.vectors)} vectors; {len(shown)} bugs change something on one"
    yield f"a clause is clear from a score of {HIGH}, {AHEAD} ahead; bugs are several from {TOGETHER} more together"
    if 0 < count < len(shown):
        shown = sorted(random.Random(seed).sample(shown, count))
    told = {b: _outcome(held_out(table, purposes, b), set(table.bugs[b].clauses)) for b in shown}
    yield _figures(list(told.values()), "bugs, each without it and its siblings of one line")
    chapters = Counter(table.bugs[b].clause.split(".")[0] for b in shown)
    for chapter in sorted(chapters, key=lambda c: (not c.isdigit(), int(c) if c.isdigit() else 0, c)):
        of = [outcome for b, outcome in told.items() if table.bugs[b].clause.split(".")[0] == chapter]
        yield "  " + _figures(of, f"chapter {chapter}")


def together(table: Table, manifest: Manifest, pairs: Sequence[tuple[int, int, dict[str, Seen]]]) -> Iterator[str]:
    """Lines on pairs of bugs that were planted together, each by a table without both and the bugs of their lines."""
    purposes, told, both = _purposes(manifest), [], 0
    for a, b, seen in pairs:
        whole = {name: seen.get(name, RIGHT) for name in table.names}
        found = Diagnostician(Likeness(table, _rest(table, [a, b])), purposes).diagnose(whole)
        rights = [set(table.bugs[x].clauses) for x in (a, b)]
        told.append(_outcome(found, rights[0] | rights[1]))
        numbers = {clause.number for clause in found.clauses} if found else set()
        both += all(right & numbers for right in rights)
    yield _figures(told, "pairs of bugs, one of their clauses being right")
    yield f"  both clauses among three: {100 * both / max(1, len(pairs)):.1f} %"
