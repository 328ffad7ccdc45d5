"""The record of a run as JSON: the data of all other reports. schema.py defines its form."""

import hashlib
import json
import platform
import re
import shutil
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import msgspec
from msgspec import to_builtins

from refcodec import __version__
from refcodec.files.documents import DocumentError, read_json
from refcodec.files.text import printable

from ..manifest import MANIFEST, Manifest, Vector
from ..runner.grading import GRADE_EXACT
from ..runner.run import STATUSES, Options, Result, Run
from . import diagnosis
from .schema import Coverage, Decoder, Description, Profile, Record, Runner, Suite, Verdict

# The verdicts that are not of decoders, by the operation.
SEEN = {"gaussians": "gaussians", "render": "rendering"}

T = TypeVar("T")
# The version of a decoder without a description.
NOT_STATED = "not stated"
# The longest texts of a decoder's description and of an error message, in characters.
_TEXT, _WRONG = 2000, 300


class RecordError(Exception):
    """A file is not a record, or its conclusions contradict its vectors."""


@dataclass(frozen=True)
class About:
    """The context of a run. decoder: its description. select: expressions. started: ISO 8601. seconds: wall time."""

    decoder: Description
    select: tuple[str, ...]
    started: str
    seconds: float


def manifest_digest(manifest: Manifest) -> str:
    """Returns the SHA-256 of the manifest file, in hexadecimal."""
    return hashlib.sha256((manifest.folder / MANIFEST).read_bytes()).hexdigest()


def _converted(document: Any, kind: type[T]) -> T:
    """Returns a JSON value as a struct. Raises RecordError."""
    try:
        return msgspec.convert(document, kind)
    except msgspec.ValidationError as error:
        raise RecordError(printable(str(error), _WRONG)) from None


def describe(path: Path | None, command: Sequence[str]) -> Description:
    """Returns a decoder's description of itself: an object of texts, with `name` and `version`. Raises RecordError."""
    if path is None:
        return Description(Path(command[0]).name, NOT_STATED)
    try:
        texts = to_builtins(_converted(read_json(path), Description))
    except (DocumentError, RecordError) as error:
        raise RecordError(f"{path}: {error}") from None
    return Description(**{name: printable(text, _TEXT, lines=name == "notes") for name, text in texts.items()})


def seal(record: dict[str, Any]) -> str:
    """Returns the SHA-256 of a record without its own member `sha256`, in hexadecimal.

    The hashed text is JSON in ASCII with sorted names and without spaces.
    """
    rest = {name: value for name, value in record.items() if name != "sha256"}
    return hashlib.sha256(json.dumps(rest, sort_keys=True, separators=(",", ":")).encode()).hexdigest()


def text(record: Record) -> str:
    """Returns a record as JSON, with a line for each vector."""
    document = to_builtins(record)
    before, name, after = json.dumps({**document, "vectors": []}, indent=1).rpartition('"vectors": [')
    vectors = ",\n".join(f"  {json.dumps(vector)}" for vector in document["vectors"])
    return f"{before}{name}\n{vectors}\n {after}\n"


def _files(command: Sequence[str]) -> dict[str, str]:
    """Returns the SHA-256 of the program of a command, and of the files among its other words."""
    places = {word: Path(word) for word in command[1:] if Path(word).is_file()}
    if program := shutil.which(command[0]):
        places[command[0]] = Path(program)
    return {word: hashlib.sha256(path.read_bytes()).hexdigest() for word, path in sorted(places.items())}


def _printable(value: Any) -> Any:
    """Returns a JSON value with all its texts printable."""
    if isinstance(value, dict):
        return {_printable(name): _printable(inner) for name, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_printable(inner) for inner in value]
    return printable(value, lines=True) if isinstance(value, str) and not value.isprintable() else value


def build(manifest: Manifest, options: Options, about: About, run: Run) -> Record:
    """Returns the record of a run."""
    groups = {v.id: _group(v) for v in manifest.vectors}
    versions = __version__, platform.python_version(), platform.platform()
    chosen = {name: getattr(options, name) for name in ("jobs", "grade", "slow", "trace", "serve")}
    parts = {
        "suite": Suite(manifest.suite_version, manifest.format_version, manifest_digest(manifest), groups),
        "runner": Runner(*versions, about.select, about.started, round(about.seconds, 3), run.interrupted, **chosen),
        "decoder": Decoder(about.decoder, options.command, options.gaussians, options.render, _files(options.command)),
        **conclusions(groups, run.results, manifest),
        "diagnosis": diagnosis.of_results(run.results),
        "vectors": tuple(run.results),
    }
    # Every report and the terminal show names, commands and descriptions from outside.
    document = _printable(to_builtins(Record(**parts, sha256="")))
    record: Record = msgspec.convert({**document, "sha256": seal(document)}, Record)
    return record


def _group(vector: Vector) -> str:
    """Returns the verdict that a vector counts for: of its profile and level, lists, images, or any profile."""
    if vector.operation in SEEN:
        return SEEN[vector.operation]
    return "any" if vector.profile is None else f"{vector.profile} {vector.level}"


def conclusions(groups: dict[str, str], results: Sequence[Result], manifest: Manifest) -> dict[str, Any]:
    """Returns the conclusions from results: counts, grade, coverage, and a verdict for each profile and level.

    groups: the verdict that each vector of the suite counts for. A decoder conforms to a profile and level if each
    vector of that profile up to the level, and each without a profile, passes with the highest grade. Rendering has
    its own verdict.
    """
    counts = Counter(r.status for r in results)
    judged = [r for r in results if r.status != "skipped"]
    grades = {r.id: r.grade for r in judged}
    profiles = tuple(_profiles(groups, grades))
    verdict = Verdict(
        all(row.verdict == "conforms" for row in profiles if row.profile not in SEEN.values()),
        min((r.grade for r in judged if r.operation == "decode"), default=None),
        {status: counts[status] for status in STATUSES},
        len(groups) - len(judged),
    )
    return {
        "verdict": verdict,
        "profiles": profiles,
        "requirements": _coverage(((v.id, v.requirements) for v in manifest.vectors), grades),
        "features": _coverage(((v.id, v.features) for v in manifest.vectors), grades),
    }


def _profiles(groups: dict[str, str], grades: dict[str, int]) -> Iterable[Profile]:
    """Yields the verdicts. grades: by identifier, of the vectors that were run."""
    names = ["tiny", "main", *SEEN.values()]
    for group in sorted(set(groups.values()) - {"any"}, key=lambda g: (names.index(g.split()[0]), g)):
        name, _, level = group.partition(" ")
        lower = {g for g in groups.values() if g.startswith(f"{name} ") and int(g.split()[1]) < int(level)}
        counted = {group} if name in names[2:] else {group, "any", *lower}
        needed = [vector for vector, g in groups.items() if g in counted]
        right = sum(grades.get(vector) == GRADE_EXACT for vector in needed)
        wrong = sum(grades.get(vector, GRADE_EXACT) != GRADE_EXACT for vector in needed)
        verdict = "fails" if wrong else "conforms" if right == len(needed) else "incomplete"
        yield Profile(name, int(level) if level else None, verdict, len(needed), right)  # type: ignore[arg-type]


def _coverage(vectors: Iterable[tuple[str, Iterable[str]]], grades: dict[str, int]) -> dict[str, Coverage]:
    """Returns for each name the number of vectors of the suite that have it, were run, and were right."""
    every, run, right = Counter[str](), Counter[str](), Counter[str]()
    for vector, names in vectors:
        every.update(names)
        run.update(names if vector in grades else ())
        right.update(names if grades.get(vector) == GRADE_EXACT else ())
    return {name: Coverage(every[name], run[name], right[name]) for name in sorted(every, key=_order)}


def _order(name: str) -> list[tuple[bool, int, str]]:
    """Returns a sort key that orders numbers in names by value."""
    return [(part.isdigit(), int(part) if part.isdigit() else 0, part) for part in re.findall(r"\d+|\D+", name)]


def check(document: Any) -> Record:
    """Returns the record of a JSON value. Raises RecordError."""
    return _converted(document, Record)


def load(path: Path) -> Record:
    """Reads a record. Raises RecordError for another document, and OSError."""
    try:
        return check(read_json(path))
    except (DocumentError, RecordError) as error:
        raise RecordError(f"{path}: {error}") from None
