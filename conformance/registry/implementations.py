"""The TOML files of the registry: who made an implementation, how it is run, and where its report is."""

from __future__ import annotations

import re
import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from jsonschema import Draft202012Validator
from jsonschema.exceptions import best_match

from refcodec.files.documents import TOML_MAX, DocumentError, parse_toml
from refcodec.files.text import printable
from refcodec.statuses import UsageError

# The forms of a scene that an encoder may take (matrix.py).
FORMS = ("json", "folder", "ply")
# A text that needs no escape in Markdown, HTML and SVG.
_TEXT = {"type": "string", "pattern": r"^[^\x00-\x1f<>|\[\]`*&\"\\]{1,80}$"}
_COMMAND = {"type": "string", "pattern": r"^[^\x00-\x1f`]{1,1000}$"}
_DECODER = {
    "type": "object",
    "properties": {
        **dict.fromkeys(("build", "run", "serve", "gaussians"), _COMMAND),
        "report": {"type": "string", "pattern": r"^[\w-]+(/[\w.-]+)*\.json\.gz$"},
    },
    "required": ["run", "report"],
    "additionalProperties": False,
}
_ENCODER = {
    "type": "object",
    "properties": dict.fromkeys(("build", *FORMS), _COMMAND),
    "minProperties": 1,
    "additionalProperties": False,
}
_FIELDS = ("name", "version", "author", "licence", "language")
_SCHEMA = Draft202012Validator(
    {
        "type": "object",
        "properties": {
            **dict.fromkeys(_FIELDS, _TEXT),
            "source": {"type": "string", "pattern": r"^(https://)?[\w./~%+-]{1,200}$"},
            "decoder": _DECODER,
            "encoder": _ENCODER,
        },
        "required": [*_FIELDS, "source"],
        "anyOf": [{"required": ["decoder"]}, {"required": ["encoder"]}],
        "additionalProperties": False,
    }
)


@dataclass(frozen=True)
class Implementation:
    """An implementation. key: the name of its file. source: an address, or a path in the repository.

    decoder, encoder: their tables, empty for none.
    """

    key: str
    name: str
    version: str
    author: str
    licence: str
    language: str
    source: str
    decoder: dict[str, str]
    encoder: dict[str, str]

    @property
    def command(self) -> list[str]:
        """The command that the suite runs: that which serves, if there is one."""
        return shlex.split(self.decoder.get("serve", self.decoder["run"]))

    @property
    def description(self) -> dict[str, str]:
        """The decoder's description in a report."""
        return {
            "name": self.name,
            "version": self.version,
            "language": self.language,
            "author": self.author,
            "url": self.source,
        }


def load(folder: Path) -> list[Implementation]:
    """Reads the TOML files of a folder, in the order of their names. Raises UsageError or OSError."""
    found = [_read(path) for path in sorted(folder.glob("*.toml"))]
    if not found:
        raise UsageError(f"{folder} has no TOML file of an implementation: docs/certify.md has an example")
    return found


def _read(path: Path) -> Implementation:
    if not re.fullmatch(r"[\w-]+", path.stem):
        raise UsageError(f"{printable(str(path))}: its name may have letters, digits, - and _ only")
    with path.open("rb") as file:
        try:
            said: dict[str, Any] = parse_toml(file.read(TOML_MAX + 1))
        except DocumentError as error:
            raise UsageError(f"{path}: {error}") from None
    if fault := best_match(_SCHEMA.iter_errors(said)):
        raise UsageError(f"{path}: {printable(f'{fault.json_path}: {fault.message}', 300)}")
    if hidden := [name for name in _FIELDS if not said[name].isprintable()]:
        raise UsageError(f"{path}: {hidden[0]} has characters that are not printable")
    said = {"decoder": {}, "encoder": {}, **said}
    for command in (*said["decoder"].values(), *said["encoder"].values()):
        try:
            shlex.split(command)
        except ValueError as error:
            raise UsageError(f"{path}: {command}: {error}") from None
    return Implementation(path.stem, **said)
