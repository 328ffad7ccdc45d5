"""The record in some lines for a terminal."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from ..grading import GRADES
from .record import STATUSES

# Failures that are shown with their divergence; the rest is in the reports.
_SHOWN = 10
_WORDS = {"unexpected": "known failures that pass", "known": "known failures"}


def lines(record: dict[str, Any]) -> Iterator[str]:
    """What a person wants to know first: what failed, where, and the verdict."""
    bad = [v for v in record["vectors"] if v["status"] in ("failed", "crashed", "unexpected")]
    for v in bad[:_SHOWN]:
        yield f"{v['status'].upper()} {v['id']}: {v['text']}"
        yield from (f"    {line}" for line in v["divergence"])
        yield f"    {v['title']}; read {', '.join(v['clauses'])}; refcodec inspect vectors/{v['input']} --hex"
    if len(bad) > _SHOWN:
        yield f"... and {len(bad) - _SHOWN} more"
    if bad:
        yield ""
    decoder, runner, verdict = record["decoder"]["description"], record["runner"], record["verdict"]
    counts = ", ".join(f"{verdict['counts'][s]} {_WORDS.get(s, s)}" for s in STATUSES if verdict["counts"][s])
    yield f"{decoder['name']} {decoder['version']}: {counts or 'nothing run'}; {runner['seconds']:.1f} s with {runner['jobs']} processes"
    if runner["interrupted"]:
        yield "interrupted: the rest was not run"
    if verdict["grade"] is not None:
        yield f"grade {verdict['grade']} of {max(GRADES)}: {GRADES[verdict['grade']]}"
    for row in record["profiles"]:
        name = row["profile"] if row["level"] is None else f"profile {row['profile']}, level {row['level']}"
        yield f"  {name:<22} {row['verdict']:<10} {row['right']} of {row['needed']} right"
    for name in ("requirements", "features"):
        rows = record[name].values()
        yield f"  {name:<22} {sum(row['right'] == row['vectors'] for row in rows)} of {len(rows)} with all their vectors right"
