"""The commands that test a decoder: `run` and `verify-report`."""

import argparse
import datetime
import re
import shlex
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from refcodec import statuses
from refcodec.files.outputs import Kind, check_apart, check_file
from refcodec.files.stage import Stage
from refcodec.files.text import printable

from ..manifest import Manifest, ManifestError
from ..report import page, summary
from ..report import record as records
from ..report.schema import Record
from ..runner import selection
from ..runner.grading import GRADE_CODE, GRADE_EXACT
from ..runner.run import Options, Run, run
from ..runner.selection import select
from .errors import UsageError, note
from .shared import add_jobs, add_vectors, check_files, check_template, suite

# The files of a report.
REPORTS = {
    "report.json": Kind("a report of this command", re.compile(rb'\{\n "report": "c3gs-conformance-report"')),
    "report.html": Kind(
        "a report of this command", re.compile(rb"<!doctype html>\n.*: C3GS conformance</title>", re.DOTALL)
    ),
}

STATUSES = f"""exit status: {statuses.DONE} every selected vector passes, and every known failure fails;
{statuses.REJECTED} a vector fails, or a known failure passes;
{statuses.DAMAGED_SUITE} the suite is damaged (manifest or the hash of a file), so there is no verdict;
{statuses.NOTHING} no vector was selected, or all were skipped;
{statuses.USAGE} wrong usage, or a file or folder that cannot be read or written;
{statuses.FAULT} an internal error; {statuses.OUT_OF_MEMORY} out of memory; {statuses.INTERRUPTED} interrupted"""


# The longest list of known failures, in bytes.
_KNOWN_BYTES = 1 << 20


def _options(arguments: argparse.Namespace) -> Options:
    """Returns the options that `run` and `verify-report` share. Raises UsageError."""
    command = tuple(arguments.command)
    needed = [] if arguments.serve else ["input", "output", *(["trace"] if arguments.trace else [])]
    check_template(command, needed)
    seen: list[tuple[str, ...] | None] = []
    for given in (arguments.gaussians, arguments.render):
        seen.append(None if given is None else tuple(shlex.split(given)))
        if seen[-1] is not None:
            check_template(seen[-1], ["input", "output", "camera"])
    a = arguments
    return Options(command, seen[0], seen[1], a.jobs, a.grade, a.slow, a.trace, a.serve)


def _known(path: Path | None, manifest: Manifest) -> list[str]:
    """Reads identifiers from a file with one in each line; # starts a comment.

    Raises OSError, and UsageError for an unknown vector or a file that is not text.
    """
    if path is None:
        return []
    with path.open("rb") as file:
        data = file.read(_KNOWN_BYTES + 1)
    if len(data) > _KNOWN_BYTES:
        raise UsageError(f"{path}: more than {_KNOWN_BYTES} bytes")
    try:
        lines = [line.partition("#")[0].strip() for line in data.decode("utf-8").splitlines()]
    except UnicodeDecodeError as error:
        raise UsageError(f"{path}: not UTF-8 (byte {error.start})") from None
    known = [line for line in lines if line]
    strangers = sorted(set(known) - {v.id for v in manifest.vectors})
    if strangers:
        raise UsageError(f"{path}: unknown vectors: {printable(', '.join(strangers), 300)}")
    return known


def _check_report(arguments: argparse.Namespace) -> None:
    """Raises UsageError, before the run, if the report would replace other files."""
    places = {arguments.report / name: kind for name, kind in REPORTS.items()}
    check_apart(places, [arguments.vectors, arguments.known_failures, arguments.describe])
    for path, kind in places.items():
        check_file(path, kind, made=True)


def _write(folder: Path, record: Record) -> None:
    contents = (records.text(record), page.document(record))
    with Stage() as stage:
        for name, text in zip(REPORTS, contents, strict=True):
            stage.write(folder / name, text.encode())


def run_command(arguments: argparse.Namespace) -> int:
    """Runs `conformance run`; returns its exit status. Raises the errors of `status_of`."""
    manifest = suite(arguments.vectors)
    options = _options(arguments)
    vectors = select(manifest.vectors, arguments.select)
    known = _known(arguments.known_failures, manifest)
    description = records.describe(arguments.describe, options.command)
    if not vectors:
        note(f"no vector is selected: {' | '.join(arguments.select)}")
        return statuses.NOTHING
    if arguments.report:
        _check_report(arguments)
    started, began = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"), time.monotonic()
    done = run(manifest, vectors, options, known)
    check_files(manifest, "the suite was changed while the decoder ran, so no verdict:")
    about = records.About(description, tuple(arguments.select), started, time.monotonic() - began)
    record = records.build(manifest, options, about, done)
    if arguments.report:
        _write(arguments.report, record)
    for line in summary.lines(record, manifest.folder):
        print(line)
    if arguments.report:
        print(f"report: {printable(str(arguments.report / 'report.html'))}")
    return _status(done)


def _status(done: Run) -> int:
    if done.interrupted:
        return statuses.INTERRUPTED
    if not all(r.is_good for r in done.results):
        return statuses.REJECTED
    return statuses.DONE if any(r.status != "skipped" for r in done.results) else statuses.NOTHING


def _shown(value: object) -> str:
    return printable(str(value), 300)


def _differences(old: Record, new: Record, concluded: dict[str, Any]) -> Iterator[str]:
    """Yields the differences between a record and a new run of its vectors. concluded: what follows from the record."""
    for name, value in concluded.items():
        if getattr(old, name) != value:
            yield f"{name} does not follow from the record's vectors"
    again = {v.id: v for v in new.vectors}
    for v in old.vectors:
        for name in ("status", "grade", "found"):
            stated, now = getattr(v, name), getattr(again[v.id], name)
            if stated != now:
                yield f"{v.id}: {name} is {_shown(now)} now, {_shown(stated)} in the report"
                break


def verify_report(arguments: argparse.Namespace) -> int:
    """Runs `conformance verify-report`; returns its exit status. Raises the errors of `status_of`."""
    old, manifest = records.load(arguments.report), suite(arguments.vectors)
    if old.suite.manifest_sha256 != records.manifest_digest(manifest):
        raise ManifestError(
            f"{arguments.report} is of another suite, {_shown(old.suite.version)}, whose manifest has another SHA-256"
        )
    stated = old.runner
    arguments.grade, arguments.trace, arguments.serve = stated.grade, stated.trace, stated.serve
    options = _options(arguments)
    by_id = {v.id: v for v in manifest.vectors}
    names = [v.id for v in old.vectors]
    if len(set(names)) != len(names) or not set(names) <= set(by_id):
        raise records.RecordError(f"{arguments.report}: unknown or repeated vectors")
    if not names:
        note("the report has no vector")
        return statuses.NOTHING
    known = [v.id for v in old.vectors if v.status in ("known", "unexpected")]
    done = run(manifest, [by_id[name] for name in names], options, known)
    check_files(manifest, "the suite was changed while the decoder ran, so no verdict:")
    if done.interrupted:
        return statuses.INTERRUPTED
    new = records.build(manifest, options, records.About(old.decoder.description, (), stated.started, 0), done)
    wrong = list(_differences(old, new, records.conclusions(new.suite.vectors, old.vectors, manifest)))
    for line in wrong:
        print(line)
    partial = ", of an interrupted run" if stated.interrupted else ""
    print(f"{printable(str(arguments.report))}: {len(names)} vectors run again, {len(wrong)} differences{partial}")
    return statuses.REJECTED if wrong else statuses.DONE


def _factor(text: str) -> float:
    value = float(text)
    if not 0 < value < 1e6:
        raise argparse.ArgumentTypeError("must be above 0")
    return value


def _add_grade(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--grade",
        type=int,
        choices=range(1, GRADE_EXACT + 1),
        default=GRADE_EXACT,
        help=f"lowest grade of a refusal: 1 it is refused, {GRADE_CODE} with the code, {GRADE_EXACT} with the offset "
        "(default: %(default)s)",
    )


def add(commands: Any) -> None:
    """Adds the commands to the parser."""

    def shared(name: str, text: str, example: str) -> argparse.ArgumentParser:
        parser: argparse.ArgumentParser = commands.add_parser(
            name,
            help=text,
            description=text,
            epilog=f"{example}; {STATUSES}",
            usage=f"conformance {name} [options] {example}",
        )
        add_vectors(parser)
        for option, what in (("--gaussians", "lists of Gaussians"), ("--render", "images")):
            parser.add_argument(
                option,
                metavar="COMMAND",
                help=f"a command for {what} with {{input}}, {{camera}} and {{output}}, quoted as in a shell",
            )
        add_jobs(parser)
        parser.add_argument(
            "--slow", type=_factor, default=1.0, metavar="X", help="factor of the time budgets (default: %(default)s)"
        )
        return parser

    parser = shared("run", "test a decoder, and report where it first goes wrong", "-- ./mydecoder {input} {output}")
    parser.add_argument("--select", action="append", default=[], metavar="EXPR", help=selection.HELP)
    _add_grade(parser)
    parser.add_argument("--trace", action="store_true", help="the command has {trace}, and the trace must be right")
    parser.add_argument(
        "--serve",
        action="store_true",
        help="the command keeps running, reads a request for each vector from stdin, and answers on stdout, in JSON",
    )
    parser.add_argument(
        "--known-failures", type=Path, metavar="FILE", help="identifiers of vectors that must fail, one in each line"
    )
    parser.add_argument(
        "--describe", type=Path, metavar="FILE", help="the decoder's description of itself, JSON with name and version"
    )
    parser.add_argument(
        "--report",
        type=Path,
        metavar="DIR",
        help="folder for report.json and report.html; only earlier reports are replaced",
    )
    parser.add_argument(
        "command", nargs="+", metavar="-- COMMAND", help="{input}, {output} and {trace} stand for paths"
    )
    parser.set_defaults(run=run_command)
    verify = shared(
        "verify-report",
        "run the vectors of a report again, and compare the results",
        "REPORT.json -- ./mydecoder {input} {output}",
    )
    verify.add_argument("report", type=Path, metavar="REPORT.json")
    verify.add_argument("command", nargs="+", metavar="-- COMMAND", help="as for run")
    verify.set_defaults(run=verify_report)
