"""The record of a run as JSON: the data of all other reports. schema.py defines its form."""

from __future__ import annotations

import gzip
import hashlib
import json
import platform
import re
import shutil
import zlib
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from jsonschema import Draft202012Validator
from jsonschema.exceptions import ValidationError, best_match

from refcodec import __version__
from refcodec.files.documents import SIZE_MAX, DocumentError, parse_json, read_json
from refcodec.files.text import printable
from refcodec.inspect.specification import clause_of

from ..manifest import MANIFEST, Accepted, Manifest, Rejected, Vector
from ..runner.grading import GRADE_EXACT, Found, differing
from ..runner.run import Options, Result, Run
from . import diagnosis
from .schema import DECODER, RECORD, REPORT, REPORT_VERSION, STATUSES

# The version of a decoder without a description.
NOT_STATED = "not stated"
# The longest texts of a decoder's description and of an error message, in characters.
_TEXT, _WRONG = 2000, 300
_RECORD, _DESCRIPTION = Draft202012Validator(RECORD), Draft202012Validator(DECODER)


class RecordError(Exception):
    """A file is not a record, or its conclusions contradict its vectors."""


@dataclass(frozen=True)
class About:
    """The context of a run. decoder: its description. select: expressions. started: ISO 8601. seconds: wall time."""

    decoder: dict[str, str]
    select: tuple[str, ...]
    started: str
    seconds: float


def manifest_digest(manifest: Manifest) -> str:
    """Returns the SHA-256 of the manifest file, in hexadecimal."""
    return hashlib.sha256((manifest.folder / MANIFEST).read_bytes()).hexdigest()


def describe(path: Path | None, command: Sequence[str]) -> dict[str, str]:
    """Returns a decoder's description of itself: an object of texts, with `name` and `version`. Raises RecordError."""
    if path is None:
        return {"name": Path(command[0]).name, "version": NOT_STATED}
    try:
        said = read_json(path)
    except DocumentError as error:
        raise RecordError(f"{path}: {error}") from None
    if fault := best_match(_DESCRIPTION.iter_errors(said)):
        raise RecordError(f"{path}: {_words(fault)}")
    return {name: printable(text, _TEXT, lines=name == "notes") for name, text in said.items()}


def seal(record: dict[str, Any]) -> str:
    """Returns the SHA-256 of a record without its own field `sha256`, in hexadecimal.

    The hashed text is JSON in ASCII with sorted names and without spaces.
    """
    rest = {name: value for name, value in record.items() if name != "sha256"}
    return hashlib.sha256(json.dumps(rest, sort_keys=True, separators=(",", ":")).encode()).hexdigest()


def text(record: dict[str, Any]) -> str:
    """Returns a record as JSON, with a line for each vector."""
    before, name, after = json.dumps({**record, "vectors": []}, indent=1).rpartition('"vectors": [')
    vectors = ",\n".join(f"  {json.dumps(vector)}" for vector in record["vectors"])
    return f"{before}{name}\n{vectors}\n {after}\n"


def read(path: Path) -> Any:
    """Returns the value of a report's file, JSON or JSON in gzip. Raises DocumentError for others, and OSError."""
    if path.suffix != ".gz":
        return read_json(path)
    try:
        with gzip.open(path) as file:
            return parse_json(file.read(SIZE_MAX + 1))
    except (gzip.BadGzipFile, EOFError, zlib.error) as error:
        raise DocumentError(f"not a file in gzip ({error})") from None


def packed(record: dict[str, Any]) -> bytes:
    """Returns a record as JSON in gzip, without a time of its own: the same record is the same file."""
    return gzip.compress(text(record).encode(), mtime=0)


def _files(command: Sequence[str]) -> dict[str, str]:
    """Returns the SHA-256 of the program of a command, and of the files among its other words."""
    places = {word: Path(word) for word in command[1:] if Path(word).is_file()}
    if program := shutil.which(command[0]):
        places[command[0]] = Path(program)
    return {word: hashlib.sha256(path.read_bytes()).hexdigest() for word, path in sorted(places.items())}


def _words(fault: ValidationError) -> str:
    """Returns the path and the message of a fault, both of bounded length."""
    return f"{printable(fault.json_path, _WRONG)}: {printable(fault.message, _WRONG)}"


def _printable(value: Any) -> Any:
    """Returns a JSON value with all its texts printable."""
    if isinstance(value, dict):
        return {_printable(name): _printable(inner) for name, inner in value.items()}
    if isinstance(value, list):
        return [_printable(inner) for inner in value]
    return printable(value, lines=True) if isinstance(value, str) and not value.isprintable() else value


def _clauses(vector: Vector) -> list[str]:
    """Returns the clauses to read: first that of the expected error, then those of the requirements."""
    first = [vector.expectation.clause] if isinstance(vector.expectation, Rejected) else []
    return list(dict.fromkeys(first + [clause_of(name) for name in vector.requirements]))


def _expected(vector: Vector) -> dict[str, Any]:
    e = vector.expectation
    if isinstance(e, Rejected):
        return {"result": "rejected", **asdict(e)}
    return (
        {"result": "accepted", "digest": e.digest}
        if isinstance(e, Accepted)
        else {"result": "gaussians", "tolerance": e.tolerance}
    )


def _found(vector: Vector, found: Found) -> dict[str, Any]:
    """Returns a decoder's answer. For a wrong output it lists the parts that differ, without their digests."""
    said = {name: value for name, value in asdict(found).items() if name != "parts"}
    e = vector.expectation
    return said | {"differing": differing(e, found) if isinstance(e, Accepted) and found.result == "accepted" else []}


def _entry(result: Result) -> dict[str, Any]:
    v = result.vector
    return {
        "id": v.id,
        "title": v.title,
        "status": result.status,
        "grade": result.grade,
        "text": result.text,
        "class": v.klass,
        "operation": v.operation,
        "profile": v.profile,
        "level": v.level,
        "requirements": list(v.requirements),
        "features": list(v.features),
        "flags": list(v.flags),
        "clauses": _clauses(v),
        "input": v.input.path,
        "expected": _expected(v),
        "found": _found(v, result.found) if result.found else None,
        "probe": asdict(result.probe) | {"clauses": list(result.probe.clauses)} if result.probe else None,
        "divergence": list(result.divergence),
        "hex": list(result.hex),
        "stderr": result.stderr,
        "seconds": round(result.seconds, 3),
        "peak_bytes": result.peak,
    }


def build(manifest: Manifest, options: Options, about: About, run: Run) -> dict[str, Any]:
    """Returns the record of a run."""
    entries = [_entry(r) for r in run.results]
    record = {
        "report": REPORT,
        "report_version": REPORT_VERSION,
        "suite": {
            "version": manifest.suite_version,
            "format_version": manifest.format_version,
            "manifest_sha256": manifest_digest(manifest),
            "vectors": {v.id: _group(v) for v in manifest.vectors},
        },
        "runner": {
            "version": __version__,
            "python": platform.python_version(),
            "platform": platform.platform(),
            "select": list(about.select),
            "started": about.started,
            "seconds": round(about.seconds, 3),
            "interrupted": run.interrupted,
            **{name: getattr(options, name) for name in ("jobs", "grade", "slow", "trace", "serve")},
        },
        "decoder": {
            "description": about.decoder,
            "command": list(options.command),
            "gaussians": None if options.gaussians is None else list(options.gaussians),
            "files": _files(options.command),
        },
    }
    record |= conclusions(record["suite"]["vectors"], entries, manifest)  # type: ignore[index]
    record["diagnosis"] = diagnosis.of_record(entries)
    # Every report and the terminal show names, commands and descriptions from outside.
    shown: dict[str, Any] = _printable(record | {"vectors": entries})
    return shown | {"sha256": seal(shown)}


def _group(vector: Vector) -> str:
    """Returns the verdict that a vector counts for: that of its profile and level, of rendering, or of any profile."""
    if vector.operation == "gaussians":
        return "rendering"
    return "any" if vector.profile is None else f"{vector.profile} {vector.level}"


def conclusions(groups: dict[str, str], entries: Sequence[dict[str, Any]], manifest: Manifest) -> dict[str, Any]:
    """Returns the conclusions from the entries: counts, grade, coverage, and a verdict for each profile and level.

    groups: the verdict that each vector of the suite counts for. A decoder conforms to a profile and level if each
    vector of that profile up to the level, and each without a profile, passes with the highest grade. Rendering has
    its own verdict.
    """
    counts = Counter(e["status"] for e in entries)
    judged = [e for e in entries if e["status"] != "skipped"]
    profiles = _profiles(groups, entries)
    return {
        "verdict": {
            "conforms": all(row["verdict"] == "conforms" for row in profiles if row["profile"] != "rendering"),
            "grade": min((e["grade"] for e in judged if e["operation"] == "decode"), default=None),
            "counts": {status: counts[status] for status in STATUSES},
            "not_run": len(groups) - len(judged),
        },
        "profiles": profiles,
        "requirements": _coverage(((v.id, v.requirements) for v in manifest.vectors), judged),
        "features": _coverage(((v.id, v.features) for v in manifest.vectors), judged),
    }


def _profiles(groups: dict[str, str], entries: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    grades = {e["id"]: e["grade"] for e in entries if e["status"] != "skipped"}
    rows = []
    for group in sorted(
        set(groups.values()) - {"any"}, key=lambda g: (["tiny", "main", "rendering"].index(g.split()[0]), g)
    ):
        name, _, level = group.partition(" ")
        needed = [
            vector
            for vector, g in groups.items()
            if g == group
            or (name != "rendering" and (g == "any" or (g.startswith(f"{name} ") and int(g.split()[1]) < int(level))))
        ]
        right = sum(grades.get(vector) == GRADE_EXACT for vector in needed)
        wrong = sum(grades.get(vector, GRADE_EXACT) != GRADE_EXACT for vector in needed)
        verdict = "fails" if wrong else "conforms" if right == len(needed) else "incomplete"
        rows.append(
            {
                "profile": name,
                "level": int(level) if level else None,
                "verdict": verdict,
                "needed": len(needed),
                "right": right,
            }
        )
    return rows


def _coverage(
    vectors: Iterable[tuple[str, Iterable[str]]], judged: Sequence[dict[str, Any]]
) -> dict[str, dict[str, int]]:
    """Returns for each name the number of vectors of the suite that have it, were run, and were right."""
    grades = {e["id"]: e["grade"] for e in judged}
    rows: dict[str, dict[str, int]] = {}
    for vector, names in vectors:
        for name in names:
            row = rows.setdefault(name, {"vectors": 0, "run": 0, "right": 0})
            row["vectors"] += 1
            row["run"] += vector in grades
            row["right"] += grades.get(vector) == GRADE_EXACT
    return {name: rows[name] for name in sorted(rows, key=_order)}


def _order(name: str) -> list[tuple[bool, int, str]]:
    """Returns a sort key that orders numbers in names by value."""
    return [(part.isdigit(), int(part) if part.isdigit() else 0, part) for part in re.findall(r"\d+|\D+", name)]


def check(record: Any) -> None:
    """Raises RecordError for a record that the schema does not allow."""
    if fault := best_match(_RECORD.iter_errors(record)):
        raise RecordError(_words(fault))


def load(path: Path) -> dict[str, Any]:
    """Reads a record that the schema allows. Raises RecordError or OSError."""
    try:
        record: dict[str, Any] = read(path)
    except DocumentError as error:
        raise RecordError(f"{path}: {error}") from None
    try:
        check(record)
    except RecordError as error:
        raise RecordError(f"{path}: {error}") from None
    return record
