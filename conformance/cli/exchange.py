"""The command `check-encoder`, which judges the files of another encoder."""

import argparse
import re
from pathlib import Path
from typing import Any

from refcodec import statuses
from refcodec.files.text import printable

from ..runner import encoders
from .errors import UsageError


def check_encoder(arguments: argparse.Namespace) -> int:
    """Runs `conformance check-encoder`; returns its exit status. Raises the errors of `status_of`."""
    output = arguments.reconstruction
    meant = encoders.Meant(arguments.expect, output and output.read_bytes())
    if meant != encoders.Meant() and len(arguments.files) > 1:
        raise UsageError("--expect and --reconstruction are for one file")
    wrong = 0
    for path in arguments.files:
        verdict = encoders.examine(path.read_bytes(), meant)
        wrong += not verdict.good
        print(f"{'right' if verdict.good else 'WRONG'} {printable(str(path))}: {verdict.text}")
        for line in verdict.lines:
            print(f"    {line}")
    print(f"{len(arguments.files)} files, {wrong} wrong")
    return statuses.REJECTED if wrong else statuses.DONE


def _sha256(text: str) -> str:
    if not re.fullmatch("[0-9a-f]{64}", text.lower()):
        raise argparse.ArgumentTypeError("must be a SHA-256 of 64 hexadecimal digits")
    return text.lower()


def add(commands: Any) -> None:
    """Adds the command to the parser."""
    encoder = commands.add_parser(
        "check-encoder", help="judge the files of another encoder: valid, canonical, the same result from both decoders"
    )
    encoder.add_argument("files", nargs="+", type=Path, metavar="FILE")
    encoder.add_argument("--expect", type=_sha256, metavar="DIGEST", help="the digest of the scene that was meant")
    encoder.add_argument(
        "--reconstruction", type=Path, metavar="OUTPUT", help="the scene that was meant, as a decoder's output"
    )
    encoder.set_defaults(run=check_encoder)
