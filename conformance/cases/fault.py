"""Faults: each way to break a file, defined once.

The module of a chapter defines a fault as a function of a valid file and of parameters. The function returns the
changed bytes, and the offset of the error. A second function draws the parameters:

    @fault("planes.length")
    def sub_plane_length(t: Target, plane: int, change: int) -> Edit:
        ...

    @sub_plane_length.drawn
    def _(draw: Draw, t: Target) -> Drawn:
        return t, draw.integer(0, 4), draw.choice([1, -1])

The suite lists the fault with chosen parameters: `book.add(..., sub_plane_length.of(plain, 4, -1), ...)`. The fuzzer
and the tests draw them, with the Draw of conformance/fuzz/strategies.py, which uses hypothesis. Thus the suite does not
need hypothesis.
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
    """The expected refusal of a file: name and offset of the error (SPEC 10.2)."""

    data: bytes
    name: str
    offset: int

    @property
    def kind(self) -> ErrorKind:
        """The error's row in the registry."""
        return REGISTRY[self.name]


@dataclass(frozen=True)
class Edit:
    """A fault that does not change the length of a file.

    puts: bytes by their offset. offset: of the error. right: the depth to which checksums are repaired afterwards.
    error: its name, which the Fault fills in.
    """

    puts: Mapping[int, bytes]
    offset: int
    right: Depth = Depth.CHUNKS
    error: str = ""


@dataclass(frozen=True)
class Whole:
    """A fault that changes the length of a file: the resulting bytes, and the offset of the error."""

    data: bytes
    offset: int


class Draw(Protocol):
    """The source of drawn parameters of faults."""

    def integer(self, low: int, high: int) -> int:
        """Draws an integer between bounds, both included."""

    def flag(self) -> bool:
        """Draws True or False."""

    def choice(self, items: Sequence[T]) -> T:
        """Draws one of the items. Without items the file has no place for the fault."""

    def content(self, low: int, high: int) -> bytes:
        """Draws low to high bytes."""


# The arguments of a fault: a file, possibly not the given one, and parameters. None if the file has no place for the
# fault.
Drawn = tuple[Any, ...] | None


class Fault(Generic[P]):
    """A kind of fault. error: the name of its error (SPEC 10.2). name: those of the error and of the fault."""

    def __init__(self, error: str, name: str, broken: Callable[Concatenate[Target, P], Edit | Whole]) -> None:
        self.error, self.name = error, f"{error}/{name}"
        self._broken = broken
        self.draw: Callable[[Draw, Target], Drawn] | None = None
        if self.name in FAULTS:
            raise ValueError(f"two faults are named {self.name}")
        FAULTS[self.name] = self

    def __call__(self, t: Target, *args: P.args, **kwargs: P.kwargs) -> Refused:
        """Returns the file with this fault."""
        made = self._broken(t, *args, **kwargs)
        if isinstance(made, Whole):
            return Refused(made.data, self.error, made.offset)
        return together(t, replace(made, error=self.error))

    def of(self, base: Callable[[], Target], *args: P.args, **kwargs: P.kwargs) -> Callable[[], Refused]:
        """Returns a function that makes a file with this fault."""
        return lambda: self(base(), *args, **kwargs)

    def target(self, base: Callable[[], Target], *args: P.args, **kwargs: P.kwargs) -> Callable[[], Target]:
        """Returns a function that makes a file with this fault, for another fault. Its container must be valid."""
        return lambda: Target(self(base(), *args, **kwargs).data)

    def edit(self, *args: P.args, **kwargs: P.kwargs) -> Callable[[Target], Edit]:
        """Returns the fault as one of several in a file (together). It must not change the file's length."""

        def made(t: Target) -> Edit:
            found = self._broken(t, *args, **kwargs)
            assert isinstance(found, Edit)
            return replace(found, error=self.error)

        return made

    def drawn(self, draw: Callable[[Draw, Target], Drawn]) -> None:
        """Decorates the function that draws the arguments."""
        self.draw = draw


# All faults by name, once the chapters are imported (cases.faults).
FAULTS: dict[str, Fault[...]] = {}


def fault(error: str) -> Callable[[Callable[Concatenate[Target, P], Edit | Whole]], Fault[P]]:
    """Decorates the definition of a fault that has the named error."""
    return lambda broken: Fault(error, broken.__name__, broken)


def wrong_value(
    error: str, values: Mapping[str, Sequence[float]], told: Callable[[str], str] = str
) -> Fault[[str, float]]:
    """Returns the fault that an element has a wrong value. Its parameters are the element's path and the value.

    values: the wrong values to draw, by path. told: maps the path of the wrong element to that of the reported one.
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
    """An element has a wrong value, and is reported."""
    return Edit(t.pack({path: value}), t.at(path))


# A fault of a file, as one of several.
Part = Callable[[Target], Edit]


def several(base: Callable[[], Target], *parts: Part) -> Callable[[], Refused]:
    """Returns a function that makes a file with several faults, the first of which must be reported."""
    return lambda: together(base(), *(part(base()) for part in parts))


def together(t: Target, first: Edit, *others: Edit) -> Refused:
    """Returns the file with faults, the first of which must be reported (SPEC 10.1)."""
    data = t.data
    for depth in sorted(Depth, reverse=True):
        out = bytearray(data)
        # The first fault's bytes have precedence.
        puts = [put for edit in (*others, first) if edit.right == depth for put in edit.puts.items()]
        for at, value in puts:
            out[at : at + len(value)] = value
        if puts:
            data = repair(bytes(out), depth)
    return Refused(data, first.error, first.offset)
