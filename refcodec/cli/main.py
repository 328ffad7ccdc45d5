"""The command line of refcodec."""

from __future__ import annotations

import argparse
import os
import sys
from typing import NoReturn

from .. import __version__, statuses
from ..bitstream.errors import BitstreamError
from ..files.terminal import note, open_streams, silence_stdout
from . import coding, converting, drawing, experiments, learning, looking
from .shared import EXITS, UsageError, reject


class _Parser(argparse.ArgumentParser):
    """argparse, which exits with the status of wrong usage. Its own status 2 would read as a verdict."""

    def error(self, message: str) -> NoReturn:
        self.print_usage(sys.stderr)
        note(f"{self.prog}: {message}")
        self.exit(statuses.USAGE)


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(
        prog="refcodec",
        description="Reference encoder and decoder of C3GS, a bitstream for learned 3D Gaussian scenes.",
        epilog=f"examples:\n  refcodec validate scene.c3gs\n  refcodec decode scene.c3gs -o scene\n\n{EXITS}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"refcodec {__version__}")
    commands = parser.add_subparsers(metavar="COMMAND", required=True)
    for group in (coding, looking, drawing, learning, converting, experiments):
        group.add(commands)
    return parser


def main(argv: list[str] | None = None) -> int:
    """Runs one command and returns its exit status. argv: the arguments, or None for those of the process."""
    # numba and torch read this when they are loaded. Waiting threads then do not spin, which would make training ten
    # times as slow on busy cores.
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
    open_streams()
    try:
        status = _run(argv)
        sys.stdout.flush()
        return status
    except BrokenPipeError:
        # The reader of stdout went away.
        silence_stdout()
        return statuses.BROKEN_PIPE
    except KeyboardInterrupt:
        note("refcodec: interrupted")
        return statuses.INTERRUPTED
    except Exception as error:
        return _report(error)


def _run(argv: list[str] | None) -> int:
    """Runs one command and returns its exit status. What it raises is no verdict."""
    arguments = None
    try:
        arguments = _parser().parse_args(argv)
        return int(arguments.run(arguments))
    except SystemExit as end:
        # argparse ends this way after --help, --version and wrong usage.
        return int(end.code or 0)
    except BitstreamError as error:
        return reject(arguments.file, error)  # type: ignore[union-attr]


def _report(error: Exception) -> int:
    """Reports an error that is no verdict, and returns the exit status."""
    folder = sys.modules.get("refcodec.folder.layout")
    if isinstance(error, UsageError) or (folder is not None and isinstance(error, folder.SceneFolderError)):
        note(f"refcodec: {error}")
        return statuses.USAGE
    if isinstance(error, OSError):
        # stdout has no name. What is left to write to it would fail again.
        if not error.filename:
            silence_stdout()
        note(f"refcodec: {error.filename or 'output'}: {error.strerror or error}")
        return statuses.USAGE
    if os.environ.get("REFCODEC_DEBUG") == "1":
        raise error
    kind = type(error).__name__
    text = " ".join(str(error).split())
    note(f"refcodec: internal error, please report it with the command and the file ({kind}: {text})")
    return statuses.FAULT
