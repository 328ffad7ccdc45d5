"""The command line of refcodec."""

from __future__ import annotations

import argparse
import importlib
import os
import sys
from typing import NoReturn

from .. import __version__, statuses
from ..bitstream.errors import BitstreamError
from ..files.interrupts import on_interrupt
from ..files.terminal import note, open_streams, silence_stdout
from .shared import EXITS, UsageError, reject

# The modules of this package and their commands. A command imports only its own module.
GROUPS: dict[str, tuple[str, ...]] = {
    "coding": ("encode", "decode", "digest", "reconstruct", "validate"),
    "looking": ("explain", "inspect"),
    "drawing": ("gaussians", "render", "eval"),
    "exporting": ("export",),
    "viewing": ("view",),
    "learning": ("train", "fit"),
    "converting": ("convert",),
    "experiments": ("demo", "rd", "experiment"),
}
# Commands of these groups do not gain from BLAS threads, whose start takes longer than a small file.
_ONE_THREAD = ("coding", "looking")


class _Parser(argparse.ArgumentParser):
    """An argument parser that exits with the status of wrong usage. argparse's own status 2 would read as a verdict."""

    def error(self, message: str) -> NoReturn:
        self.print_usage(sys.stderr)
        note(f"{self.prog}: {message}")
        self.exit(statuses.USAGE)


class _Version(argparse.Action):
    """Prints the version and the decoding path. Only this option loads the native kernel for it."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> NoReturn:
        from ..native.library import describe  # noqa: PLC0415

        print(f"refcodec {__version__}, {describe()}")
        parser.exit()


def make_parser(groups: list[str]) -> argparse.ArgumentParser:
    """Returns the parser with the commands of some groups."""
    parser = _Parser(
        prog="refcodec",
        description="Reference encoder and decoder of C3GS, a bitstream for learned 3D Gaussian scenes.",
        epilog=f"examples:\n  refcodec validate scene.c3gs\n  refcodec decode scene.c3gs -o scene\n\n{EXITS}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action=_Version, nargs=0, help="show version and path, and exit")
    commands = parser.add_subparsers(metavar="COMMAND", required=True)
    for group in groups:
        importlib.import_module(f".{group}", __package__).add(commands)
    return parser


def _groups(argv: list[str]) -> list[str]:
    """Returns the group of the command in the arguments, or all groups if there is none."""
    command = next((word for word in argv if not word.startswith("-")), None)
    return [group for group, names in GROUPS.items() if command in names] or list(GROUPS)


def main(argv: list[str] | None = None) -> int:
    """Runs one command and returns its exit status. argv: the arguments, or None for those of the process."""
    # numba and torch read this when they are loaded. Without it, waiting threads spin, and training on busy cores takes
    # ten times as long.
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
    open_streams()
    try:
        with on_interrupt():
            status = _run(argv)
        sys.stdout.flush()
        return status
    except BrokenPipeError:
        # The reader of stdout has closed it.
        silence_stdout()
        return statuses.BROKEN_PIPE
    except KeyboardInterrupt:
        note("refcodec: interrupted")
        return statuses.INTERRUPTED
    except Exception as error:
        return _report(error)


def _run(argv: list[str] | None) -> int:
    """Runs one command and returns its exit status. Exceptions that it raises are not verdicts."""
    arguments = None
    try:
        argv = sys.argv[1:] if argv is None else argv
        groups = _groups(argv)
        if "numpy" not in sys.modules and set(groups) <= set(_ONE_THREAD):
            os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
        arguments = make_parser(groups).parse_args(argv)
        return int(arguments.run(arguments))
    except SystemExit as end:
        # argparse raises this after --help, --version and wrong usage.
        return int(end.code or 0)
    except BitstreamError as error:
        return reject(arguments.file, error)  # type: ignore[union-attr]
    except Exception as error:
        bounds = sys.modules.get("refcodec.bitstream.bounds")
        if bounds is not None and isinstance(error, bounds.BoundPassedError):
            from .bounds import passed  # noqa: PLC0415

            assert arguments is not None
            raise passed(arguments, error) from None
        if not statuses.is_out_of_memory(error):
            raise
        return _report_memory(arguments)


def _report_memory(arguments: argparse.Namespace | None) -> int:
    """Reports that memory ran out, and returns the exit status."""
    options = vars(arguments) if arguments else {}
    place = options.get("file") or options.get("scene") or "refcodec"
    bound = "; --max-memory BYTES refuses such work before it begins" if "max_memory" in options else ""
    note(f"{place}: out of memory{bound}; this is not a verdict on the file")
    return statuses.OUT_OF_MEMORY


def _report(error: Exception) -> int:
    """Reports an error that is not a verdict, and returns the exit status."""
    folder = sys.modules.get("refcodec.folder.layout")
    if isinstance(error, UsageError) or (folder is not None and isinstance(error, folder.SceneFolderError)):
        note(f"refcodec: {error}")
        return statuses.USAGE
    if isinstance(error, OSError):
        # stdout has no name. Its buffered rest would fail again.
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
