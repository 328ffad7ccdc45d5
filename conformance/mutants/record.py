"""What is committed of the self-test: for each planted bug the first vector that catches it, as JSON and as a table."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

from refcodec.files.documents import DocumentError, read_json
from refcodec.files.stage import Stage

from ..manifest import ManifestError
from .equivalent import PROOFS
from .mutant import Mutant

JSON = Path(__file__).with_name("caught.json")
TABLE = Path(__file__).with_name("CAUGHT.md")

# Bug -> (vector, what was wrong with the decoder's outcome).
Caught = dict[str, tuple[str, str]]

_HEAD = """# Planted bugs

Written by `conformance selftest --write`. Each line is a wrong decoder, made from the second decoder by the change
shown, and the first vector that catches it: the cheapest of those for a requirement that it breaks, or else of all.
Bugs planted by hand name the requirements. The others were made by operators over the syntax tree, and nobody chose
them.

A bug is planted by adding it to `handwritten.toml` and running `conformance selftest --write`. One that survives needs
a vector, or a proof in `equivalent.py`. A vector is a case in the file of its chapter in `conformance/cases/`.
"""


def read(path: Path = JSON) -> Caught:
    """The committed record. Raises OSError, and ManifestError for a file that is none."""
    try:
        document = read_json(path)
        return {name: (str(found["vector"]), str(found["wrong"])) for name, found in document.items()}
    except DocumentError as error:
        raise ManifestError(f"{path}: {error}") from None
    except (AttributeError, KeyError, TypeError):
        raise ManifestError(f"{path}: no record of planted bugs") from None


def _cell(text: str) -> str:
    """Text on one line of a table."""
    line = " ".join(text.split())
    return (line if len(line) <= 100 else line[:97] + "...").replace("|", "\\|")


_TOLD = {
    "another": "another digest",
    "accepted,": "a bad file accepted",
    "refused": "a good file refused",
    "crash": "a crash",
    "hang": "no end",
}


def _summary(mutants: Sequence[Mutant], caught: Mapping[str, tuple[str, str]]) -> str:
    found = [caught[m.id] for m in mutants if m.id in caught]
    right = sum(m.id in PROOFS for m in mutants)
    kinds = Counter(wrong.split()[0] for _, wrong in found)
    shares = [f"{text} {kinds.pop(word, 0)}" for word, text in _TOLD.items()]
    vectors = len({vector for vector, _ in found})
    return (
        f"{len(found)} of {len(mutants) - right} bugs are caught, by {vectors} vectors; "
        f"{right} more changes are proved to be no bugs. "
        f"What gave them away: {', '.join(shares)}, another error {sum(kinds.values())}.\n"
    )


def table(mutants: Sequence[Mutant], caught: Mapping[str, tuple[str, str]]) -> str:
    """The table as Markdown."""
    bugs = [m for m in mutants if m.id not in PROOFS]
    lines = [_HEAD, _summary(mutants, caught)]
    lines += [
        "## By hand\n",
        "| bug | module | what | requirements | first vector | outcome |",
        "|---|---|---|---|---|---|",
    ]
    for m in bugs:
        vector, wrong = caught.get(m.id, ("**none**", ""))
        if m.requirements:
            lines.append(
                f"| {m.id} | {m.module} | {_cell(m.what)} | {', '.join(m.requirements)} | {vector} | {_cell(wrong)} |"
            )
    lines += ["\n## By operators\n", "| bug | text | becomes | first vector | outcome |", "|---|---|---|---|---|"]
    for m in bugs:
        vector, wrong = caught.get(m.id, ("**none**", ""))
        if not m.requirements:
            lines.append(f"| {m.id} | `{_cell(m.old)}` | `{_cell(m.new)}` | {vector} | {_cell(wrong)} |")
    lines += ["\n## No bugs\n", "| change | text | becomes | proof |", "|---|---|---|---|"]
    lines += [f"| {m.id} | `{_cell(m.old)}` | `{_cell(m.new)}` | {PROOFS[m.id]} |" for m in mutants if m.id in PROOFS]
    return "\n".join(lines) + "\n"


def write(mutants: Sequence[Mutant], caught: Mapping[str, tuple[str, str]]) -> None:
    """Writes both files."""
    document = {m.id: {"vector": caught[m.id][0], "wrong": caught[m.id][1]} for m in mutants if m.id in caught}
    with Stage() as stage:
        stage.write(JSON, (json.dumps(document, indent=1) + "\n").encode())
        stage.write(TABLE, table(mutants, caught).encode())
