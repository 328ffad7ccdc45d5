"""Metadata (SPEC.md 6.14) as texts and files state it."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from ..bitstream.metadata import emit_metadata, with_metadata
from ..bitstream.scene import Scene
from ..files.documents import DocumentError, read_toml
from ..statuses import UsageError


def stated_entries(stated: Sequence[str] | Mapping[str, str]) -> dict[str, str]:
    """Returns the entries by key. An empty value removes an entry.

    stated: entries, or texts KEY=VALUE, and names of TOML files. Raises UsageError for entries that SPEC 6.14 does not
    allow.
    """
    entries = dict(stated) if isinstance(stated, Mapping) else {}
    texts = () if isinstance(stated, Mapping) else stated
    if not isinstance(texts, list | tuple) or not all(isinstance(text, str) for text in texts):
        raise UsageError(f"metadata must be entries by key, or texts KEY=VALUE, not {stated!r:.60}")
    for text in texts:
        key, sign, value = text.partition("=")
        entries |= {key: value} if sign else _of_file(Path(text))
    if wrong := [key for key, value in entries.items() if not isinstance(value, str)]:
        raise UsageError(f"the metadata entry {wrong[0]} must be a text")
    try:
        emit_metadata({key: value for key, value in entries.items() if value})
    except ValueError as error:
        raise UsageError(str(error)) from None
    return entries


def _of_file(path: Path) -> dict[str, str]:
    """Returns the entries of a TOML file with string values. Keys with dots may be written as tables."""
    try:
        document = read_toml(path)
    except OSError as error:
        raise UsageError(f"--meta {path} is neither KEY=VALUE nor a file: {error.strerror or error}") from None
    except DocumentError as error:
        raise UsageError(f"--meta {path} cannot be read: {error}") from None
    return dict(_flat(path, "", document))


def _flat(path: Path, prefix: str, table: Mapping[str, object]) -> Iterator[tuple[str, str]]:
    for name, value in table.items():
        if isinstance(value, dict):
            yield from _flat(path, f"{prefix}{name}.", value)
        elif isinstance(value, str):
            yield prefix + name, value
        else:
            raise UsageError(f"--meta {path}: {prefix}{name} must be a string: put it in quotes")


def with_entries(scene: Scene, entries: Mapping[str, str]) -> Scene:
    """Returns the scene with changed entries of its metadata. Raises UsageError if they are too many."""
    try:
        return replace(scene, ancillary=with_metadata(scene.ancillary, entries)) if entries else scene
    except ValueError as error:
        raise UsageError(str(error)) from None
