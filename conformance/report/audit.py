"""The audit of a record: everything that follows from the decoder's answers and the manifest is computed again."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from msgspec import to_builtins
from msgspec.structs import replace

from refcodec import statuses
from refcodec.files.text import printable

from ..manifest import GaussiansOf, Manifest, Vector
from ..runner.grading import BY_CODE, GRADE_EXACT, Judgement, judge
from ..runner.run import SKIPPED, Options, Result, Run, as_known, result_of, status_of
from .record import About, RecordError, build, manifest_digest, seal
from .schema import Record

# The longest text of a value in a message, in characters.
_SHOWN = 100


def audit(record: Record, manifest: Manifest) -> None:
    """Checks a record of a run of the whole suite, as the registry takes it.

    The answers of the decoder are what a record claims. Each is judged again by the manifest, and the rest of the
    record is made again from these judgements. Machine, time, memory and the bytes of failures have no second source,
    nor have the Gaussians of an accepted file. Only the record's own SHA-256 covers these.

    Raises:
        RecordError: the record was edited, is of another suite, or is not of the whole suite.
    """
    suite, runner = record.suite, record.runner
    if suite.manifest_sha256 != manifest_digest(manifest):
        raise RecordError(f"it is of a suite whose manifest has the SHA-256 {suite.manifest_sha256}: run it again")
    if runner.select or runner.interrupted or runner.trace:
        raise RecordError("it is not of the whole suite: run it without --select and --trace to the end")
    if [v.id for v in record.vectors] != [v.id for v in manifest.vectors]:
        missing = {v.id for v in manifest.vectors} - {v.id for v in record.vectors}
        which = f"without {printable(', '.join(sorted(missing)), _SHOWN)}" if missing else "in another order or number"
        raise RecordError(f"its vectors are not those of the manifest: {which}")
    stated, again = to_builtins(record), to_builtins(_again(record, manifest))
    for place, value, wanted in _differences(stated, again):
        if place != "sha256":
            raise RecordError(f"it was edited: {place} is {_shown(value)}, and {_shown(wanted)} follows from the rest")
    if seal(stated) != record.sha256:
        raise RecordError("it was edited: its SHA-256 is not that of its content")


def _again(record: Record, manifest: Manifest) -> Record:
    """Returns the record that follows from the answers in a record. Raises RecordError for an impossible answer."""
    decoder, runner = record.decoder, record.runner
    if not decoder.command:
        raise RecordError("it has no command")
    options = Options(
        decoder.command, decoder.gaussians, runner.jobs, runner.grade, runner.slow, runner.trace, runner.serve
    )
    results = [_result(r, v, manifest, options) for r, v in zip(record.vectors, manifest.vectors, strict=True)]
    about = About(decoder.description, runner.select, runner.started, runner.seconds)
    again = build(manifest, options, about, Run(results, runner.interrupted))
    # These are of the machine and the program that ran.
    own = {name: getattr(runner, name) for name in ("version", "python", "platform")}
    return replace(again, runner=replace(again.runner, **own), decoder=replace(again.decoder, files=decoder.files))


def _result(stated: Result, vector: Vector, manifest: Manifest, options: Options) -> Result:
    """Returns the result of a vector, judged again."""
    found = stated.found
    if isinstance(vector.expectation, GaussiansOf) and options.gaussians is None:
        return result_of(vector, "skipped", text=SKIPPED)
    if found is None:
        raise RecordError(f"it was edited: {vector.id} has no answer")
    ends = {
        "accepted": found.status == statuses.DONE and found.digest is not None,
        "rejected": found.status in (statuses.REJECTED, statuses.UNSUPPORTED) and found.code in BY_CODE,
    }
    if not ends.get(found.result, True):
        raise RecordError(f"it was edited: {vector.id} has an answer that the runner does not give")
    if isinstance(vector.expectation, GaussiansOf) and found.result == "accepted":
        # The list itself is not in the record.
        judgement = Judgement(stated.grade, stated.text)
        if (judgement.grade == GRADE_EXACT) != (judgement.text == "") or judgement.grade not in (0, GRADE_EXACT):
            raise RecordError(f"it was edited: {vector.id} has grade {judgement.grade} and the text {judgement.text!r}")
    else:
        judgement = judge(manifest, vector, found, Path())
    kept = {name: getattr(stated, name) for name in ("divergence", "hex", "stderr", "seconds", "peak_bytes", "probe")}
    status = status_of(found, judgement, options.grade)
    result = result_of(vector, status, grade=judgement.grade, text=judgement.text, found=found, **kept)
    return as_known(result) if stated.status in ("known", "unexpected") else result


def _differences(stated: Any, wanted: Any, place: str = "") -> Iterator[tuple[str, Any, Any]]:
    """Yields the place and both values of each difference between two JSON values."""
    if isinstance(stated, dict) and isinstance(wanted, dict):
        for name in {**stated, **wanted}:
            inner = f"{place}.{name}" if place else name
            yield from _differences(stated.get(name), wanted.get(name), inner)
    elif isinstance(stated, list) and isinstance(wanted, list) and len(stated) == len(wanted):
        for number, (one, other) in enumerate(zip(stated, wanted, strict=True)):
            name = one["id"] if isinstance(one, dict) and "id" in one else number
            yield from _differences(one, other, f"{place}[{name}]")
    elif stated != wanted:
        yield place, stated, wanted


def _shown(value: object) -> str:
    return printable(str(value), _SHOWN)
