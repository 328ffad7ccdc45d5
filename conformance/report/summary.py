"""The record in some lines for a terminal."""

from __future__ import annotations

import os
import re
import shlex
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from refcodec.files.text import printable

from ..runner.grading import GRADES
from .record import NOT_STATED
from .schema import STATUSES

# Failures that are shown with their divergence; the rest is in the reports.
_SHOWN = 10
# Of a crash's error output the end, which has the reason in most languages.
_STDERR_LINES, _WIDTH = 3, 200
# So many requirements or features that are not right are named.
_NAMED = 4
# A clause of a larger share of the vectors is a general one.
_GENERAL = 0.3
# An attribute's anchor in a divergence: what leads to its distributions can be shown.
_ANCHOR = re.compile(r"^trace: attributes\.\w+\[(\d+),", re.MULTILINE)
_WORDS = {"unexpected": "known failures that pass", "known": "known failures"}


def most_telling(vectors: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """The vectors that are not as they must be. Those of the fewest requirements, nearest to the place, come first."""
    bad = [v for v in vectors if v["status"] in ("failed", "crashed", "unexpected")]
    return sorted(bad, key=lambda v: len(v["requirements"]))


def _from_here(path: Path) -> str:
    """A path as a person would type it. The folder of this process may be gone: then the whole path."""
    try:
        return printable(os.path.relpath(path))
    except OSError:
        return printable(str(path))


def _general(vectors: Sequence[dict[str, Any]]) -> set[str]:
    """The clauses of so many vectors that they lead nowhere."""
    counts = Counter(clause for v in vectors for clause in v["clauses"])
    return {clause for clause, count in counts.items() if count > _GENERAL * len(vectors)}


def _own(vector: dict[str, Any], general: set[str]) -> list[str]:
    """The clauses to read for a vector: not the general ones, if it has others."""
    return [clause for clause in vector["clauses"] if clause not in general] or vector["clauses"]


def lines(record: dict[str, Any], suite: Path) -> Iterator[str]:
    """What a person wants to know first: what failed, where, and the verdict.

    Args:
        record: what `record.build` made.
        suite: the folder of the vectors, for the commands that are printed.
    """
    bad, general = most_telling(record["vectors"]), _general(record["vectors"])
    for v in bad[:_SHOWN]:
        yield f"{v['status'].upper()} {v['id']}: {v['text']}"
        yield from (f"    {line}" for line in v["divergence"])
        if v["status"] == "crashed":
            yield from (f"    stderr: {line[:_WIDTH]}" for line in v["stderr"].splitlines()[-_STDERR_LINES:])
        symbol = _ANCHOR.search("\n".join(v["divergence"]))
        anchor = v["probe"]["anchor"] if v["probe"] else symbol.group(1) if symbol else None
        form = "--hex" if anchor is None else f"--anchor {anchor}"
        look = shlex.join(["refcodec", "inspect", _from_here(suite / v["input"])])
        yield f"    {v['title']}; read {', '.join(_own(v, general))}; {look} {form}"
    if len(bad) > _SHOWN:
        yield f"... and {len(bad) - _SHOWN} more, which --report shows"
    if bad:
        yield ""
    if record["diagnosis"]:
        yield from record["diagnosis"]["text"]
        yield ""
    decoder, runner, verdict = record["decoder"]["description"], record["runner"], record["verdict"]
    counts = ", ".join(f"{verdict['counts'][s]} {_WORDS.get(s, s)}" for s in STATUSES if verdict["counts"][s])
    name = decoder["name"] if decoder["version"] == NOT_STATED else f"{decoder['name']} {decoder['version']}"
    yield f"{name}: {counts or 'nothing run'}; {runner['seconds']:.1f} s with {runner['jobs']} processes"
    if runner["interrupted"]:
        yield "interrupted: the rest was not run"
    if verdict["grade"] is not None:
        yield f"grade {verdict['grade']} of {max(GRADES)}: {GRADES[verdict['grade']]}"
    for row in record["profiles"]:
        name = row["profile"] if row["level"] is None else f"profile {row['profile']}, level {row['level']}"
        yield f"  {name:<22} {row['verdict']:<10} {row['right']} of {row['needed']} right"
    for name in ("requirements", "features"):
        rows = record[name]
        others = [key for key, row in rows.items() if row["right"] != row["vectors"]]
        which = f"; not {', '.join(others)}" if 0 < len(others) <= _NAMED else ""
        yield f"  {name:<22} {len(rows) - len(others)} of {len(rows)} with all their vectors right{which}"
