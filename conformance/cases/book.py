"""What the generator knows of a vector before it makes it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from refcodec.bitstream import codec
from refcodec.bitstream.scene import Scene

from .fault import Refused


@dataclass(frozen=True)
class Seen:
    """What a camera sees of the file of another vector. id, data: that vector's; camera: JSON (vectors/README.md)."""

    id: str
    data: bytes
    camera: dict[str, Any]


Make = Callable[[], bytes | Refused | Seen]


@dataclass(frozen=True)
class Recipe:
    """A vector: id (its class first), title, how it is made, and what the manifest says of it beside that."""

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
        """The class, the beginning of the id."""
        return self.id.partition("-")[0]

    @property
    def name(self) -> str:
        """The id without its class."""
        return self.id.partition("-")[2]


def path_of(identifier: str) -> str:
    """Where the suite has the file of a vector: the class is its folder."""
    return f"{identifier.replace('-', '/', 1)}.c3gs"


@dataclass
class Book:
    """The recipes, in the order in which the chapters add them."""

    recipes: list[Recipe] = field(default_factory=list)

    def add(
        self, id: str, title: str, make: Make, *, features: str, requirements: str = "", flags: str = "", **more: Any
    ) -> None:
        """Adds a recipe. features, requirements, flags: names with blanks between them. more: fields of Recipe."""
        self.recipes.append(
            Recipe(id, title, make, tuple(features.split()), tuple(requirements.split()), tuple(flags.split()), **more)
        )

    def valid(self, name: str, title: str, make: Callable[[], Scene | bytes], **more: Any) -> None:
        """Adds a valid file, given as a scene or as bytes."""

        def data() -> bytes:
            made = make()
            return made if isinstance(made, bytes) else codec.emit(made)

        self.add(f"valid-{name}", title, data, **more)

    def ordered(
        self, id: str, title: str, make: Callable[[], Refused], requirements: str = "", features: str = "order"
    ) -> None:
        """Adds a file with two faults, whose order is what it tests. id: without `order-of-` behind its class."""
        klass, _, name = id.partition("-")
        proved = f"D10.2-3 {requirements}"
        self.add(
            f"{klass}-order-of-{name}", title, make, features=features, requirements=proved, flags="order-of-checks"
        )
