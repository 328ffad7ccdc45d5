"""Compares the probes of a trace, the numbers that a program writes beside the symbols, with the right numbers.

conformance/README.md defines their form. A trace may be hostile: all reads are bounded.
"""

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

# The most probes of a trace that are compared.
PROBES = 200_000
# The number of anchors whose right numbers are computed at once.
_BLOCK = 1024
# The longest name or line in a message, in characters.
_SHOWN = 60
_FORM = re.compile(r"probe ([a-z_A-Z0-9.]{1,40})\[([0-9]{1,10})\]((?: -?[0-9]{1,20})*)", re.ASCII)

# Of each number the clauses that define it, and the numbers that it is computed from.
_NUMBERS: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "P": (("7.4",), ()),
    "v": (("7.5.1",), ("P",)),
    "w": (("7.5.2",), ("v",)),
    "u": (("7.5.3",), ("w",)),
    "samples": (("7.5.4",), ("u",)),
    "gamma": (("7.5.5",), ("u",)),
    **dict.fromkeys(("means", "scales", "step_outputs"), (("7.2", "7.7"), ("samples", "gamma"))),
    "slice": (("7.9",), ("means", "scales")),
    "steps": (("7.8",), ("step_outputs",)),
}


@dataclass
class Compared:
    """The comparison of the probes of a trace.

    first: the first wrong number, or None. right: the number of right probes before it. fault: the first fault of
    form, or empty. faults: the number of lines with such a fault.
    """

    first: Probe | None = None
    right: int = 0
    fault: str = ""
    faults: int = 0

    def lines(self, symbol: bool) -> Iterator[str]:
        """Yields the lines of a report. symbol: whether a symbol is wrong."""
        if self.first:
            yield f"probe: {self.first.text()}"
        elif self.right and symbol:
            yield f"probe: the {self.right} probes before the first wrong symbol are right"
        if self.fault:
            more = f" ({self.faults} lines are not valid probes)" if self.faults > 1 else ""
            yield f"probe: {self.fault}{more}"


@dataclass
class OfScene:
    """The right numbers of a scene, computed on demand."""

    scene: Scene
    _blocks: dict[int, dict[str, NDArray[np.int64]]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.anchors, self.packed = self.scene.anchor_count, self.scene.position_model is not None
        self._coding = Coding(self.scene)

    def __call__(self, anchor: int) -> tuple[dict[str, NDArray[np.int64]], int]:
        """Returns the numbers of an anchor's block by name, and the row of the anchor in the block."""
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


def _clauses(packed: bool, name: str, doubtful: set[str], symbols: bool) -> tuple[str, ...]:
    """Returns the clauses to read for a wrong number.

    doubtful: the kinds of numbers that the trace lacks for the anchor. symbols: whether symbols precede the number; the
    planes are then right.
    """
    clauses: list[str] = []
    waiting = [_kind(name)]
    while waiting:
        kind = waiting.pop(0)
        own, sources = _NUMBERS[kind]
        clauses += own
        if kind == "P" and packed:
            clauses.append("7.12")
        if kind == "samples" and not symbols:
            clauses.append("7.3")
        waiting += [source for source in sources if source in doubtful]
    return tuple(dict.fromkeys(clauses))


def compare(right: OfScene, trace: bytes, wrong_symbol: int | None) -> Compared:
    """Compares the probes of a trace with the right numbers, in the order of the trace.

    wrong_symbol: the number of symbols before the first wrong one, None if all are right. Probes after it depend on it,
    and are not compared.
    """
    compared, done, symbols, count = Compared(), set[tuple[str, int]](), 0, 0
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
        reading = _read(line, whole, right, done)
        if isinstance(reading, str):
            compared.fault = compared.fault or f"line {number} of the trace: {reading}"
            compared.faults += 1
            continue
        name, anchor, given, wanted = reading
        differs = next((i for i, (a, b) in enumerate(zip(given, wanted, strict=True)) if a != b), None)
        kinds = written.setdefault(anchor, set())
        if differs is not None:
            doubtful = {_kind(known) for known in right(anchor)[0]} - kinds
            clauses = _clauses(right.packed, name, doubtful, symbols > 0)
            compared.first = Probe(name, anchor, differs, given[differs], wanted[differs], clauses)
            break
        kinds.add(_kind(name))
        compared.right += 1
    return compared


def _read(
    line: bytes, whole: bool, right: OfScene, done: set[tuple[str, int]]
) -> tuple[str, int, list[int], list[int]] | str:
    """Returns name, anchor, numbers and right numbers of a probe, or its fault.

    done: the names and anchors so far.
    """
    if not whole:
        return f"a probe of more than {LINE_BYTES} bytes"
    text = line.decode("utf-8", "replace")
    form = _FORM.fullmatch(text)
    if form is None:
        return f"not a probe: {printable(text, _SHOWN)}"
    name, anchor, given = form[1], int(form[2]), [int(value) for value in form[3].split()]
    if anchor >= right.anchors:
        return f"there is no anchor {anchor}: the file has {right.anchors}"
    block, row = right(anchor)
    if name not in block:
        return f"this file has no numbers {name}; it has {', '.join(block)}"
    if (name, anchor) in done:
        return f"{name}[{anchor}] is repeated"
    done.add((name, anchor))
    wanted = block[name][row].tolist()
    if len(given) != len(wanted):
        return f"{name}[{anchor}] has {len(given)} numbers, {len(wanted)} expected"
    return name, anchor, given, wanted
