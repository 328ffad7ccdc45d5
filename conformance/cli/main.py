"""The command `conformance`: its parser and its error messages."""

import argparse
import io
import os
import sys
from typing import NoReturn

from refcodec import statuses
from refcodec.files.text import printable

from .errors import note, status_of


class _Parser(argparse.ArgumentParser):
    """A parser with its own exit status for wrong usage, because 2 would be a verdict."""

    def error(self, message: str) -> NoReturn:
        self.print_usage(sys.stderr)
        self.exit(statuses.USAGE, f"{self.prog}: {printable(message)}\n")


def make_parser() -> argparse.ArgumentParser:
    # These modules need the extra `conformance`.
    from . import exchange, keeping, running  # noqa: PLC0415

    parser = _Parser(prog="conformance", description="Tests of decoders and encoders of C3GS files.")
    commands = parser.add_subparsers(required=True, metavar="command")
    for module in (running, exchange, keeping):
        module.add(commands)
    return parser


def _report(error: Exception) -> int:
    """Prints an error as one line; returns its exit status."""
    if isinstance(error, ModuleNotFoundError):
        note(
            f"{error.name} is not installed: pip install 'refcodec[conformance]' for run, verify-report "
            "and check-encoder, '.[test]' for the others"
        )
        return statuses.USAGE
    if statuses.is_out_of_memory(error):
        note("out of memory")
        return statuses.OUT_OF_MEMORY
    status = status_of(error)
    if isinstance(error, OSError):
        note(f"{error.filename or 'output'}: {error.strerror or error}")
    elif status is not None:
        note(str(error))
    if status is not None:
        return status
    if os.environ.get("REFCODEC_DEBUG") == "1":
        raise error
    kind, text = type(error).__name__, " ".join(str(error).split())
    note(f"internal error, please report it with the command ({kind}: {text})")
    return statuses.FAULT


def main(argv: list[str] | None = None) -> int:
    """Runs a command; returns its exit status (refcodec/statuses.py)."""
    for stream in (sys.stdout, sys.stderr):
        # A terminal without a character shows its code point.
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    try:
        statuses.check_memory()
        arguments = make_parser().parse_args(argv)
        status: int = arguments.run(arguments)
        sys.stdout.flush()
        return status
    except SystemExit as end:
        # argparse raises this for --help and wrong usage.
        return int(end.code or 0)
    except BrokenPipeError:
        # The reader closed stdout. A flush at exit must not fail again.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return statuses.BROKEN_PIPE
    except KeyboardInterrupt:
        note("interrupted")
        return statuses.INTERRUPTED
    except Exception as error:
        return _report(error)
