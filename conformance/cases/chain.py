"""Files with two faults, from chains of faults in the order of checks (10.1)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from typing import Any

from refcodec.bitstream.errors import REGISTRY

from . import entropy_substreams
from .book import Book
from .fault import Fault, Part, Refused, several
from .target import Target


class Link:
    """A fault in a chain. name: for identifiers. text: for titles. The other fields: the fault and its arguments."""

    def __init__(self, name: str, text: str, broken: Fault[...], *args: Any) -> None:
        self.name, self.text, self.broken, self.args = name, text, broken, args

    @property
    def klass(self) -> str:
        """The class of its error."""
        return REGISTRY[self.broken.error].klass

    @property
    def part(self) -> Part:
        """The fault as one of several."""
        return self.broken.edit(*self.args)


def chain(book: Book, base: Callable[[], Target], where: str, links: list[Link], requirements: str = "") -> None:
    """Adds a file for each fault and its successor. where: the faulty part, for identifiers."""
    for first, second in pairwise(links):
        book.ordered(
            f"{first.klass}-{where}-{first.name}-and-{second.name}",
            f"{first.text}, and {second.text}",
            several(base, first.part, second.part),
            requirements,
        )


def also(first: Callable[[], Refused], second: Fault[...], *args: Any) -> Callable[[], Refused]:
    """Returns a function that makes a file with a fault, and with another one that must not be reported."""

    def made() -> Refused:
        refused = first()
        return replace(refused, data=second(Target(refused.data), *args).data)

    return made


def other_symbols(path: str, name: str = "", text: str = "") -> Link:
    """Returns a changed symbol_crc of a substream."""
    return Link(name or "symbols", text or f"symbol_crc of {path}", entropy_substreams.symbol_crc, path, 0, 0x55)
