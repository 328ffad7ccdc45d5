"""The record as lines for a terminal."""

import os
import re
import shlex
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path

from refcodec.files.text import printable

from ..runner.grading import GRADES
from ..runner.run import STATUSES, Digest, Result
from .record import NOT_STATED
from .schema import Record

# The most failures that are listed.
_SHOWN = 10
# The last lines of a crash's error output, which have the reason in most languages, and their width.
_STDERR_LINES, _WIDTH = 3, 200
# The most wrong requirements or features that are named.
_NAMED = 4
# A clause of a larger share of the vectors is general.
_GENERAL = 0.3
# The anchor of an attribute in a divergence.
_ANCHOR = re.compile(r"^trace: attributes\.\w+\[(\d+),", re.MULTILINE)
_WORDS = {"unexpected": "known failures that pass", "known": "known failures"}


def most_telling(vectors: Sequence[Result]) -> list[Result]:
    """Returns the failures, crashes last. Those of the fewest requirements, which locate the fault best, come first."""
    bad = [v for v in vectors if v.status in ("failed", "crashed", "unexpected")]
    return sorted(bad, key=lambda v: (v.status == "crashed", len(v.requirements)))


def grade(record: Record) -> str:
    """Returns the grade in words, with the number of vectors if some were not run, and whether an output was tested."""
    total, left, lowest = len(record.suite.vectors), record.verdict.not_run, record.verdict.grade
    outputs = any(isinstance(v.expected, Digest) for v in record.vectors)
    means = f": {GRADES[lowest]}" if outputs and lowest is not None else ""
    some = f"; {total - left} of {total} vectors run" if left else ""
    return f"grade {lowest} of {max(GRADES)}{means}{some}{'' if outputs else '; no output was tested'}"


def _general(vectors: Sequence[Result]) -> set[str]:
    """Returns the clauses that too many vectors have."""
    counts = Counter(clause for v in vectors for clause in v.clauses)
    return {clause for clause, count in counts.items() if count > _GENERAL * len(vectors)}


def lines(record: Record, suite: Path) -> Iterator[str]:
    """Yields the first failures with their places, the diagnosis and the verdicts.

    Args:
        record: of a run.
        suite: the folder of the vectors, for the commands that are printed.
    """
    bad, general = most_telling(record.vectors), _general(record.vectors)
    alike: dict[tuple[str, ...], list[Result]] = {}
    for v in bad:
        alike.setdefault((v.text, *v.stderr.splitlines()[-1:]) if v.status == "crashed" else (v.id,), []).append(v)
    shown = list(alike.values())[:_SHOWN]
    for v, *others in shown:
        yield f"{v.status.upper()} {v.id}: {v.text}"
        yield from (f"    {line}" for line in v.divergence)
        if v.status == "crashed":
            yield from (f"    stderr: {line[:_WIDTH]}" for line in v.stderr.splitlines()[-_STDERR_LINES:])
        symbol = _ANCHOR.search("\n".join(v.divergence))
        anchor = v.probe.anchor if v.probe else symbol.group(1) if symbol else None
        form = "--hex" if anchor is None else f"--anchor {anchor}"
        look = shlex.join(["refcodec", "inspect", printable(os.path.relpath(suite / v.input))])
        # General clauses are left out if there are others.
        read = [clause for clause in v.clauses if clause not in general] or v.clauses
        yield f"    {v.title}; read {', '.join(read)}; {look} {form}"
        yield from [f"    {len(others)} more crashed alike"] if others else []
    if more := len(bad) - sum(map(len, shown)):
        yield f"... and {more} more; --report lists all"
    if bad:
        yield ""
    if record.diagnosis and record.diagnosis.text:
        yield from record.diagnosis.text
        yield ""
    decoder, runner, verdict = record.decoder.description, record.runner, record.verdict
    counts = ", ".join(f"{verdict.counts[s]} {_WORDS.get(s, s)}" for s in STATUSES if verdict.counts[s])
    name = decoder.name if decoder.version == NOT_STATED else f"{decoder.name} {decoder.version}"
    yield f"{name}: {counts or 'nothing run'}; {runner.seconds:.1f} s with {runner.jobs} processes"
    if runner.interrupted:
        yield "interrupted: the rest was not run"
    if verdict.grade is not None:
        yield grade(record)
    for row in (row for row in record.profiles if row.right or row.verdict == "fails"):
        name = row.profile if row.level is None else f"profile {row.profile}, level {row.level}"
        yield f"  {name:<22} {row.verdict:<10} {row.right} of {row.needed} right"
    for name in ("requirements", "features"):
        rows = {key: row for key, row in getattr(record, name).items() if row.run}
        wrong = [key for key, row in rows.items() if row.right != row.run]
        which = f"; not {', '.join(wrong)}" if 0 < len(wrong) <= _NAMED else ""
        yield f"  {name:<22} {len(rows) - len(wrong)} of {len(rows)} tested are right in every vector run{which}"
