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


def _selftest(arguments: argparse.Namespace) -> int:
    from .mutants.selftest import run  # noqa: PLC0415

    return run(arguments.manifest, arguments.jobs, arguments.recorded, arguments.matrix, arguments.write)


def _add_selftest(commands: Any) -> None:
    selftest = commands.add_parser("selftest", help="plant bugs in the second decoder; the vectors must catch every one")
    selftest.add_argument("--manifest", type=Path, default=Path("vectors/manifest.json"), help="the suite (default: vectors/manifest.json)")
    selftest.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="processes (default: one for each core)")
    how = selftest.add_mutually_exclusive_group()
    how.add_argument("--recorded", action="store_true", help="each bug on the vector that is recorded as the first to catch it alone")
    how.add_argument("--matrix", type=Path, metavar="FILE", help="each bug on all vectors; write which catch it to this file, as JSON")
    how.add_argument("--write", action="store_true", help="renew the record and its table, conformance/mutants/CAUGHT.md")
    selftest.set_defaults(run=_selftest)


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
    _add_selftest(commands)
    return parser


def main(argv: list[str] | None = None) -> int:
    """Runs one command; returns its exit status."""
    arguments = _parser().parse_args(argv)
    try:
        status: int = arguments.run(arguments)
        return status
    except KeyboardInterrupt:
        return EXIT_INTERRUPTED
