"""Pairs of bugs, drawn: some at random, and some of which the first hides the second."""

from __future__ import annotations

import ast
import random
from collections.abc import Sequence
from itertools import permutations
from typing import Any

from .bugs import PAIRS, BugError, Wrong
from .records import failing

AT_RANDOM, HIDING = 20, 10

_HEAD = """# Pairs of bugs of the second decoder: `python -m conformance.unseen draw` drew them from the records of the
# single bugs. Where `hides` holds, each vector that the second bug fails is one that the first fails too. The bugs
# of a pair have no clause in common.

seed = {seed}
"""


def _possible(pair: Wrong) -> bool:
    """Whether both bugs can be planted at once, and a diagnosis of one is none of the other."""
    try:
        for text in pair.texts().values():
            ast.parse(text)
    except (BugError, SyntaxError):
        return False
    return not set(pair.bugs[0].clauses) & set(pair.bugs[1].clauses)


def draw(found: Sequence[tuple[Wrong, dict[str, Any]]], seed: int) -> list[Wrong]:
    """The pairs, from the single bugs of the second decoder and their records.

    No bug hides two others or is hidden twice, and none is in more than two of the pairs at random.
    """
    chance = random.Random(seed)
    fails = {wrong.bugs[0]: frozenset(failing(record)) for wrong, record in found}
    every = [Wrong(pair) for pair in permutations(sorted(fails, key=lambda bug: bug.id), 2)]
    chance.shuffle(every)
    drawn: list[Wrong] = []
    for pair in every:
        times = [sum(bug in other.bugs for other in drawn) for bug in pair.bugs]
        met = any(set(pair.bugs) == set(other.bugs) for other in drawn)
        if len(drawn) < AT_RANDOM and max(times) < 2 and not met and _possible(pair):
            drawn.append(pair)
    hiding: list[Wrong] = []
    for pair in every:
        first, second = pair.bugs
        new = all(first != other.bugs[0] and second != other.bugs[1] for other in hiding)
        met = any(set(pair.bugs) == set(other.bugs) for other in drawn)
        if len(hiding) < HIDING and new and not met and fails[second] < fails[first] and _possible(pair):
            hiding.append(Wrong(pair.bugs, hides=True))
    return drawn + hiding


def text(pairs: Sequence[Wrong], seed: int) -> str:
    """The file of the pairs."""
    lines = [_HEAD.format(seed=seed)]
    for pair in pairs:
        names = ", ".join(f'"{bug.id}"' for bug in pair.bugs)
        lines.append(f"[[pair]]\nbugs = [{names}]\nhides = {str(pair.hides).lower()}\n")
    return "\n".join(lines)


def write(pairs: Sequence[Wrong], seed: int) -> None:
    """Writes pairs.toml. Raises OSError."""
    PAIRS.write_text(text(pairs, seed), encoding="utf-8")
