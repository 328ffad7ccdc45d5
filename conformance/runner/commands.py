"""The commands of the runner, and their exit statuses."""

from __future__ import annotations

import argparse
import datetime
import json
import shlex
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from refcodec.cli import statuses

from ..manifest import MANIFEST, Manifest, ManifestError, load
from ..report import record as records
from . import process
from .grading import GRADE_CLASS, GRADE_EXACT
from .run import Options, Run, run, wrong_hashes
from .selection import SelectionError, select

STATUSES = f"""exit status: {statuses.DONE} every selected vector as it must be;
{statuses.REJECTED} the decoder is wrong somewhere, or a known failure passes;
{statuses.DAMAGED_SUITE} the suite is damaged (manifest or a file's hash), so there is no verdict;
{statuses.NOTHING} no vector was selected, or all were skipped;
{statuses.USAGE} wrong usage, or a file or folder that cannot be read or written;
{statuses.FAULT} a fault of this program; {statuses.INTERRUPTED} interrupted"""


class UsageError(Exception):
    """Arguments that do not make sense."""


def _note(text: str) -> None:
    print(f"conformance: {text}", file=sys.stderr)


def _check_files(manifest: Manifest, text: str) -> None:
    wrong = wrong_hashes(manifest)
    if wrong:
        raise ManifestError("\n".join([text, *wrong]))


def _suite(folder: Path) -> Manifest:
    """The manifest of a folder whose files are all there and right. Raises ManifestError."""
    try:
        manifest = load(folder / MANIFEST)
    except OSError as error:
        raise ManifestError(f"{error.filename}: {error.strerror}") from None
    _check_files(manifest, "the suite is damaged, nothing was run:")
    return manifest


def _options(arguments: argparse.Namespace) -> Options:
    """The options that `run` and `verify-report` share. Raises UsageError."""
    command = tuple(arguments.command)
    needed = [] if arguments.serve else ["input", "output", *(["trace"] if arguments.trace else [])]
    check_template(command, needed)
    gaussians = None
    if arguments.gaussians is not None:
        gaussians = tuple(shlex.split(arguments.gaussians))
        check_template(gaussians, ["input", "output", "camera"])
    return Options(
        command, gaussians, arguments.jobs, arguments.grade, arguments.slow, arguments.trace, arguments.serve
    )


def check_template(command: Sequence[str], names: Sequence[str]) -> None:
    """Raises UsageError for a command without one of the places, and CommandError for a program that is not there."""
    missing = [f"{{{name}}}" for name in names if not any(f"{{{name}}}" in word for word in command)]
    if not command or missing:
        raise UsageError(f"the command needs {' and '.join(missing)}: {shlex.join(command)}")
    process.check_command(command)


def _known(path: Path | None, manifest: Manifest) -> list[str]:
    """The identifiers of a file: one in a line, # starts a comment. Raises UsageError for one that is no vector."""
    if path is None:
        return []
    lines = [line.partition("#")[0].strip() for line in path.read_text(encoding="utf-8").splitlines()]
    known = [line for line in lines if line]
    strangers = sorted(set(known) - {v.id for v in manifest.vectors})
    if strangers:
        raise UsageError(f"{path}: there is no vector {', '.join(strangers)}")
    return known


def _write(folder: Path, record: dict[str, Any]) -> None:
    # jinja2 is needed here alone.
    from ..report import junit, page  # noqa: PLC0415

    folder.mkdir(parents=True, exist_ok=True)
    (folder / "report.json").write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")
    (folder / "report.xml").write_text(junit.document(record), encoding="utf-8")
    (folder / "report.html").write_text(page.document(record), encoding="utf-8")


def status_of(error: Exception) -> int | None:
    """The exit status of an error that the caller can put right, None for any other one."""
    if isinstance(error, ManifestError):
        return statuses.DAMAGED_SUITE
    if isinstance(error, OSError | UsageError | SelectionError | process.CommandError | records.RecordError):
        return statuses.USAGE
    return None


def run_command(arguments: argparse.Namespace) -> int:
    """`conformance run`; returns its exit status. Raises what `status_of` knows."""
    from ..report import summary  # noqa: PLC0415

    manifest = _suite(arguments.vectors)
    options = _options(arguments)
    vectors = select(manifest.vectors, arguments.select)
    known = _known(arguments.known_failures, manifest)
    description = records.describe(arguments.describe, options.command)
    if not vectors:
        _note(f"no vector is selected: {' | '.join(arguments.select)}")
        return statuses.NOTHING
    if arguments.report:
        # A report that cannot be written is told before the work.
        arguments.report.mkdir(parents=True, exist_ok=True)
    started, began = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"), time.monotonic()
    done = run(manifest, vectors, options, known, show=sys.stderr.isatty())
    _check_files(manifest, "the suite was changed while the decoder ran, so no verdict:")
    about = records.About(description, tuple(arguments.select), started, time.monotonic() - began)
    record = records.build(manifest, options, about, done)
    records.check(record)
    if arguments.report:
        _write(arguments.report, record)
    for line in summary.lines(record):
        print(line)
    if arguments.report:
        print(f"report: {arguments.report / 'report.html'}")
    return _status(done)


def _status(done: Run) -> int:
    if done.interrupted:
        return statuses.INTERRUPTED
    if not all(r.good for r in done.results):
        return statuses.REJECTED
    return statuses.DONE if any(r.status != "skipped" for r in done.results) else statuses.NOTHING


def _differences(old: dict[str, Any], new: dict[str, Any]) -> list[str]:
    """What a record says otherwise than a new run of its vectors."""
    concluded = [
        name for name in ("verdict", "profiles", "requirements", "features") if old[name] != new["concluded"][name]
    ]
    wrong = [f"{name} does not follow from the record's vectors" for name in concluded]
    again = {v["id"]: v for v in new["vectors"]}
    for v in old["vectors"]:
        now = again[v["id"]]
        for name in ("status", "grade", "found"):
            if v[name] != now[name]:
                wrong.append(f"{v['id']}: {name} is {now[name]} now, {v[name]} in the report")
                break
    return wrong


def verify_report(arguments: argparse.Namespace) -> int:
    """`conformance verify-report`; returns its exit status. Raises what `status_of` knows."""
    old = records.load(arguments.report)
    manifest = _suite(arguments.vectors)
    if old["suite"]["manifest_sha256"] != records.manifest_digest(manifest):
        raise ManifestError(
            f"{arguments.report} is of another suite, {old['suite']['version']}, whose manifest has another SHA-256"
        )
    stated = old["runner"]
    arguments.grade, arguments.trace, arguments.serve = stated["grade"], stated["trace"], stated["serve"]
    options = _options(arguments)
    by_id = {v.id: v for v in manifest.vectors}
    # A record may name a vector once, and only vectors of its suite.
    names = [v["id"] for v in old["vectors"]]
    if len(set(names)) != len(names) or not set(names) <= set(by_id):
        raise records.RecordError(f"{arguments.report}: not the vectors of its suite, each once")
    if not names:
        _note("the report has no vector")
        return statuses.NOTHING
    known = [v["id"] for v in old["vectors"] if v["status"] in ("known", "unexpected")]
    done = run(manifest, [by_id[name] for name in names], options, known, show=sys.stderr.isatty())
    _check_files(manifest, "the suite was changed while the decoder ran, so no verdict:")
    if done.interrupted:
        return statuses.INTERRUPTED
    description = old["decoder"]["description"]
    new = records.build(manifest, options, records.About(description, (), stated["started"], 0), done)
    groups = {v.id: new["suite"]["vectors"][v.id] for v in manifest.vectors}
    wrong = _differences(old, {**new, "concluded": records.conclusions(groups, old["vectors"], manifest)})
    for line in wrong:
        print(line)
    partial = ", of an interrupted run" if stated["interrupted"] else ""
    print(f"{arguments.report}: {len(names)} vectors run again, {len(wrong)} differences{partial}")
    return statuses.REJECTED if wrong else statuses.DONE


def export(arguments: argparse.Namespace) -> int:
    """`conformance export`; returns its exit status. Raises what `status_of` knows."""
    from . import fluster  # noqa: PLC0415

    count = fluster.export(_suite(arguments.vectors), arguments.fluster)
    print(f"{arguments.fluster}: {count} vectors; {arguments.fluster / fluster.README} says how to run them")
    return statuses.DONE


def check_encoder(arguments: argparse.Namespace) -> int:
    """`conformance check-encoder`; returns its exit status. Raises what `status_of` knows."""
    from . import encoders  # noqa: PLC0415

    wrong = 0
    for path in arguments.files:
        verdict = encoders.examine(path.read_bytes())
        wrong += not verdict.good
        print(f"{'right' if verdict.good else 'WRONG'} {path}: {verdict.text}")
        for line in verdict.lines:
            print(f"    {line}")
    print(f"{len(arguments.files)} files, {wrong} wrong")
    return statuses.REJECTED if wrong else statuses.DONE


def add_grade(parser: argparse.ArgumentParser) -> None:
    """The option for the grade that a vector must reach."""
    parser.add_argument(
        "--grade",
        type=int,
        choices=range(1, GRADE_EXACT + 1),
        default=GRADE_EXACT,
        help=f"what a refusal must reach: 1 it is one, {GRADE_CLASS} its class, {GRADE_EXACT} code and offset too "
        "(default: %(default)s)",
    )
