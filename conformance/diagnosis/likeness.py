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
        # Of each outcome, and of each level of it, the content. They are sorted: those of one fact are neighbours.
        bins = np.bincount(self.cells[self.cells >= 0], minlength=len(table.outcomes))
        self.weight = self._weights(damping)
        self._owner = table.outcomes[:, 0]
        self.content = np.empty((len(table.outcomes), LEVELS))
        for level in range(LEVELS):
            begins = (np.diff(table.outcomes[:, : level + 1], axis=0, prepend=-1) != 0).any(axis=1)
            fact = np.cumsum(begins) - 1
            shown = np.bincount(fact, bins)[fact]
            self.content[:, level] = self._content(shown) * self.weight[self._owner]
        self.expected = self._take(self.content[:, -1])

    def _content(self, shown: Floats | int) -> Floats:
        """In bits, of facts that so many bugs show. A fact that none shows is as rare as one of one more bug."""
        return -np.log2((np.asarray(shown) + 1.0) / (len(self.columns) + 1))

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
        mine = np.array(told, np.int64).reshape(-1, LEVELS - 1)[self._owner]
        same = np.logical_and.accumulate(self.table.outcomes[:, 1:] == mine, axis=1)
        depth = np.where(failing[self._owner], 1 + same.sum(1), 0)
        agreed = np.where(depth > 0, np.take_along_axis(self.content, np.maximum(depth - 1, 0)[:, None], 1)[:, 0], 0.0)
        common = self._take(agreed)
        expected = self.expected * run[:, None]
        had = np.where(failing, self._content(0) * self.weight, 0.0)
        whole = depth == LEVELS
        had[self._owner[whole]] = agreed[whole]
        both = common.sum(0)
        either = had.sum() + expected.sum(0) - both
        likeness = np.divide(both, either, out=np.zeros_like(both), where=either > 0)
        levels = np.where(self.cells < 0, 0, np.append(depth, 0)[self.cells]).astype(np.int8)
        return Compared(likeness, levels, common, expected, had, failing, run)
