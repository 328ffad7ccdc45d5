"""A diagnosis in words and as JSON, for the record of a run."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from typing import Any

from refcodec.inspect import specification

from ..manifest import Manifest
from ..runner.traces import Probe
from .diagnose import Clause, Diagnosis, Diagnostician, Likely
from .likeness import Likeness
from .seen import of_entry
from .spectrum import Suspect
from .table import Table, read, vector_key

# A requirement is told if Ochiai's coefficient is so much higher than that of the next one.
SEPARATES = 0.05
# Of fewer vectors the diagnosis says that they are few.
ENOUGH = 300
# A clause of so much less than the first one's score is not told.
FAINT = 0.3
# So many clauses of wrong probes are told.
_CLAUSES = 3
# Of the annotated bytes of a file the place where a decoder stopped, up to its part.
SPOT = re.compile(r"> [0-9a-f]+ +(?:[0-9a-f]{2} )+(?:\.\.\. )? +([a-z_]+)")
# Where the table knows no vector that failed.
_NOTHING: dict[str, Any] = {
    "failing": 0,
    "passing": 0,
    "clear": False,
    "text": [],
    "probes": [],
    "clauses": [],
    "together": [],
    "requirements": [],
}


def _name(clause: str) -> str:
    """A clause's title, empty if it is no clause of SPEC.md."""
    found = specification.own_clauses().get(clause)
    return found.title if found else ""


def _title(clause: str) -> str:
    """Such as `7.5.5 (Positional encoding)`."""
    name = _name(clause)
    return f"{clause} ({name})" if name else clause


def _bug(one: Likely) -> dict[str, Any]:
    bug = one.bug
    return {
        "id": bug.id,
        "what": bug.what,
        "where": f"{bug.scope} of the second decoder",
        "clauses": list(bug.clauses),
        "requirements": list(bug.requirements),
        "likeness": round(one.likeness, 3),
        "failing_alike": one.failing,
        "passing_alike": one.passing,
    }


def _suspect(suspect: Suspect) -> dict[str, Any]:
    known = specification.own_requirements().get(suspect.requirement)
    return {
        "requirement": suspect.requirement,
        "text": known.text if known else "",
        "score": round(suspect.score, 3),
        "failing": suspect.failing,
        "passing": suspect.passing,
        "made": suspect.made,
    }


def _lines(one: Likely | None, d: Diagnosis) -> list[str]:
    """How a known bug is like what was seen."""
    if one is None or not one.failing:
        return ["    no known bug of it does the same"]
    more = d.passing - one.passing
    exact = one.failing == d.failing and not more
    return [
        f"    {'the same as' if exact else 'most like'} a known bug of another decoder: {one.bug.what}",
        f"    it fails {one.failing} of your {d.failing} in the same way, and {more or 'none'} that you pass",
    ]


def _groups(d: Diagnosis) -> list[list[Clause]]:
    """The clauses that are worth a line, those of one bug together."""
    groups: dict[str, list[Clause]] = {}
    for clause in d.clauses:
        if clause.score >= FAINT * d.clauses[0].score:
            groups.setdefault(clause.bug.bug.id if clause.bug else clause.number, []).append(clause)
    return list(groups.values())


def sentences(d: Diagnosis) -> list[str]:
    """What a person is told first, line by line."""
    of = f"of {d.failing + d.passing} vectors that were compared you fail {d.failing}"
    if d.together:
        lines = [f"look for several bugs, in this order; {of}"]
        for one in d.together:
            lines += [f"  {_title(one.bug.clause)}", *_lines(one, d)]
        return lines
    groups = _groups(d)
    if d.clear and groups:
        lines, groups = [f"look first at {_title(groups[0][0].number)}; {of}"], groups[:1]
        lines += _lines(groups[0][0].bug, d)
    else:
        lines = [f"no clause is certain, the likeliest comes first; {of}"]
        for group in groups:
            lines += [f"  {', '.join(_title(clause.number) for clause in group)}", *_lines(group[0].bug, d)]
    ahead = d.suspects[0].score - d.suspects[1].score if len(d.suspects) > 1 else 1.0
    for s in d.suspects[:1] if ahead >= SEPARATES else ():
        sense = "were made for it" if s.made else "run code for it"
        lines.append(f"  {s.requirement} separates best: {s.failing} failing vectors {sense}, {s.passing} passing ones")
    if d.failing + d.passing < ENOUGH:
        lines.append("  run the whole suite: so few vectors say little")
    return lines


def as_json(d: Diagnosis) -> dict[str, Any]:
    """The diagnosis in a record."""
    return {
        "failing": d.failing,
        "passing": d.passing,
        "clear": d.clear,
        "text": sentences(d),
        "probes": [],
        "clauses": [
            {
                "clause": c.number,
                "title": _name(c.number),
                "score": round(c.score, 3),
                "bug": _bug(c.bug) if c.bug else None,
            }
            for c in d.clauses
        ],
        "together": [_bug(one) for one in d.together],
        "requirements": [_suspect(s) for s in d.suspects],
    }


def _of_probes(entries: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """The clauses of the first wrong numbers, that of most vectors first. Of each the plainest vector is told."""
    found: dict[str, list[dict[str, Any]]] = {}
    for entry in sorted((e for e in entries if e["probe"]), key=lambda e: len(e["requirements"])):
        found.setdefault(entry["probe"]["clauses"][0], []).append(entry)
    return [
        {
            "clause": clause,
            "title": _name(clause),
            "vectors": len(of),
            "vector": of[0]["id"],
            "text": Probe(**{**of[0]["probe"], "clauses": tuple(of[0]["probe"]["clauses"])}).text(),
        }
        for clause, of in sorted(found.items(), key=lambda item: -len(item[1]))
    ]


def _with_probes(said: dict[str, Any] | None, probed: list[dict[str, Any]]) -> dict[str, Any] | None:
    """What the table says, behind what probes say. They decide: a wrong number is wrong by its own clause."""
    if not probed:
        return said
    said = said or _NOTHING
    total = sum(of["vectors"] for of in probed)
    lines = []
    for of in probed[:_CLAUSES]:
        lines.append(of["text"])
        share = f"{of['vectors']} of {total} vectors with a wrong number"
        lines.append(f"  read {_title(of['clause'])}; so it is in {share}, such as {of['vector']}")
    # What the table says is told where it says the same clause, in other words.
    agrees = any(clause["clause"] == probed[0]["clause"] for clause in said["clauses"][:1])
    return said | {"clear": True, "text": lines + (said["text"] if agrees else []), "probes": probed}


def of_record(
    manifest: Manifest, entries: Sequence[dict[str, Any]], grade: int, table: Table | None = None
) -> dict[str, Any] | None:
    """What the entries of a record say. grade: that was demanded.

    None if no vector failed. A vector whose file or expectation is another one than the table's does not count.
    """
    if all(entry["status"] in ("passed", "skipped", "unexpected") for entry in entries):
        return None
    said = _with_probes(_of_table(manifest, entries, grade, table), _of_probes(entries))
    return said and said | {"text": said["text"] + _refused(entries)}


def _refused(entries: Sequence[dict[str, Any]]) -> list[str]:
    """A line that says in which parts of valid files the decoder stops: where it goes wrong, or soon behind it."""
    refused = [
        e
        for e in entries
        if e["found"] and e["found"]["result"] == "rejected" and e["expected"]["result"] == "accepted"
    ]
    counts = Counter(spot[1] for e in refused for line in e["hex"] if (spot := SPOT.match(line)))
    parts = ", ".join(f"{part} ({count})" for part, count in counts.most_common())
    return [f"  you refuse {len(refused)} valid files, in their {parts}"] if parts else []


def _of_table(
    manifest: Manifest, entries: Sequence[dict[str, Any]], grade: int, table: Table | None
) -> dict[str, Any] | None:
    """What the fingerprints say of the entries of a record."""
    found = table or read()
    vectors = {v.id: v for v in manifest.vectors}
    # A vector of another suite may have the name of one that the table knows.
    other = {name for name, key in found.vectors if name in vectors and vector_key(vectors[name]) != key}
    seen = {e["id"]: what for e in entries if e["id"] not in other and (what := of_entry(e, grade)) is not None}
    purposes = {v.id: v.requirements for v in manifest.vectors}
    diagnosis = Diagnostician(Likeness(found), purposes).diagnose(seen)
    return as_json(diagnosis) if diagnosis else None
