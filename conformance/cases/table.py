"""Tables of cases. A row is a vector; the table has what its rows share.

    *refused("header chunks", "limit-off-by-one",
        ("chunk-count-0", "no chunks, though there are anchors", chunk_count, 0),
        ("chunk-count-1", "a chunk, though there are no anchors", main_file, chunk_count, 1),
        ("chunk-count-12", "more chunks than anchors", chunk_count, lambda t: t.header.anchor_count + 1)),
    *refused("packed-weights", "truncation", (grids, cut),
        ("cut-in-table", "the section ends within its table", None, 1),
        ("cut-in-model", "the section ends within a layer's model", "sarm.1", 5)),
    *valid("header chunks", "last-chunk", "R6.2-8",
        ("chunk-count-least", "as few chunks as anchors need", partial(drawn, "chunk-count", 9, chunk_size=4)),
        ("chunks-of-1", "chunks of one anchor", partial(drawn, "chunks-1", 4, chunk_size=1), More(seconds=60))),
    *ordered("R6.10-5",
        ("mask-model-and-chunk-crc", "the mask model, and a CRC-32", (mask_model, 2, 0), (crc, 0, 1))),

Features, flags and requirements are names separated by spaces. What only one row has is its last item, a More. The file
of a row is `plain` if it names no other. An argument of a fault can be a function of the file. Items that several rows
begin with, after their titles, are a tuple before these rows; there, NAME is the name of each row.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from typing import Any, Literal

from refcodec.bitstream import codec
from refcodec.bitstream.scene import Scene

from .checksums import Depth, repair
from .fault import Edit, Fault, Refused, together
from .target import Target
from .targets import plain


@dataclass(frozen=True)
class Seen:
    """The view of another vector's file.

    id, data: of that vector. camera: JSON (vectors/README.md). result: of the manifest, "undrawn" for no image.
    """

    id: str
    data: bytes
    camera: dict[str, Any]
    result: Literal["gaussians", "image", "undrawn"] = "gaussians"


Make = Callable[[], bytes | Refused | Seen]


@dataclass(frozen=True)
class Recipe:
    """A vector: id (its class first), title, function that makes it, and other entries of the manifest."""

    id: str
    title: str
    make: Make
    features: tuple[str, ...]
    requirements: tuple[str, ...] = ()
    flags: tuple[str, ...] = ()
    seconds: int = 10
    licence: str = "CC0-1.0"
    seed: int = 0

    @property
    def klass(self) -> str:
        """The class, which begins the id."""
        return self.id.partition("-")[0]

    @property
    def name(self) -> str:
        """The id without its class."""
        return self.id.partition("-")[2]


@dataclass(frozen=True)
class More:
    """What a row has besides its table, after what the table has, and other fields of Recipe."""

    flags: str = ""
    requirements: str = ""
    features: str = ""
    seconds: int = 10
    licence: str = "CC0-1.0"
    seed: int = 0


# The id without its class, the title, what is special to the table, and maybe a More. Or what the rows after it share.
Row = tuple[Any, ...]
# The name of a row, as an argument that several rows share.
NAME = object()
# A fault and its arguments, or a function that changes the bytes of a file with a fault.
Part = tuple[Any, ...] | Callable[[bytes], bytes]


def path_of(identifier: str) -> str:
    """Returns the path of a vector's file in the suite. The class is its folder."""
    return f"{identifier.replace('-', '/', 1)}.c3gs"


def label_of(path: str) -> str:
    """Returns the path of an element as part of an identifier."""
    return path.replace("_", "-").replace(".", "-").replace("[", "-").replace("]", "")


def valid(features: str, flags: str, requirements: str, *rows: Row, klass: str = "valid") -> list[Recipe]:
    """Returns valid files. A row: name, title, a function that returns a scene, bytes or a view, its arguments."""
    return [
        _recipe(f"{klass}-{name}", title, partial(_emitted, *_own(rest)), rest[-1], features, flags, requirements)
        for name, title, rest in _complete(rows)
    ]


def refused(features: str, flags: str, *rows: Row, requirements: str = "", klass: str = "") -> list[Recipe]:
    """Returns files with a fault. A row: name, title, a function that returns a valid file, a fault, its arguments.

    klass: the class of the files, if it is not that of their errors.
    """
    made = []
    for name, title, rest in _complete(rows):
        base, *part = _own(rest) if not isinstance(rest[0], Fault) else (plain, *_own(rest))
        identifier, make = f"{klass or part[0].klass}-{name}", partial(_broken, base, tuple(part))
        made.append(_recipe(identifier, title, make, rest[-1], features, flags, requirements))
    return made


def ordered(requirements: str, *rows: Row, features: str = "order") -> list[Recipe]:
    """Returns files with several faults, the first of which must be reported (SPEC 10.1).

    A row: name (without `order-of-`), title, a function that returns a valid file, a Part for each fault.
    """
    made = []
    for name, title, *rest in rows:
        base, first, *others = rest if not isinstance(rest[0], tuple) else (plain, *rest)
        identifier, make = f"{first[0].klass}-order-of-{name}", partial(_broken, base, first, *others)
        proved = f"D10.2-3 {requirements}"
        made.append(_recipe(identifier, title, make, None, features, "order-of-checks", proved))
    return made


def chain(
    where: str, base: Callable[[], Target], requirements: str, *links: Row, joint: str = ", and ", **more: str
) -> list[Recipe]:
    """Returns a file for each fault and its successor. The links are faults in the order of checks.

    where: begins identifiers. joint: between titles. more: of `ordered`. A link: name, title, a fault, its arguments.
    """
    pairs = [
        (f"{where}{name}-and-{next_name}", f"{title}{joint}{next_title}", base, tuple(one), tuple(other))
        for (name, title, *one), (next_name, next_title, *other) in pairwise(links)
    ]
    return ordered(requirements, *pairs, **more)


def again(rows: Iterable[Recipe], names: str, where: str, base: Callable[[], Target] | None = None) -> list[Recipe]:
    """Returns the files of other rows of refused files, with the same faults of another valid file, or of version 0.1.

    names: of the other rows, separated by spaces. where: ends their identifiers and titles.
    """
    made = []
    for row in map({row.id: row for row in rows}.__getitem__, names.split()):
        assert isinstance(row.make, partial)
        make = partial(_broken, base, *row.make.args[1:]) if base else partial(_of_later, row.make)
        made.append(replace(row, id=f"{row.id}-{where}", title=f"{row.title}: {where.replace('-', ' ')}", make=make))
    return made


def _of_later(make: Callable[..., Refused]) -> Refused:
    """Returns a refused file as one of minor version 1."""
    made = make()
    data = made.data[:10] + b"\1\0" + made.data[12:]
    return replace(
        made, data=data if made.name in ("prologue.truncated", "prologue.crc") else repair(data, Depth.PROLOGUE)
    )


def _complete(rows: tuple[Row, ...]) -> Iterator[tuple[str, str, list[Any]]]:
    """Yields the name, the title and the other items of each row, including those that it shares."""
    shared: Row = ()
    for row in rows:
        if isinstance(row[0], str):
            name, title, *rest = row
            yield name, title, [name if item is NAME else item for item in (*shared, *rest)]
        else:
            shared = row


def _own(rest: list[Any]) -> list[Any]:
    """Returns the items of a row without its More."""
    return rest[:-1] if isinstance(rest[-1], More) else rest


def _recipe(
    identifier: str, title: str, make: Make, last: object, features: str, flags: str, requirements: str
) -> Recipe:
    """Returns a recipe. last: the last item of the row, which may be a More."""
    more = last if isinstance(last, More) else More()
    names = (f"{features} {more.features}", f"{requirements} {more.requirements}", f"{flags} {more.flags}")
    one, two, three = (tuple(each.split()) for each in names)
    return Recipe(identifier, title, make, one, two, three, more.seconds, more.licence, more.seed)


def _emitted(make: Callable[..., Scene | bytes | Seen], *arguments: Any) -> bytes | Seen:
    made = make(*arguments)
    return codec.emit(made) if isinstance(made, Scene) else made


def _broken(base: Callable[[], Target], *parts: Part) -> Refused:
    """Returns the file with all faults, and the refusal for the first."""
    t, faults = base(), [part for part in parts if isinstance(part, tuple)]
    edits: list[Any] = [broken.broken(t, *_known(t, arguments)) for broken, *arguments in faults]
    if all(isinstance(edit, Edit) for edit in edits):
        made = together(t, *edits)
    else:
        first, *arguments = faults[0]
        made = first(t, *_known(t, arguments))
        for broken, *arguments in faults[1:]:
            t = Target(made.data)
            made = replace(made, data=broken(t, *_known(t, arguments)).data)
    for change in parts:
        made = made if isinstance(change, tuple) else replace(made, data=change(made.data))
    return made


def _known(t: Target, arguments: list[Any]) -> list[Any]:
    """Returns the arguments of a fault, of which some are functions of the file."""
    return [argument(t) if callable(argument) else argument for argument in arguments]
