"""The TOML files of the registry: who made an implementation, how it is run, and where its report is."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Annotated, Literal

from msgspec import Meta, Struct

from refcodec.files.documents import checked, read_toml
from refcodec.files.text import printable
from refcodec.statuses import UsageError

# A text that needs no escape in Markdown, HTML and SVG.
Text = Annotated[str, Meta(pattern=r"^[^\x00-\x1f<>|\[\]`*&\"\\]{1,80}\Z")]
Command = Annotated[str, Meta(pattern=r"^[^\x00-\x1f`]{1,1000}\Z")]


class Decoder(Struct, frozen=True, forbid_unknown_fields=True):
    """How a decoder is run: the commands of `conformance run`, and one that builds it. report: a path."""

    run: Command
    report: Annotated[str, Meta(pattern=r"^[\w-]+(/[\w.-]+)*\.json\.gz\Z")]
    serve: Command | None = None
    gaussians: Command | None = None
    build: Command | None = None

    @property
    def words(self) -> list[str]:
        """The command that the suite runs: that which serves, if there is one."""
        return shlex.split(self.serve or self.run)


class Implementation(Struct, frozen=True, forbid_unknown_fields=True):
    """An implementation. key: the name of its file. source: an address, or a path in the repository.

    encoder: the commands for the forms of a scene that it takes (matrix.py). Commands that build a program are shown on
    the page, and never run.
    """

    key: Annotated[str, Meta(pattern=r"^[\w-]+\Z")]
    name: Text
    version: Text
    author: Text
    licence: Text
    language: Text
    source: Annotated[str, Meta(pattern=r"^(https://)?[\w./~%+-]{1,200}\Z")]
    decoder: Decoder | None = None
    encoder: dict[Literal["json", "folder", "ply", "build"], Command] = {}

    @property
    def description(self) -> dict[str, str]:
        """The decoder's description in a report."""
        own = {name: getattr(self, name) for name in ("name", "version", "language", "author")}
        return {**own, "url": self.source}


def load(folder: Path) -> list[Implementation]:
    """Reads the TOML files of a folder, in the order of their names. Raises UsageError or OSError."""
    implementations = [_read(path) for path in sorted(folder.glob("*.toml"))]
    if not implementations:
        raise UsageError(f"{folder} has no TOML file of an implementation: docs/certify.md has an example")
    return implementations


def _read(path: Path) -> Implementation:
    try:
        read: Implementation = checked({**read_toml(path), "key": path.stem}, Implementation)
        for name in ("name", "version", "author", "licence", "language"):
            if not getattr(read, name).isprintable():
                raise ValueError(f"{name} has characters that are not printable")
        decoder = read.decoder and (read.decoder.run, read.decoder.serve, read.decoder.gaussians)
        for command in (each for each in (*(decoder or ()), *read.encoder.values()) if each is not None):
            if not shlex.split(command):
                raise ValueError("a command has no words")
        if not (read.decoder or read.encoder):
            raise ValueError("it needs [decoder] or [encoder]")
    except ValueError as error:
        raise UsageError(f"{printable(str(path))}: {printable(str(error), 300)}") from None
    return read
