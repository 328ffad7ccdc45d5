"""What the generator knows of a vector before it makes it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from refcodec.bitstream import codec
from refcodec.bitstream.scene import Scene


@dataclass(frozen=True)
class Refused:
    """A file and the error that it has: name and offset (SPEC 10.2)."""

    data: bytes
    name: str
    offset: int


@dataclass(frozen=True)
class Seen:
    """The file of another vector by its path, and a camera (vectors/README.md)."""

    path: str
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


@dataclass
class Book:
    """Recipes in the order of the manifest."""

    recipes: list[Recipe] = field(default_factory=list)

    def add(
        self, id: str, title: str, make: Make, *, features: str, requirements: str = "", flags: str = "", **more: Any
    ) -> None:
        """Adds a recipe; features, requirements and flags are names with blanks between them."""
        self.recipes.append(
            Recipe(id, title, make, tuple(features.split()), tuple(requirements.split()), tuple(flags.split()), **more)
        )

    def valid(self, name: str, title: str, make: Callable[[], Scene | bytes], **more: Any) -> None:
        """Adds a valid file, given as a scene or as bytes."""

        def data() -> bytes:
            made = make()
            return made if isinstance(made, bytes) else codec.emit(made)

        self.add(f"valid-{name}", title, data, **more)
