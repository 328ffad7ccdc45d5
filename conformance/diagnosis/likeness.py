"""How like a planted bug what was seen is: agreement on each vector, weighted by its rarity among planted bugs.

What is seen on a vector is nested: it fails; it fails with this verdict; with this code or these parts; at this offset
or with this very output. Each has an information content, -log2 of the share of planted bugs that show it. Two
fingerprints have in common, on each vector, the content of the most exact level on which they agree. Their likeness is
what they have in common over what either has: the Jaccard index weighted by information content, which is known as
simGIC (C. Pesquita and others, "Metrics for GO based protein semantic similarity: a systematic evaluation", BMC
Bioinformatics 9 (Suppl. 5), S4, 2008).

Vectors that all bugs treat alike are one witness, not many. So a vector counts by its part in its group of witnesses.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .seen import RIGHT, Seen
from .table import Table

Floats = NDArray[np.float64]
LEVELS = 4


def _levels(what: Seen) -> tuple[tuple[int, ...], ...]:
    """The four nested facts of what was seen."""
    return (0,), (what.verdict,), (what.verdict, what.detail), tuple(what)


@dataclass(frozen=True)
class Compared:
    """What was seen compared with each bug.

    likeness: [bugs], 0 to 1. level: [vectors, bugs] on how many of the nested facts they agree. common: [vectors, bugs]
    what they have in common, in bits. expected: [vectors, bugs] what the bug has. had: [vectors] what was seen has.
    failing, run: [vectors] whether the decoder fails, and whether it was run.
    """

    likeness: Floats
    level: NDArray[np.int8]
    common: Floats
    expected: Floats
    had: Floats
    failing: NDArray[np.bool_]
    run: NDArray[np.bool_]


class Likeness:
    """A table prepared for comparisons."""

    def __init__(self, table: Table, columns: NDArray[np.intp] | None = None, damping: float = 0.5) -> None:
        """columns: the bugs that are known; without it all are. damping: 0 counts all vectors alike, 1 groups alike."""
        self.table = table
        self.columns = np.arange(len(table.bugs)) if columns is None else columns
        self.cells = table.cells[:, self.columns]
        count = len(self.columns)
        # Of each outcome, and of each level of it, the content.
        owner = np.array([vector for vector, _ in table.outcomes], np.intp)
        bins = np.bincount(self.cells[self.cells >= 0].ravel(), minlength=len(owner))
        facts: dict[tuple[int, tuple[int, ...]], int] = {}
        keys = [[(vector, level) for level in _levels(what)] for vector, what in table.outcomes]
        for number, nested in enumerate(keys):
            for key in nested:
                facts[key] = facts.get(key, 0) + int(bins[number])
        self._facts = facts
        self._count = count
        self.weight = self._weights(damping)
        shape = (len(owner), LEVELS)
        raw = np.array([[self._content(key) for key in nested] for nested in keys], float).reshape(shape)
        self.content = raw * self.weight[owner][:, None]
        self.expected = self._take(self.content[:, -1])

    def _content(self, key: tuple[int, tuple[int, ...]]) -> float:
        """In bits. A fact that no bug shows is as rare as one of one more bug."""
        return float(-np.log2((self._facts.get(key, 0) + 1) / (self._count + 1)))

    def _weights(self, damping: float) -> Floats:
        """[vectors]: 1 / n^damping for each vector of a group of n, which the same bugs fail."""
        failing = np.packbits(self.cells >= 0, axis=1)
        _, group, sizes = np.unique(failing, axis=0, return_inverse=True, return_counts=True)
        found: Floats = np.power(sizes[group.ravel()].astype(np.float64), -damping)
        return found

    def _take(self, values: Floats) -> Floats:
        """[vectors, bugs] of values by outcome; 0 where the bug is right."""
        return np.where(self.cells < 0, 0.0, np.append(values, 0.0)[self.cells])

    def compare(self, seen: Mapping[str, Seen]) -> Compared:
        """Compares what was seen with each bug. Vectors that are not in `seen` do not count."""
        names = self.table.names
        run = np.array([name in seen for name in names])
        told = [seen.get(name, RIGHT) for name in names]
        failing = np.array([what != RIGHT for what in told]) & run
        agreed = np.zeros(len(self.table.outcomes))
        depth = np.zeros(len(self.table.outcomes), np.int8)
        nested = [_levels(what) for what in told]
        for number, (vector, what) in enumerate(self.table.outcomes):
            if failing[vector]:
                for level, mine in zip(range(LEVELS), _levels(what), strict=True):
                    if mine != nested[vector][level]:
                        break
                    agreed[number] = self.content[number, level]
                    depth[number] = level + 1
        common = self._take(agreed)
        expected = self.expected * run[:, None]
        had = np.array(
            [self._content((v, nested[v][-1])) * self.weight[v] if failing[v] else 0.0 for v in range(len(names))]
        )
        both = common.sum(0)
        either = had.sum() + expected.sum(0) - both
        likeness = np.divide(both, either, out=np.zeros_like(both), where=either > 0)
        levels = np.where(self.cells < 0, 0, np.append(depth, 0)[self.cells]).astype(np.int8)
        return Compared(likeness, levels, common, expected, had, failing, run)
