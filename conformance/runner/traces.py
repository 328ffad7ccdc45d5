"""Reads the lines of a trace: symbols and probes. This module does not import numpy, which is slow to import."""

import hashlib
import re
from collections.abc import Iterator
from typing import Annotated

from msgspec import Meta

from ..manifest import Count, Strict

_MARK = b"probe "
# The longest line that is read, in bytes.
LINE_BYTES = 1 << 16
# Without backtracking, a match of millions of lines needs no memory.
_LINES = re.compile(rb"(?:^probe [^\n]*+(?:\n|\Z))++", re.MULTILINE)


class Probe(Strict, frozen=True):
    """A wrong number.

    name: of the numbers. anchor: in the file. index: among the numbers. clauses: of SPEC.md; first that of the number,
    then those of the numbers that it depends on and that the trace does not have.
    """

    name: str
    anchor: Count
    index: Count
    found: int
    wanted: int
    clauses: Annotated[tuple[str, ...], Meta(min_length=1)]

    def text(self) -> str:
        """Returns the wrong number as one line."""
        what = f"{self.name}[{self.index}] of anchor {self.anchor}"
        values = f"found {self.found}, wanted {self.wanted}"
        return f"the first number that differs is {what}: {values} (SPEC {', '.join(self.clauses)})"


def has_any(trace: bytes) -> bool:
    """Returns whether a trace has probes."""
    return _LINES.search(trace) is not None


def symbols_digest(trace: bytes) -> str:
    """Returns the SHA-256 of a trace without its probes, in hexadecimal."""
    digest, at, whole = hashlib.sha256(), 0, memoryview(trace)
    for match in _LINES.finditer(trace):
        digest.update(whole[at : match.start()])
        at = match.end()
    digest.update(whole[at:])
    return digest.hexdigest()


def lines_of(trace: bytes) -> Iterator[tuple[bool, bytes, bool]]:
    """Yields for each line whether it is a probe, its first LINE_BYTES bytes, and whether these are the whole line."""
    at = 0
    while at < len(trace):
        end = trace.find(b"\n", at)
        end = len(trace) if end < 0 else end
        yield trace.startswith(_MARK, at), trace[at : min(end, at + LINE_BYTES)], end - at <= LINE_BYTES
        at = end + 1
