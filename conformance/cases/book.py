"""Descriptions of vectors before they are generated."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from refcodec.bitstream import codec
from refcodec.bitstream.scene import Scene

from .fault import Refused


@dataclass(frozen=True)
class Seen:
    """The view of another vector's file. id, data: of that vector. camera: JSON (vectors/README.md)."""

    id: str
    data: bytes
    camera: dict[str, Any]


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


def path_of(identifier: str) -> str:
    """Returns the path of a vector's file in the suite. The class is its folder."""
    return f"{identifier.replace('-', '/', 1)}.c3gs"


@dataclass
class Book:
    """The recipes in the order of their chapters."""

    recipes: list[Recipe] = field(default_factory=list)

    def add(
        self, id: str, title: str, make: Make, *, features: str, requirements: str = "", flags: str = "", **more: Any
    ) -> None:
        """Adds a recipe. features, requirements, flags: names separated by spaces. more: fields of Recipe."""
        self.recipes.append(
            Recipe(id, title, make, tuple(features.split()), tuple(requirements.split()), tuple(flags.split()), **more)
        )

    def valid(self, name: str, title: str, make: Callable[[], Scene | bytes], **more: Any) -> None:
        """Adds a valid file from a scene or bytes."""

        def data() -> bytes:
            made = make()
            return made if isinstance(made, bytes) else codec.emit(made)

        self.add(f"valid-{name}", title, data, **more)

    def ordered(
        self, id: str, title: str, make: Callable[[], Refused], requirements: str = "", features: str = "order"
    ) -> None:
        """Adds a file with two faults that tests their order. id: without `order-of-` after its class."""
        klass, _, name = id.partition("-")
        proved = f"D10.2-3 {requirements}"
        self.add(
            f"{klass}-order-of-{name}", title, make, features=features, requirements=proved, flags="order-of-checks"
        )
