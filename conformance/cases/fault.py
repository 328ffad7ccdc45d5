"""Faults: each way to break a file, defined once.

The module of a chapter defines a fault as a function of a valid file and of arguments. The function returns the changed
bytes, and the offset of the error:

    @fault("planes.length", (0, 4), [1, -1])
    def sub_plane_length(t: Target, plane: int, change: int) -> Edit:
        ...

After the name of the error comes how each argument is drawn: from the least to the most, one of a list, or by a
function of a Draw, the file and the arguments before it. The rows of the suite have a fault with chosen arguments
(table.py). The fuzzer and the tests draw them, with the Draw of conformance/fuzz/strategies.py, which uses hypothesis.
Thus the suite does not need hypothesis.

Three usual kinds of faults need no function: `element`, a wrong value; `padding`, a byte that is not zero; and `ends`,
a file that is cut.
"""

import re
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
    """The source of drawn arguments of faults."""

    def integer(self, low: int, high: int) -> int:
        """Draws an integer between bounds, both included."""

    def flag(self) -> bool:
        """Draws True or False."""

    def choice(self, items: Sequence[T]) -> T:
        """Draws one of the items. Without items the file has no place for the fault."""

    def content(self, low: int, high: int) -> bytes:
        """Draws low to high bytes."""


# How an argument is drawn. A function that returns a tuple draws several arguments.
Spec = tuple[int, int] | list[Any] | Callable[..., Any]
# The arguments of a fault: a file, possibly not the given one, and the others.
Drawn = tuple[Any, ...]


class Fault(Generic[P]):
    """A kind of fault. error: the name of its error (SPEC 10.2). name: those of the error and of the fault.

    draw: draws the arguments, with a Draw and a valid file of Tiny. None if only the suite has the fault.
    """

    def __init__(
        self,
        error: str,
        name: str,
        broken: Callable[Concatenate[Target, P], Edit | Whole],
        drawn: Sequence[Spec] = (),
        base: Callable[[Draw, Target], Target] | None = None,
    ) -> None:
        """drawn: how each argument is drawn. base: draws a file, if the given one has no place for the fault."""
        self.error, self.name = error, f"{error}/{name}"
        self._broken, self._drawn, self._base = broken, drawn, base
        self.draw: Callable[[Draw, Target], Drawn] | None = self._draw if drawn or base else None
        if self.name in FAULTS:
            raise ValueError(f"two faults are named {self.name}")
        FAULTS[self.name] = self

    @property
    def klass(self) -> str:
        """The class of its error."""
        return REGISTRY[self.error].klass

    def __call__(self, t: Target, *args: P.args, **kwargs: P.kwargs) -> Refused:
        """Returns the file with this fault."""
        made = self.broken(t, *args, **kwargs)
        return Refused(made.data, self.error, made.offset) if isinstance(made, Whole) else together(t, made)

    def broken(self, t: Target, *args: P.args, **kwargs: P.kwargs) -> Edit | Whole:
        """Returns the fault as one of several in a file (together)."""
        made = self._broken(t, *args, **kwargs)
        return replace(made, error=self.error) if isinstance(made, Edit) else made

    def target(self, base: Callable[[], Target], *args: P.args, **kwargs: P.kwargs) -> Callable[[], Target]:
        """Returns a function that makes a file with this fault, for another fault. Its container must be valid."""
        return lambda: Target(self(base(), *args, **kwargs).data)

    def _draw(self, draw: Draw, t: Target) -> Drawn:
        t = self._base(draw, t) if self._base else t
        made: Drawn = ()
        for spec in self._drawn:
            value = _value(spec, draw, t, made)
            made += value if isinstance(value, tuple) else (value,)
        return t, *made


def _value(spec: Spec, draw: Draw, t: Target, made: Drawn = ()) -> Any:
    if isinstance(spec, tuple):
        return draw.integer(*spec)
    return draw.choice(spec) if isinstance(spec, list) else spec(draw, t, *made)


def either(*specs: Spec) -> Spec:
    """Returns how an argument is drawn that is drawn in one of several ways."""
    return lambda draw, t, *made: _value(draw.choice(specs), draw, t, made)


# All faults by name, once the chapters are imported (cases.faults).
FAULTS: dict[str, Fault[...]] = {}


def fault(
    error: str, *drawn: Spec, base: Callable[[Draw, Target], Target] | None = None
) -> Callable[[Callable[Concatenate[Target, P], Edit | Whole]], Fault[P]]:
    """Decorates the definition of a fault that has the named error. drawn, base: as of Fault."""
    return lambda broken: Fault(error, broken.__name__, broken, drawn, base)


# --- faults of usual kinds --------------------------------------------------------------------------------------------


def _first(path: str) -> str:
    """Returns the path of the first reserved byte for one of several."""
    return re.sub(r"reserved\[.\]", "reserved[0]", path)


def element(
    error: str,
    path: str,
    *drawn: Spec,
    name: str = "",
    reported: str | Callable[..., int] | None = None,
    right: Depth = Depth.CHUNKS,
    base: Callable[[Draw, Target], Target] | None = None,
) -> Fault[...]:
    """Returns the fault that an element has a wrong value. By default it has the name of the element.

    path: of the element. The first arguments of the fault fill its braces, the last is the value. reported: the path of
    the reported element, if it is another, or a function that returns the offset. The item 0 of a list of reserved
    bytes is reported for all of them. drawn, base: as of Fault. right: as of Edit.
    """

    def wrong(t: Target, *arguments: Any) -> Edit:
        *places, value = arguments
        at = reported(t, *places) if callable(reported) else t.at(_first((reported or path).format(*places)))
        return Edit(t.pack({path.format(*places): value}), at, right)

    name = name or path.rpartition(".")[2].replace("[{}]", "").replace("{}", "value")
    return Fault(error, name, wrong, drawn, base)


def wrong_value(error: str, values: Mapping[str, Sequence[float]]) -> Fault[...]:
    """Returns the fault that one of several elements has a wrong value. Its arguments are a path and the value.

    values: the wrong values to draw, by path. The item 0 of a list of reserved bytes is reported for all of them.
    """

    def value(t: Target, path: str, value: float) -> Edit:
        return Edit(t.pack({path: value}), t.at(_first(path)))

    def present(draw: Draw, t: Target) -> str:
        return draw.choice([path for path in values if t.has(path)])

    return Fault(error, "value", value, [present, lambda draw, t, path: draw.choice(values[path])])


def padding(error: str, pattern: str, base: Callable[[Draw, Target], Target] | None = None) -> Fault[[str, int, int]]:
    """Returns the fault that a byte of padding is not zero. The first byte of the padding is reported.

    Its arguments are the path of the padding, the byte's place in it, and its value. pattern: of possible paths.
    """

    def padding(t: Target, path: str, place: int, value: int) -> Edit:
        return Edit({t.at(path) + place: bytes([value])}, t.at(path))

    def path(draw: Draw, t: Target) -> str:
        return draw.choice([path for path in t.elements if re.fullmatch(pattern, path)])

    def place(draw: Draw, t: Target, path: str) -> int:
        return draw.integer(0, t.element(path).end - t.at(path) - 1)

    return Fault(error, "padding", padding, [path, place, (1, 255)], base)


def ends(error: str, name: str, *drawn: Spec) -> Fault[[int]]:
    """Returns the fault that the file ends too early. Its argument is the file's length, which is reported."""
    return Fault(error, name, lambda t, length: Whole(t.data[:length], length), drawn)


# --- several faults ---------------------------------------------------------------------------------------------------


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
