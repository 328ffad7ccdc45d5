"""The committed record of the self-test: the first vector that catches each planted bug, one bug on each line."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

from refcodec.files.documents import DocumentError, read_json
from refcodec.files.stage import write_file

from ..manifest import ManifestError
from .equivalent import PROOFS
from .mutant import Mutant

JSON = Path(__file__).with_name("caught.json")

# Bug -> (vector, what was wrong with the decoder's outcome).
Caught = dict[str, tuple[str, str]]


def read(path: Path = JSON) -> Caught:
    """Returns the committed record. Raises OSError, and ManifestError if the file is not a record."""
    try:
        return {name: (str(vector), str(wrong)) for name, (vector, wrong) in read_json(path).items()}
    except DocumentError as error:
        raise ManifestError(f"{path}: {error}") from None
    except (AttributeError, TypeError, ValueError):
        raise ManifestError(f"{path} is not a record of planted bugs") from None


def write(mutants: Sequence[Mutant], caught: Mapping[str, tuple[str, str]]) -> None:
    """Writes the record."""
    lines = [f"{json.dumps(m.id)}: {json.dumps(caught[m.id])}" for m in mutants if m.id in caught]
    write_file(JSON, ("{\n" + ",\n".join(lines) + "\n}\n").encode())


def _cell(text: str) -> str:
    """Returns text for a cell of a table in Markdown."""
    line = " ".join(text.split())
    return (line if len(line) <= 100 else line[:97] + "...").replace("|", "\\|")


def table(mutants: Sequence[Mutant], caught: Mapping[str, tuple[str, str]]) -> str:
    """Returns a table in Markdown of all bugs, with the change and the first vector that catches each."""
    lines = ["| bug | requirements | mistake | text | becomes | first vector | outcome |", "|" + "---|" * 7]
    for m in mutants:
        vector, wrong = caught.get(m.id, ("**none**", PROOFS.get(m.id, "")))
        cells = (
            m.id,
            ", ".join(m.requirements),
            m.what,
            f"`{_cell(m.old)}`",
            f"`{_cell(m.new)}`",
            vector,
            _cell(wrong),
        )
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"
