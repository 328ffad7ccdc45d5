"""The commands for maintenance of the suite: `generate`, `fuzz` and `selftest`."""

import argparse
from pathlib import Path
from typing import Any

from ..manifest import MANIFEST, VECTORS
from .shared import add_jobs, check_template, positive


def _fuzz(arguments: argparse.Namespace) -> int:
    # hypothesis is in the extra `test`, and slow to import.
    from ..fuzz.compare import run  # noqa: PLC0415

    if arguments.command:
        check_template(arguments.command, ["input", "output"])
    return run(arguments.count, arguments.seed, arguments.jobs, arguments.keep, arguments.command)


def _generate(arguments: argparse.Namespace) -> int:
    from ..cases import recipes  # noqa: PLC0415
    from ..cases.suite import generate  # noqa: PLC0415

    count, size = generate(arguments.output, recipes())
    print(f"{arguments.output}: {count} vectors, {size} bytes")
    return 0


def _add_generate(commands: Any) -> None:
    generate = commands.add_parser("generate", help="write all vectors and the manifest, always with the same bytes")
    generate.add_argument(
        "-o", "--output", type=Path, default=Path("vectors"), metavar="DIR", help="the folder (default: vectors)"
    )
    generate.set_defaults(run=_generate)


def _selftest(arguments: argparse.Namespace) -> int:
    from ..mutants import selftest  # noqa: PLC0415

    return selftest.run(arguments.manifest, arguments.jobs, with_table=arguments.table, new_hints=arguments.hints)


def _add_selftest(commands: Any) -> None:
    selftest = commands.add_parser("selftest", help="plant bugs in the blocks of SPEC.md; the vectors must catch each")
    selftest.add_argument(
        "--manifest", type=Path, default=VECTORS / MANIFEST, help="the suite (default: that of this program)"
    )
    add_jobs(selftest)
    selftest.add_argument(
        "--table", action="store_true", help="also print the bugs in Markdown, each with the vector that catches it"
    )
    selftest.add_argument(
        "--hints", action="store_true", help="also write the vectors that are tried first on bugs which few catch"
    )
    selftest.set_defaults(run=_selftest)


def _add_fuzz(commands: Any) -> None:
    fuzz = commands.add_parser(
        "fuzz", help="compare refcodec, the second decoder and optionally yours on many generated files"
    )
    fuzz.add_argument(
        "-n", "--count", type=positive, default=1000, help="number of valid and invalid files (default 1000)"
    )
    fuzz.add_argument("--seed", type=int, default=0, help="number of the first batch of files (default 0)")
    add_jobs(fuzz)
    fuzz.add_argument(
        "--keep", type=Path, default=Path("out/fuzz"), help="folder for files on which the decoders disagree"
    )
    fuzz.add_argument(
        "command", nargs="*", metavar="-- COMMAND", help="a third decoder, with {input} and {output} as for run"
    )
    fuzz.set_defaults(run=_fuzz)


def add(commands: Any) -> None:
    """Adds the commands to the parser."""
    _add_fuzz(commands)
    _add_generate(commands)
    _add_selftest(commands)
