"""The command line of refcodec: it parses the words of a command, calls a function of refcodec.api, and prints."""

import os
import sys
from collections.abc import Mapping
from typing import Any

from .. import statuses
from ..api.command import Report
from ..bitstream.errors import BitstreamError
from ..files.interrupts import on_interrupt
from ..files.looks import looks_like
from ..files.terminal import note, open_streams, silence_stdout
from ..files.text import printable, shell_word
from .parser import GROUPS, parse

# Commands of these groups do not gain from BLAS threads, whose start takes longer than a small file.
_ONE_THREAD = (*GROUPS["coding"], *GROUPS["looking"])


def main(argv: list[str] | None = None) -> int:
    """Runs one command and returns its exit status. argv: the arguments, or None for those of the process."""
    # numba and torch read this when they are loaded. Without it, waiting threads spin, and training on busy cores takes
    # ten times as long.
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
    open_streams()
    words: dict[str, Any] = {}
    try:
        with on_interrupt():
            status = _run(sys.argv[1:] if argv is None else argv, words)
        sys.stdout.flush()
        return status
    except BaseException as error:
        return _status_of(error, str(words.get("file") or words.get("scene") or "refcodec"), "file" in words)


def _run(argv: list[str], words: dict[str, Any]) -> int:
    """Runs one command, and prints its result. words: receives the arguments of the function."""
    if "numpy" not in sys.modules:
        statuses.check_memory()
    if "numpy" not in sys.modules and argv and argv[0] in _ONE_THREAD:
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    function, arguments = parse(argv)
    words |= arguments
    result = function(*words.pop("keys", ()), **words)
    report = result if isinstance(result, Report) else Report(_lines(result))
    for line in report.lines:
        # A name of a file may have line feeds: a line of a report stays one.
        print(line if line.isprintable() else printable(line, lines=report is not result))
    for line in report.notes:
        note(line)
    return _reject(str(words["file"]), report.error) if report.error else report.status


def _lines(result: object) -> list[str]:
    """Returns the lines of a text, or of values by name."""
    if isinstance(result, Mapping):
        return [f"{name:<10} {value}" for name, value in result.items()]
    return [] if result is None else [str(result)]


def _status_of(error: BaseException, place: str, limited: bool) -> int:
    """Reports an error as a line on stderr, or two, and returns the exit status.

    place: the file or folder that the command reads. limited: whether the command has limits.
    """
    # Compiled functions may return in spite of Ctrl-C.
    if isinstance(error, SystemError) and isinstance(error.__cause__, KeyboardInterrupt):
        error = error.__cause__
    if isinstance(error, SystemExit):
        # argparse raises this after --help, --version and wrong usage.
        return int(error.code or 0)
    if isinstance(error, BrokenPipeError):
        # The reader of stdout has closed it.
        silence_stdout()
        return statuses.BROKEN_PIPE
    if isinstance(error, KeyboardInterrupt):
        note("refcodec: interrupted")
        return statuses.INTERRUPTED
    if isinstance(error, BitstreamError):
        return _reject(place, error)
    if statuses.is_out_of_memory(error):
        bound = "; --max-memory BYTES refuses such work before it begins" if limited else ""
        note(f"{place}: out of memory{bound}; this is not a verdict on the file")
        return statuses.OUT_OF_MEMORY
    if isinstance(error, statuses.UsageError):
        text = f"{place}: {error}" if error.about_input else str(error)
        for line in text.splitlines() if error.several_lines else [text]:
            note(f"refcodec: {line.removeprefix('refcodec: ')}")
        return error.status
    if isinstance(error, OSError):
        # stdout has no name. Its buffered rest would fail again.
        if not error.filename:
            silence_stdout()
        note(f"refcodec: {error.filename or 'output'}: {error.strerror or error}")
        return statuses.USAGE
    if os.environ.get("REFCODEC_DEBUG") == "1":
        raise error
    text = " ".join(str(error).split())
    note(f"refcodec: internal error, please report it with the command and the file ({type(error).__name__}: {text})")
    return statuses.FAULT


def _reject(file: str, error: BitstreamError) -> int:
    """Reports a verdict on stderr, as a line of text and a line of JSON. Returns the exit status."""
    from ..inspect.explain import likely_cause  # noqa: PLC0415 (only here)

    word = "is not supported" if error.kind.klass == "unsupported" else "is rejected"
    sys.stdout.flush()
    # SPEC 6.1: the signature error has the first eight bytes, as hexadecimal text.
    kind = looks_like(bytes.fromhex(error.found[:23])) if error.kind.name == "prologue.signature" else None
    spot = f"To see the spot: refcodec inspect {shell_word(file)} --near {error.offset}"
    if error.kind.name.endswith(".crc"):
        # What somebody can do who received the file.
        rest = f"To save the rest: refcodec decode {shell_word(file)} -o rescued --keep-going. "
        spot = f"Copy or download it again, or ask its sender. {rest if error.kind.name == 'chunk.crc' else ''}{spot}"
    advice = f"It looks like {kind}" if kind else f"{likely_cause(error.kind.name)} {spot}"
    if (error.kind.name, error.found) == ("prologue.version", "0"):
        advice = (
            f"Version 0 was the draft; refcodec migrate {shell_word(file)} -o NEW rewrites a file of its last layout"
        )
    note(f"{file} {word}: {error}. {advice}")
    note(error.to_json())
    return error.exit_status
