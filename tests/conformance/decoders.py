"""The decoders of the project behind one interface."""

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

import c_program
import web_program

from conformance.fuzz import compare
from conformance.fuzz.compare import Verdict


class Decoder(Protocol):
    """A decoder of whole files."""

    def verdict(self, data: bytes) -> Verdict:
        """Returns name and offset of its error, or the digest and -1."""


@dataclass(frozen=True)
class Decoders:
    """refcodec by NumPy and by each variant of the kernel, the blocks of SPEC.md, and those of `others` by name."""

    others: dict[str, Decoder] = field(default_factory=dict)

    def agreed(self, data: bytes, expected: Verdict | None = None) -> Verdict:
        """Returns the verdict of all. The encoder gives an accepted file again (SPEC 4.3)."""
        verdict, wrong = compare.compare(data, expected)
        assert wrong is None, wrong
        assert {name: other.verdict(data) for name, other in self.others.items()} == dict.fromkeys(self.others, verdict)
        return verdict


# The programs that each other decoder needs, by name; None is missing.
NEEDED = {"C": c_program.COMPILER, "web": web_program.NODE}


@contextlib.contextmanager
def started(folder: Path) -> Iterator[Decoders]:
    """Yields all decoders but those whose program is missing. folder: for their files."""
    every: dict[str, Decoder] = {}
    with contextlib.ExitStack() as stack:
        if NEEDED["C"]:
            every["C"] = c_program.compiled(folder)
        if NEEDED["web"]:
            every["web"] = stack.enter_context(web_program.running(folder))
        yield Decoders(every)
