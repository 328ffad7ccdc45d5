"""The command line of the conformance suite."""

from __future__ import annotations

import argparse
import os
from pathlib import Path
from typing import Any

EXIT_INTERRUPTED = 130


def _fuzz(arguments: argparse.Namespace) -> int:
    # hypothesis belongs to the extra `test`, and is slow to import.
    from .fuzz import run  # noqa: PLC0415

    return run(arguments.count, arguments.seed, arguments.jobs, arguments.state, arguments.keep)


def _generate(arguments: argparse.Namespace) -> int:
    from .generate import recipes  # noqa: PLC0415
    from .generate.suite import generate  # noqa: PLC0415

    count, size = generate(arguments.output, recipes())
    print(f"{arguments.output}: {count} vectors, {size} bytes")
    return 0


def _add_generate(commands: Any) -> None:
    generate = commands.add_parser("generate", help="make all vectors and the manifest anew, the same bytes each time")
    generate.add_argument("-o", "--output", type=Path, default=Path("vectors"), metavar="DIR", help="where (default: vectors)")
    generate.set_defaults(run=_generate)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="conformance", description=__doc__)
    commands = parser.add_subparsers(required=True, metavar="command")
    fuzz = commands.add_parser("fuzz", help="compare refcodec and the second decoder on many generated files")
    fuzz.add_argument("-n", "--count", type=int, default=1000, help="files, valid and not (default 1000)")
    fuzz.add_argument("--seed", type=int, default=0, help="the same seed gives the same files (default 0)")
    fuzz.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="processes (default: one for each core)")
    fuzz.add_argument("--state", type=Path, default=Path("out/fuzz.json"), help="where batches done are noted; a run goes on from there")
    fuzz.add_argument("--keep", type=Path, default=Path("out/fuzz"), help="folder for files on which the decoders disagree")
    fuzz.set_defaults(run=_fuzz)
    _add_generate(commands)
    return parser


def main(argv: list[str] | None = None) -> int:
    """Runs one command; returns its exit status."""
    arguments = _parser().parse_args(argv)
    try:
        status: int = arguments.run(arguments)
        return status
    except KeyboardInterrupt:
        return EXIT_INTERRUPTED
