"""A diagnosis in words and as JSON, for the record of a run."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from refcodec.inspect import specification

from ..manifest import Manifest
from ..runner.traces import Probe
from .diagnose import Diagnosis, Diagnostician, Likely
from .likeness import Likeness
from .seen import of_entry
from .spectrum import Suspect
from .table import Table, read, vector_key

# A requirement is told if Ochiai's coefficient is so much higher than that of the next one.
SEPARATES = 0.05
# Of fewer vectors the diagnosis says that they are few.
ENOUGH = 300
# So many clauses of wrong probes are told.
_CLAUSES = 3
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


def _title(clause: str) -> str:
    """Such as `7.5.5 (Positional encoding)`."""
    found = specification.own_clauses().get(clause)
    return f"{clause} ({found.title})" if found else clause


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


def _like(one: Likely, d: Diagnosis) -> str:
    return f"{one.failing} of {d.failing} fail alike, {one.passing} of {d.passing} pass alike"


def sentences(d: Diagnosis) -> list[str]:
    """What a person is told first, line by line."""
    first = d.clauses[0] if d.clauses else None
    if d.together:
        lines = ["your failures are those of a decoder with several bugs; mend them in this order:"]
        lines += [f"  {_title(one.bug.clause)}: as if {one.bug.what}; {_like(one, d)}" for one in d.together]
        return lines
    if d.clear and first is not None and first.bug is not None and first.bug.failing:
        what = f"your failures are those of a decoder with this bug in {_title(first.number)}: {first.bug.bug.what}"
        return [what, f"  {_like(first.bug, d)}"]
    if d.clear and first is not None:
        lines = [f"your failures point to {_title(first.number)}; no planted bug of it does the same"]
    else:
        lines = ["no rule is clearly the one that is broken; read these first:"]
        for clause in d.clauses:
            like = f": as if {clause.bug.bug.what}; {_like(clause.bug, d)}" if clause.bug and clause.bug.failing else ""
            lines.append(f"  {_title(clause.number)}{like}")
    ahead = d.suspects[0].score - d.suspects[1].score if len(d.suspects) > 1 else 1.0
    for s in d.suspects[:1] if ahead >= SEPARATES else ():
        sense = "were made for it" if s.made else "run code for it"
        lines.append(f"  {s.requirement} separates best: {s.failing} failing vectors {sense}, {s.passing} passing ones")
    if d.failing + d.passing < ENOUGH:
        lines.append(f"  only {d.failing + d.passing} vectors could be compared: run the whole suite for more")
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
                "title": specification.own_clauses()[c.number].title if c.number in specification.own_clauses() else "",
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
            "title": specification.own_clauses()[clause].title if clause in specification.own_clauses() else "",
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

    None if no vector failed that the table knows, and none has a wrong probe. A vector whose file or
    expectation is another one is not known.
    """
    if all(entry["status"] in ("passed", "skipped", "unexpected") for entry in entries):
        return None
    return _with_probes(_of_table(manifest, entries, grade, table), _of_probes(entries))


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
