"""The option --meta of the commands that write a scene: metadata (SPEC.md 6.14)."""

# Modules that need NumPy are imported where they are used, so that help is instant.
# ruff: noqa: PLC0415

from __future__ import annotations

import argparse
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from .shared import UsageError

if TYPE_CHECKING:
    from ..bitstream.scene import Scene


def add_meta(parser: argparse.ArgumentParser) -> None:
    """Adds the option to a command."""
    parser.add_argument(
        "--meta",
        metavar="KEY=VALUE|FILE",
        action="append",
        default=[],
        help="write a metadata entry (SPEC.md 6.14), such as title=Kitchen, or the entries of a TOML file; an empty "
        "value removes the entry; repeatable",
    )


def metadata_of(arguments: argparse.Namespace) -> dict[str, str]:
    """Returns the given entries by key. Raises UsageError for entries that SPEC 6.14 does not allow."""
    from ..bitstream.metadata import emit_metadata

    entries: dict[str, str] = {}
    for given in arguments.meta:
        key, sign, value = given.partition("=")
        entries |= {key: value} if sign else _of_file(Path(given))
    try:
        emit_metadata({key: value for key, value in entries.items() if value})
    except ValueError as error:
        raise UsageError(str(error)) from None
    return entries


def _of_file(path: Path) -> dict[str, str]:
    """Returns the entries of a TOML file with string values. Keys with dots may be written as tables."""
    from ..files.documents import TOML_MAX, DocumentError, parse_toml

    try:
        with path.open("rb") as file:
            document = parse_toml(file.read(TOML_MAX + 1))
    except OSError as error:
        raise UsageError(f"--meta {path} is neither KEY=VALUE nor a file: {error.strerror or error}") from None
    except DocumentError as error:
        raise UsageError(f"--meta {path} cannot be read: {error}") from None
    return dict(_flat(path, "", document))


def _flat(path: Path, prefix: str, table: Mapping[str, object]) -> list[tuple[str, str]]:
    entries: list[tuple[str, str]] = []
    for name, value in table.items():
        if isinstance(value, dict):
            entries += _flat(path, f"{prefix}{name}.", value)
        elif isinstance(value, str):
            entries.append((prefix + name, value))
        else:
            raise UsageError(f"--meta {path}: {prefix}{name} must be a string: put it in quotes")
    return entries


def with_entries(scene: Scene, entries: Mapping[str, str]) -> Scene:
    """Returns the scene with changed entries of its metadata. Raises UsageError if they are too many."""
    from ..bitstream.metadata import with_metadata

    try:
        return replace(scene, ancillary=with_metadata(scene.ancillary, entries)) if entries else scene
    except ValueError as error:
        raise UsageError(str(error)) from None
