"""What is committed of the self-test: for each planted bug the first vector that catches it, as JSON and as a table."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

from .equivalent import PROOFS
from .mutant import Mutant

JSON = Path(__file__).with_name("caught.json")
TABLE = Path(__file__).with_name("CAUGHT.md")

# Bug -> (vector, what was wrong with the decoder's outcome).
Caught = dict[str, tuple[str, str]]

_HEAD = """# Planted bugs

Written by `conformance selftest --write`. Each line is a wrong decoder, made from the second decoder by the change shown, and the first
vector that catches it; vectors are tried from the cheapest to the dearest. Bugs planted by hand name the requirements that they break; of the
others, which operators over the syntax tree made, nobody chose any.
"""


def read(path: Path = JSON) -> Caught:
    """The committed record."""
    return {name: (found["vector"], found["wrong"]) for name, found in json.loads(path.read_text(encoding="utf-8")).items()}


def _cell(text: str) -> str:
    """Text on one line of a table."""
    line = " ".join(text.split())
    return (line if len(line) <= 100 else line[:97] + "...").replace("|", "\\|")


def table(mutants: Sequence[Mutant], caught: Mapping[str, tuple[str, str]]) -> str:
    """The table as Markdown."""
    lines = [_HEAD]
    hand = [m for m in mutants if m.requirements]
    rest = [m for m in mutants if not m.requirements]
    right = [m for m in mutants if m.id in PROOFS]
    found = [m for m in mutants if m.id in caught]
    kinds = Counter(caught[m.id][1].split()[0] for m in found)
    told = {"another": "another digest", "accepted,": "a bad file accepted", "refused": "a good file refused", "crash": "a crash", "hang": "no end"}
    shares = [f"{text}: {kinds.pop(word, 0)}" for word, text in told.items()] + [f"another error: {sum(kinds.values())}"]
    lines += [
        f"{len(found)} of {len(mutants) - len(right)} are caught, by {len({caught[m.id][0] for m in found})} vectors; {len(right)} more are proved to be no bugs. "
        f"How they were found out: {'; '.join(shares)}.\n",
        "## By hand\n",
        "| bug | module | what | requirements | first vector | outcome |",
        "|---|---|---|---|---|---|",
    ]  # fmt: skip
    for m in hand:
        vector, wrong = caught.get(m.id, ("**none**", ""))
        if m.id not in PROOFS:
            lines.append(f"| {m.id} | {m.module} | {_cell(m.what)} | {', '.join(m.requirements)} | {vector} | {_cell(wrong)} |")
    lines += ["\n## By operators\n", "| bug | text | becomes | first vector | outcome |", "|---|---|---|---|---|"]
    for m in rest:
        vector, wrong = caught.get(m.id, ("**none**", ""))
        if m.id not in PROOFS:
            lines.append(f"| {m.id} | `{_cell(m.old)}` | `{_cell(m.new)}` | {vector} | {_cell(wrong)} |")
    lines += ["\n## No bugs\n", "| change | text | becomes | proof |", "|---|---|---|---|"]
    lines += [f"| {m.id} | `{_cell(m.old)}` | `{_cell(m.new)}` | {PROOFS[m.id]} |" for m in right]
    return "\n".join(lines) + "\n"


def write(mutants: Sequence[Mutant], caught: Mapping[str, tuple[str, str]]) -> None:
    """Writes both files."""
    document = {m.id: {"vector": caught[m.id][0], "wrong": caught[m.id][1]} for m in mutants if m.id in caught}
    JSON.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
    TABLE.write_text(table(mutants, caught), encoding="utf-8")
