"""Faults: each way to break a file, defined once.

The file of a chapter defines a fault as a function of a valid file and of parameters. The function says which bytes
change, and which offset the error must tell. What draws the parameters stands beside it:

    @fault("planes.length")
    def sub_plane_length(t: Target, plane: int, change: int) -> Edit:
        ...

    @sub_plane_length.drawn
    def _(draw: Draw, t: Target) -> Drawn:
        return t, draw.integer(0, 4), draw.choice([1, -1])

The suite lists the fault with chosen parameters: `book.add(..., sub_plane_length.of(plain, 4, -1), ...)`. The fuzzer
and the tests draw them, with the Draw of conformance/fuzz/strategies.py, which is made of hypothesis's strategies. So
the suite itself does without hypothesis.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Concatenate, Generic, ParamSpec, Protocol, TypeVar

from refcodec.bitstream.errors import REGISTRY, ErrorKind

from .checksums import Depth, repair
from .target import Target

P = ParamSpec("P")
T = TypeVar("T")


@dataclass(frozen=True)
class Refused:
    """A file that must be refused: name of the error and its offset (SPEC 10.2)."""

    data: bytes
    name: str
    offset: int

    @property
    def kind(self) -> ErrorKind:
        """The error's row in the registry."""
        return REGISTRY[self.name]


@dataclass(frozen=True)
class Edit:
    """A fault that leaves a file as long as it is.

    puts: bytes by their offset. offset: what the error must tell. right: how far in checksums are made right after it;
    the others stay as they were. error: its name, which the Fault fills in.
    """

    puts: Mapping[int, bytes]
    offset: int
    right: Depth = Depth.CHUNKS
    error: str = ""


@dataclass(frozen=True)
class Whole:
    """A fault that makes a file of another length: its bytes, and the offset that the error must tell."""

    data: bytes
    offset: int


class Draw(Protocol):
    """Where the parameters of a fault come from when they are drawn."""

    def integer(self, low: int, high: int) -> int:
        """An integer, both ends included."""

    def flag(self) -> bool:
        """Yes or no."""

    def choice(self, items: Sequence[T]) -> T:
        """One of the items. Without items the file has no place for the fault, and nothing is drawn."""

    def content(self, low: int, high: int) -> bytes:
        """Any bytes, low to high of them."""


# What a fault is called with: a file, which may be another than the one that was given, and the parameters. None if
# the file has no place for the fault.
Drawn = tuple[Any, ...] | None


class Fault(Generic[P]):
    """One way to break a file. error: the name of its error (SPEC 10.2). name: the error's and the fault's own."""

    def __init__(self, error: str, name: str, broken: Callable[Concatenate[Target, P], Edit | Whole]) -> None:
        self.error, self.name = error, f"{error}/{name}"
        self._broken = broken
        self.draw: Callable[[Draw, Target], Drawn] | None = None
        if self.name in FAULTS:
            raise ValueError(f"two faults are named {self.name}")
        FAULTS[self.name] = self

    def __call__(self, t: Target, *args: P.args, **kwargs: P.kwargs) -> Refused:
        """The file with this fault."""
        made = self._broken(t, *args, **kwargs)
        if isinstance(made, Whole):
            return Refused(made.data, self.error, made.offset)
        return together(t, replace(made, error=self.error))

    def of(self, base: Callable[[], Target], *args: P.args, **kwargs: P.kwargs) -> Callable[[], Refused]:
        """What makes a file with this fault, when it is asked for."""
        return lambda: self(base(), *args, **kwargs)

    def target(self, base: Callable[[], Target], *args: P.args, **kwargs: P.kwargs) -> Callable[[], Target]:
        """What makes a file with this fault, as one that another fault is put into. Its container must be valid."""
        return lambda: Target(self(base(), *args, **kwargs).data)

    def edit(self, *args: P.args, **kwargs: P.kwargs) -> Callable[[Target], Edit]:
        """The fault as one of several in a file (together). It must be one that leaves the file as long as it is."""

        def made(t: Target) -> Edit:
            found = self._broken(t, *args, **kwargs)
            assert isinstance(found, Edit)
            return replace(found, error=self.error)

        return made

    def drawn(self, draw: Callable[[Draw, Target], Drawn]) -> None:
        """Decorates what draws the arguments."""
        self.draw = draw


# All faults by name, once the chapters are imported (cases.faults).
FAULTS: dict[str, Fault[...]] = {}


def fault(error: str) -> Callable[[Callable[Concatenate[Target, P], Edit | Whole]], Fault[P]]:
    """Decorates the definition of a fault that has the named error."""
    return lambda broken: Fault(error, broken.__name__, broken)


def wrong_value(
    error: str, values: Mapping[str, Sequence[float]], told: Callable[[str], str] = str
) -> Fault[[str, float]]:
    """The fault that one element has another value. Its parameters are the element's path and the value.

    values: the wrong values to draw, by path. told: from the path of the wrong element to that of the one that is told.
    """

    def value(t: Target, path: str, value: float) -> Edit:
        return Edit(t.pack({path: value}), t.at(told(path)))

    made: Fault[[str, float]] = Fault(error, "value", value)

    @made.drawn
    def _(draw: Draw, t: Target) -> Drawn:
        paths = [path for path in values if t.has(path)]
        if not paths:
            return None
        path = draw.choice(paths)
        return t, path, draw.choice(values[path])

    return made


def one_field(t: Target, path: str, value: float) -> Edit:
    """An element with another value, which is the one that is told."""
    return Edit(t.pack({path: value}), t.at(path))


# A fault of a file, as one of several.
Part = Callable[[Target], Edit]


def several(base: Callable[[], Target], *parts: Part) -> Callable[[], Refused]:
    """What makes a file with several faults, the first of which must be told, when it is asked for."""
    return lambda: together(base(), *(part(base()) for part in parts))


def together(t: Target, first: Edit, *others: Edit) -> Refused:
    """The file with one fault or several, the first of which must be told (SPEC 10.1)."""
    data = t.data
    for depth in sorted(Depth, reverse=True):
        out = bytearray(data)
        # The first fault's bytes stay whatever the others put there.
        puts = [put for edit in (*others, first) if edit.right == depth for put in edit.puts.items()]
        for at, value in puts:
            out[at : at + len(value)] = value
        if puts:
            data = repair(bytes(out), depth)
    return Refused(data, first.error, first.offset)
