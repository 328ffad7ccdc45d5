"""The lines of a trace: symbols, and probes between them. Nothing here needs numpy, which is slow to import."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterator
from dataclasses import dataclass

_MARK = b"probe "
# So many bytes of a line are read.
LINE_BYTES = 1 << 16
# Nothing is tried again, so that a match of millions of lines takes no memory.
_LINES = re.compile(rb"(?:^probe [^\n]*+(?:\n|\Z))++", re.MULTILINE)


@dataclass(frozen=True)
class Probe:
    """A wrong number.

    name: of the numbers. anchor: in the file. index: among the numbers. clauses: those of SPEC.md to read: that which
    computes it, and then those of the numbers that it comes from and that were not written.
    """

    name: str
    anchor: int
    index: int
    found: int
    wanted: int
    clauses: tuple[str, ...]

    def text(self) -> str:
        """One line."""
        what = f"{self.name}[{self.index}] of anchor {self.anchor}"
        values = f"found {self.found}, wanted {self.wanted}"
        return f"the first number that differs is {what}: {values} (SPEC {', '.join(self.clauses)})"


def has_any(trace: bytes) -> bool:
    """Whether a trace has probes."""
    return _LINES.search(trace) is not None


def symbols_digest(trace: bytes) -> str:
    """SHA-256 of a trace without its probes, hexadecimal."""
    digest, at, whole = hashlib.sha256(), 0, memoryview(trace)
    for found in _LINES.finditer(trace):
        digest.update(whole[at : found.start()])
        at = found.end()
    digest.update(whole[at:])
    return digest.hexdigest()


def lines_of(trace: bytes) -> Iterator[tuple[bool, bytes, bool]]:
    """Yields each line: whether it is a probe, its first LINE_BYTES bytes, and whether these are all."""
    at = 0
    while at < len(trace):
        end = trace.find(b"\n", at)
        end = len(trace) if end < 0 else end
        yield trace.startswith(_MARK, at), trace[at : min(end, at + LINE_BYTES)], end - at <= LINE_BYTES
        at = end + 1
