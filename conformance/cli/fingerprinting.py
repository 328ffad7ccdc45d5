"""The command `fingerprints`: what planted bugs do to the vectors, from which a run's failures are explained."""

from __future__ import annotations

import argparse
import os
import re
import time
from pathlib import Path
from typing import Any

from refcodec import statuses
from refcodec.files.lock import hold_file
from refcodec.files.outputs import Kind, check_apart, check_file

from .shared import add_vectors, positive, suite

TABLE = Kind.signed("a table of this command", b"\xfd7zXZ\x00")
JOURNAL = Kind("a journal of this command", re.compile(rb'\{"(bug|vector)":'))


def _make(arguments: argparse.Namespace) -> int:
    from ..diagnosis import table as tables  # noqa: PLC0415
    from ..mutants import fingerprints  # noqa: PLC0415

    place = arguments.output or tables.path()
    check_file(place, TABLE, made=True)
    check_file(arguments.journal, JOURNAL)
    check_apart([place, arguments.journal], [arguments.vectors])
    began = time.monotonic()
    with hold_file(arguments.journal.with_name(arguments.journal.name + ".lock")):
        made = fingerprints.make(suite(arguments.vectors), arguments.jobs, arguments.journal, place)
    print(f"{place}: {place.stat().st_size} bytes, {len(made.outcomes)} outcomes; {fingerprints.took(began)}")
    return statuses.DONE


def _check(arguments: argparse.Namespace) -> int:
    from ..diagnosis import table as tables  # noqa: PLC0415
    from ..mutants import fingerprints  # noqa: PLC0415

    manifest, found = suite(arguments.vectors), tables.read(arguments.output)
    wrong = fingerprints.stale(manifest, found)
    if not wrong:
        wrong = fingerprints.check(manifest, found, arguments.jobs, arguments.sample, arguments.seed)
    for line in wrong:
        print(line)
    print(f"{arguments.sample} cells of the table made anew, {len(wrong)} differences")
    return statuses.REJECTED if wrong else statuses.DONE


def _judge(arguments: argparse.Namespace) -> int:
    from ..diagnosis import calibration  # noqa: PLC0415
    from ..diagnosis import table as tables  # noqa: PLC0415
    from ..mutants import fingerprints  # noqa: PLC0415

    manifest, found = suite(arguments.vectors), tables.read(arguments.output)
    for line in calibration.cost(arguments.output or tables.path(), manifest):
        print(line)
    for line in calibration.alone(found, manifest, arguments.sample, arguments.seed):
        print(line)
    if arguments.pairs:
        made = fingerprints.pairs(manifest, found, arguments.jobs, arguments.pairs, arguments.seed)
        for line in calibration.together(found, manifest, made):
            print(line)
    return statuses.DONE


def add(commands: Any) -> None:
    """Adds the command to the parser."""
    text = "what planted bugs do to the quick vectors: make the table, check it, judge the diagnosis by it"
    parser = commands.add_parser("fingerprints", help=text, description=text)
    actions = parser.add_subparsers(required=True, metavar="action")

    def action(name: str, what: str, run: Any) -> argparse.ArgumentParser:
        found: argparse.ArgumentParser = actions.add_parser(name, help=what, description=what)
        add_vectors(found)
        found.add_argument(
            "--table", dest="output", type=Path, metavar="FILE", help="the table (default: that of this program)"
        )
        found.add_argument(
            "--jobs", type=positive, default=os.cpu_count() or 1, metavar="N", help="processes (default: one a core)"
        )
        found.set_defaults(run=run)
        return found

    make = action("make", "make the table anew where vectors or bugs have changed", _make)
    make.add_argument(
        "--journal",
        type=Path,
        default=Path("out/fingerprints.jsonl"),
        metavar="FILE",
        help="where rows are noted that are done; a run goes on from there (default: %(default)s)",
    )
    check = action("check", "make a sample of the table anew, and compare", _check)
    check.add_argument("--sample", type=positive, default=400, metavar="N", help="cells (default: %(default)s)")
    check.add_argument("--seed", type=int, default=0, help="of the sample (default: %(default)s)")
    judge = action("judge", "diagnose each planted bug without it and its siblings, and count what is right", _judge)
    judge.add_argument("--sample", type=int, default=0, metavar="N", help="so many bugs (default: all)")
    judge.add_argument("--pairs", type=int, default=0, metavar="N", help="so many pairs of bugs too (default: none)")
    judge.add_argument("--seed", type=int, default=0, help="of the samples (default: %(default)s)")
