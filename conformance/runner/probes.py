"""Probes: numbers that a decoder writes into its trace beside the symbols, and the first of them that is wrong.

conformance/README.md has their form. What a decoder writes is hostile: all that is read here is bounded.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from refcodec.bitstream.codec import Coding
from refcodec.bitstream.scene import Scene
from refcodec.files.text import printable
from refcodec.inspect import probes as numbers

from .traces import LINE_BYTES, Probe, lines_of

# So many probes of a trace are compared.
PROBES = 200_000
# Right numbers are computed for so many anchors at once.
_BLOCK = 1024
# So many characters of a name or of a line are shown.
_SHOWN = 60
_FORM = re.compile(r"probe ([a-z_A-Z0-9.]{1,40})\[([0-9]{1,10})\]((?: -?[0-9]{1,20})*)", re.ASCII)

# The clauses that compute a number from others, and which these are.
_OWN = {
    "P": ("7.4",),
    "v": ("7.5.1",),
    "w": ("7.5.2",),
    "u": ("7.5.3",),
    "samples": ("7.5.4",),
    "gamma": ("7.5.5",),
    "means": ("7.2", "7.7"),
    "scales": ("7.2", "7.7"),
    "step_outputs": ("7.2", "7.7"),
    "slice": ("7.9",),
    "steps": ("7.8",),
}
_FROM: dict[str, tuple[str, ...]] = {
    "P": (),
    "v": ("P",),
    "w": ("v",),
    "u": ("w",),
    "samples": ("u",),
    "gamma": ("u",),
    "means": ("samples", "gamma"),
    "scales": ("samples", "gamma"),
    "step_outputs": ("samples", "gamma"),
    "slice": ("means", "scales"),
    "steps": ("step_outputs",),
}


@dataclass
class Compared:
    """What the probes of a trace say.

    first: the first wrong number, None if none is. right: how many probes before it are right. fault: what is wrong
    with the form of the first line that is no probe, empty if nothing is. faults: how many lines are no probes.
    """

    first: Probe | None = None
    right: int = 0
    fault: str = ""
    faults: int = 0

    def lines(self, symbol: bool) -> Iterator[str]:
        """What is told, a line for each thing. symbol: whether a symbol is wrong."""
        if self.first:
            yield f"probe: {self.first.text()}"
        elif self.right and symbol:
            yield f"probe: the {self.right} probes before the first wrong symbol are right"
        if self.fault:
            more = f" ({self.faults} lines are no probes)" if self.faults > 1 else ""
            yield f"probe: {self.fault}{more}"


@dataclass
class _Right:
    """The right numbers of a scene, computed when they are asked for."""

    scene: Scene
    _blocks: dict[int, dict[str, NDArray[np.int64]]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._coding = Coding(self.scene)

    def __call__(self, anchor: int) -> tuple[dict[str, NDArray[np.int64]], int]:
        """The numbers of a block of anchors by name, and the place of an anchor of the scene in it."""
        block, row = divmod(anchor, _BLOCK)
        if block not in self._blocks:
            scene, coding = self.scene, self._coding
            at = slice(block * _BLOCK, min(scene.anchor_count, (block + 1) * _BLOCK))
            known = numbers.before_symbols(scene, coding, at)
            models = [q for pair in numbers.of_slices(scene, coding, at, known) for q in pair]
            self._blocks[block] = {q.name: q.values for q in (*known, *models, numbers.step_numbers(known))}
        return self._blocks[block], row


def _kind(name: str) -> str:
    head = name.partition(".")[0]
    return head if head in ("samples", "slice") else name


def _clauses(scene: Scene, name: str, doubtful: set[str], symbols: bool) -> tuple[str, ...]:
    """The clauses to read for a wrong number.

    doubtful: the kinds of numbers that the file has and that were not written for its anchor. symbols: whether there
    are symbols before it, which tell that planes are right.
    """
    found: list[str] = []
    waiting = [_kind(name)]
    while waiting:
        kind = waiting.pop(0)
        found += _OWN[kind]
        if kind == "P" and scene.position_model is not None:
            found.append("7.12")
        if kind == "samples" and not symbols:
            found.append("7.3")
        waiting += [source for source in _FROM[kind] if source in doubtful]
    return tuple(dict.fromkeys(found))


def compare(scene: Scene, trace: bytes, wrong_symbol: int | None) -> Compared:
    """Compares the probes of a trace with the numbers of the right scene, in the order of the trace.

    wrong_symbol: how many symbols are before the first wrong one, None if none is wrong. What is behind it comes of it,
    and is not compared.
    """
    right, compared, done, symbols, count = _Right(scene), Compared(), set[tuple[str, int]](), 0, 0
    written: dict[int, set[str]] = {}
    for number, (probe, line, whole) in enumerate(lines_of(trace), 1):
        if not probe:
            if symbols == wrong_symbol:
                break
            symbols += 1
            continue
        count += 1
        if count > PROBES:
            break
        said = _read(line, whole, right, done)
        if isinstance(said, str):
            compared.fault = compared.fault or f"line {number} of the trace: {said}"
            compared.faults += 1
            continue
        name, anchor, found, wanted = said
        differs = next((i for i, (a, b) in enumerate(zip(found, wanted, strict=True)) if a != b), None)
        kinds = written.setdefault(anchor, set())
        if differs is not None:
            doubtful = {_kind(known) for known in right(anchor)[0]} - kinds
            clauses = _clauses(scene, name, doubtful, symbols > 0)
            compared.first = Probe(name, anchor, differs, found[differs], wanted[differs], clauses)
            break
        kinds.add(_kind(name))
        compared.right += 1
    return compared


def _read(
    line: bytes, whole: bool, right: _Right, done: set[tuple[str, int]]
) -> tuple[str, int, list[int], list[int]] | str:
    """Name, anchor, numbers and right numbers of a probe, or what is wrong with the line. done: what was read."""
    if not whole:
        return f"a probe of more than {LINE_BYTES} bytes"
    text = line.decode("utf-8", "replace")
    form = _FORM.fullmatch(text)
    if form is None:
        return f"no probe: {printable(text, _SHOWN)}"
    name, anchor, found = form[1], int(form[2]), [int(value) for value in form[3].split()]
    if anchor >= right.scene.anchor_count:
        return f"there is no anchor {anchor}: the file has {right.scene.anchor_count}"
    block, row = right(anchor)
    if name not in block:
        return f"no numbers of this file are called {name}; there are {', '.join(block)}"
    if (name, anchor) in done:
        return f"{name}[{anchor}] is there twice"
    done.add((name, anchor))
    wanted = block[name][row].tolist()
    if len(found) != len(wanted):
        return f"{name}[{anchor}] has {len(found)} numbers, {len(wanted)} expected"
    return name, anchor, found, wanted
