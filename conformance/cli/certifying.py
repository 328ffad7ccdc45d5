"""The command `registry`: reports, badges, the page and the matrix of the implementations in a folder."""

from __future__ import annotations

import argparse
import datetime
import shlex
import sys
import time
from pathlib import Path
from typing import Any

from refcodec import statuses
from refcodec.files.stage import Stage

from ..manifest import Manifest
from ..registry import certificates, implementations, matrix, pages
from ..registry.implementations import Implementation
from ..report import record as records
from ..report import summary
from ..report.audit import audit
from ..report.schema import Description
from ..runner.run import Options, run
from .errors import UsageError, note
from .shared import add_jobs, add_slow, add_vectors, check_files, suite


def registry(arguments: argparse.Namespace) -> int:
    """Runs `conformance registry`; returns its exit status. Raises the errors of `status_of`."""
    manifest, folder = suite(arguments.vectors), arguments.folder
    known = implementations.load(folder)
    for key in arguments.run_keys or ():
        chosen = [i for i in known if i.key == key and i.decoder]
        if not chosen:
            raise UsageError(f"{folder / key}.toml is not there, or has no [decoder]")
        if status := _report(chosen[0], manifest, arguments):
            return status
    files = matrix.run(known, note) if arguments.matrix else matrix.load(folder)
    given = [certificates.of_decoder(i, folder, manifest) for i in known if i.decoder]
    given += [certificates.of_encoder(i, files) for i in known if i.encoder]
    made = {**pages.files(folder, given, files, manifest), folder / matrix.NAME: matrix.text(files)}
    if not arguments.check:
        return _write(folder, made)
    stale = [path for path, text in made.items() if not path.is_file() or path.read_text(encoding="utf-8") != text]
    stale += sorted(set((folder / pages.BADGES).glob("*")) - set(made))
    for path in stale:
        note(f"{path} is not current: conformance registry --write")
    return statuses.REJECTED if stale else statuses.DONE


def _write(folder: Path, made: dict[Path, str]) -> int:
    with Stage() as stage:
        for path, text in made.items():
            stage.write(path, text.encode())
    for path in set((folder / pages.BADGES).glob("*.svg")) - set(made):
        path.unlink()
    print(f"{folder / pages.PAGE}: {sum(path.suffix == '.svg' for path in made)} badges")
    return statuses.DONE


def _report(implementation: Implementation, manifest: Manifest, arguments: argparse.Namespace) -> int:
    """Runs the whole suite on a decoder, and writes its report. Returns 0, or the status of a failure."""
    decoder = implementation.decoder
    assert decoder is not None
    gaussians = tuple(shlex.split(decoder.gaussians)) if decoder.gaussians else None
    serves = decoder.serve is not None
    options = Options(tuple(decoder.words), gaussians, arguments.jobs, slow=arguments.slow, serve=serves)
    started, began = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"), time.monotonic()
    done = run(manifest, manifest.vectors, options, show=sys.stderr.isatty())
    check_files(manifest, "the suite was changed while the decoder ran, so no report:")
    if done.interrupted:
        return statuses.INTERRUPTED
    about = records.About(Description(**implementation.description), (), started, time.monotonic() - began)
    record = records.build(manifest, options, about, done)
    audit(record, manifest)
    with Stage() as stage:
        stage.write(arguments.folder / decoder.report, records.packed(record))
    for line in summary.lines(record, manifest.folder):
        print(line)
    return statuses.DONE


def add(commands: Any) -> None:
    """Adds the command to the parser."""
    text = "make reports, badges, the page and the matrix of the implementations in a folder"
    parser = commands.add_parser("registry", help=text, description=f"{text[0].upper()}{text[1:]}.")
    add_vectors(parser)
    parser.add_argument(
        "--folder",
        type=Path,
        default=Path("implementations"),
        metavar="DIR",
        help="the folder with a TOML file for each implementation (default: %(default)s)",
    )
    what = parser.add_mutually_exclusive_group(required=True)
    what.add_argument("--check", action="store_true", help="refuse edited reports, and name stale files; write nothing")
    what.add_argument("--write", action="store_true", help="check the reports, and write the other files")
    what.add_argument(
        "--run",
        action="append",
        dest="run_keys",
        metavar="NAME",
        help="run the suite with the commands of NAME.toml and write its report, then as --write; repeatable",
    )
    what.add_argument(
        "--matrix",
        action="store_true",
        help="run all encoders and decoders of the folder on given scenes, then as --write; from the project's folder",
    )
    add_jobs(parser)
    add_slow(parser)
    parser.set_defaults(run=registry)
