"""The command line of the conformance suite."""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path
from typing import Any, NoReturn

from refcodec.cli import statuses


class _Parser(argparse.ArgumentParser):
    """argparse, with the exit status of wrong usage in place of 2, which would read as a verdict."""

    def error(self, message: str) -> NoReturn:
        self.print_usage(sys.stderr)
        self.exit(statuses.USAGE, f"{self.prog}: {message}\n")


def _fuzz(arguments: argparse.Namespace) -> int:
    # hypothesis belongs to the extra `test`, and is slow to import.
    from .fuzz.compare import run  # noqa: PLC0415
    from .runner.commands import check_template  # noqa: PLC0415

    if arguments.command:
        check_template(arguments.command, ["input", "output"])
    return run(arguments.count, arguments.seed, arguments.jobs, arguments.state, arguments.keep, arguments.command)


def _generate(arguments: argparse.Namespace) -> int:
    from .cases import recipes  # noqa: PLC0415
    from .cases.suite import generate  # noqa: PLC0415

    count, size = generate(arguments.output, recipes())
    print(f"{arguments.output}: {count} vectors, {size} bytes")
    return 0


def _add_generate(commands: Any) -> None:
    generate = commands.add_parser("generate", help="make all vectors and the manifest anew, the same bytes each time")
    generate.add_argument(
        "-o", "--output", type=Path, default=Path("vectors"), metavar="DIR", help="where (default: vectors)"
    )
    generate.set_defaults(run=_generate)


def _positive(text: str) -> int:
    value = int(text)
    if value < 1:
        raise argparse.ArgumentTypeError("must be at least 1")
    return value


def _factor(text: str) -> float:
    value = float(text)
    if not 0 < value < 1e6:
        raise argparse.ArgumentTypeError("must be above 0")
    return value


def _add_run(commands: Any) -> None:
    from .manifest import VECTORS  # noqa: PLC0415
    from .runner import commands as run  # noqa: PLC0415
    from .runner import selection  # noqa: PLC0415

    def shared(name: str, text: str, example: str) -> argparse.ArgumentParser:
        parser: argparse.ArgumentParser = commands.add_parser(
            name,
            help=text,
            description=text,
            epilog=f"{example}; {run.STATUSES}",
            usage=f"conformance {name} [options] {example}",
        )
        parser.add_argument(
            "--vectors",
            type=Path,
            default=VECTORS,
            metavar="DIR",
            help="folder of the suite (default: the one that came with this program)",
        )
        parser.add_argument(
            "--gaussians", metavar="COMMAND", help="one with {input}, {camera} and {output}, as a shell would read it"
        )
        parser.add_argument(
            "--jobs", type=_positive, default=os.cpu_count() or 1, metavar="N", help="processes (default: one a core)"
        )
        parser.add_argument(
            "--slow", type=_factor, default=1.0, metavar="X", help="factor of the time budgets (default: %(default)s)"
        )
        return parser

    parser = shared(
        "run", "tell whether a decoder is right, and if not, where it goes wrong", "-- ./mydecoder {input} {output}"
    )
    parser.add_argument("--select", action="append", default=[], metavar="EXPR", help=selection.HELP)
    run.add_grade(parser)
    parser.add_argument("--trace", action="store_true", help="the command has {trace}, and the trace must be right too")
    parser.add_argument(
        "--serve",
        action="store_true",
        help="the command stays, reads a request for each vector from stdin, and answers on stdout, in JSON",
    )
    parser.add_argument(
        "--known-failures", type=Path, metavar="FILE", help="identifiers of vectors that must fail, one in a line"
    )
    parser.add_argument(
        "--describe", type=Path, metavar="FILE", help="the decoder's description of itself, JSON with name and version"
    )
    parser.add_argument(
        "--report", type=Path, metavar="DIR", help="write report.json, report.xml (JUnit) and report.html there"
    )
    parser.add_argument(
        "command", nargs="+", metavar="-- COMMAND", help="{input}, {output} and {trace} stand for paths"
    )
    parser.set_defaults(run=run.run_command)
    verify = shared(
        "verify-report", "run the vectors of a report again, and compare", "REPORT.json -- ./mydecoder {input} {output}"
    )
    verify.add_argument("report", type=Path, metavar="REPORT.json")
    verify.add_argument("command", nargs="+", metavar="-- COMMAND", help="as for run")
    verify.set_defaults(run=run.verify_report)
    export = commands.add_parser("export", help="write the valid vectors as a suite of another runner")
    export.add_argument(
        "--vectors",
        type=Path,
        default=VECTORS,
        metavar="DIR",
        help="folder of the suite (default: the one that came with this program)",
    )
    export.add_argument(
        "--fluster", type=Path, required=True, metavar="DIR", help="for Fluster, with the script that runs it"
    )
    export.set_defaults(run=run.export)
    encoder = commands.add_parser(
        "check-encoder", help="judge the files of another encoder: valid, canonical, the same to both decoders"
    )
    encoder.add_argument("files", nargs="+", type=Path, metavar="FILE")
    encoder.set_defaults(run=run.check_encoder)


def _selftest(arguments: argparse.Namespace) -> int:
    from .mutants.selftest import run  # noqa: PLC0415

    return run(arguments.manifest, arguments.jobs, arguments.recorded, arguments.matrix, arguments.write)


def _add_selftest(commands: Any) -> None:
    from .manifest import MANIFEST, VECTORS  # noqa: PLC0415

    selftest = commands.add_parser(
        "selftest", help="plant bugs in the second decoder; the vectors must catch every one"
    )
    selftest.add_argument(
        "--manifest",
        type=Path,
        default=VECTORS / MANIFEST,
        help="the suite (default: the one that came with this program)",
    )
    selftest.add_argument(
        "--jobs", type=_positive, default=os.cpu_count() or 1, help="processes (default: one for each core)"
    )
    how = selftest.add_mutually_exclusive_group()
    how.add_argument(
        "--recorded", action="store_true", help="each bug on the vector that is recorded as the first to catch it alone"
    )
    how.add_argument(
        "--matrix",
        type=Path,
        metavar="FILE",
        help="each bug on all vectors; write which catch it to this file, as JSON",
    )
    how.add_argument(
        "--write", action="store_true", help="renew the record and its table, conformance/mutants/CAUGHT.md"
    )
    selftest.set_defaults(run=_selftest)


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(prog="conformance", description=__doc__)
    commands = parser.add_subparsers(required=True, metavar="command")
    fuzz = commands.add_parser(
        "fuzz", help="compare refcodec, the second decoder and, if you like, yours on many generated files"
    )
    fuzz.add_argument("-n", "--count", type=_positive, default=1000, help="files, valid and not (default 1000)")
    fuzz.add_argument("--seed", type=int, default=0, help="the same seed gives the same files (default 0)")
    fuzz.add_argument(
        "--jobs", type=_positive, default=os.cpu_count() or 1, help="processes (default: one for each core)"
    )
    fuzz.add_argument(
        "--state",
        type=Path,
        default=Path("out/fuzz.json"),
        help="where batches done are noted; a run goes on from there",
    )
    fuzz.add_argument(
        "--keep", type=Path, default=Path("out/fuzz"), help="folder for files on which the decoders disagree"
    )
    fuzz.add_argument(
        "command", nargs="*", metavar="-- COMMAND", help="a third decoder, with {input} and {output} as for run"
    )
    fuzz.set_defaults(run=_fuzz)
    _add_generate(commands)
    _add_run(commands)
    _add_selftest(commands)
    return parser


def _note(text: str) -> None:
    print(f"conformance: {text}", file=sys.stderr)


def _report(error: Exception) -> int:
    """Tells an error in a line; returns its exit status."""
    if isinstance(error, ModuleNotFoundError):
        _note(
            f"{error.name} is not installed: pip install '.[conformance]' for run, verify-report, export and "
            "check-encoder, '.[test]' for the others"
        )
        return statuses.USAGE
    from .runner import commands  # noqa: PLC0415

    status = commands.status_of(error)
    if isinstance(error, OSError):
        _note(f"{error.filename or 'output'}: {error.strerror or error}")
    elif status is not None:
        _note(str(error))
    if status is not None:
        return status
    if os.environ.get("REFCODEC_DEBUG") == "1":
        raise error
    kind, text = type(error).__name__, " ".join(str(error).split())
    _note(f"internal error, please report it with the command ({kind}: {text})")
    return statuses.FAULT


def main(argv: list[str] | None = None) -> int:
    """Runs one command; returns its exit status, one of refcodec/cli/statuses.py."""
    try:
        arguments = _parser().parse_args(argv)
        status: int = arguments.run(arguments)
        sys.stdout.flush()
        return status
    except SystemExit as end:
        # argparse leaves this way for --help and wrong usage, and fuzz with a text for a state that is not its own.
        if isinstance(end.code, str):
            _note(end.code)
            return statuses.USAGE
        return end.code or 0
    except BrokenPipeError:
        # The reader of stdout went away; what is left to write must not fail again when Python closes it.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return statuses.BROKEN_PIPE
    except KeyboardInterrupt:
        _note("interrupted")
        return statuses.INTERRUPTED
    except Exception as error:
        return _report(error)
