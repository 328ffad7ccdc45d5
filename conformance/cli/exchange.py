"""The commands for other programs: `export` for another runner, `check-encoder` for another encoder."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from refcodec import statuses
from refcodec.files.text import printable

from ..runner import encoders, fluster
from .shared import add_vectors, suite


def export_suite(arguments: argparse.Namespace) -> int:
    """Runs `conformance export`; returns its exit status. Raises the errors of `status_of`."""
    count = fluster.export(suite(arguments.vectors), arguments.fluster)
    guide = printable(str(arguments.fluster / fluster.README))
    print(f"{printable(str(arguments.fluster))}: {count} vectors; {guide} explains their use")
    return statuses.DONE


def check_encoder(arguments: argparse.Namespace) -> int:
    """Runs `conformance check-encoder`; returns its exit status. Raises the errors of `status_of`."""
    wrong = 0
    for path in arguments.files:
        verdict = encoders.examine(path.read_bytes())
        wrong += not verdict.good
        print(f"{'right' if verdict.good else 'WRONG'} {printable(str(path))}: {verdict.text}")
        for line in verdict.lines:
            print(f"    {line}")
    print(f"{len(arguments.files)} files, {wrong} wrong")
    return statuses.REJECTED if wrong else statuses.DONE


def add(commands: Any) -> None:
    """Adds the commands to the parser."""
    export = commands.add_parser("export", help="write the valid vectors as a suite of another runner")
    add_vectors(export)
    export.add_argument(
        "--fluster", type=Path, required=True, metavar="DIR", help="for Fluster, with the script that runs it"
    )
    export.set_defaults(run=export_suite)
    encoder = commands.add_parser(
        "check-encoder", help="judge the files of another encoder: valid, canonical, the same result from both decoders"
    )
    encoder.add_argument("files", nargs="+", type=Path, metavar="FILE")
    encoder.set_defaults(run=check_encoder)
