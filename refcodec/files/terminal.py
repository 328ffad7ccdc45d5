"""The standard streams of a command: their output does not end it, and cannot control a terminal."""

import contextlib
import io
import os
import sys
from typing import Any

from .text import printable

# The maximum characters of a line on stderr.
LINE_MAX = 10_000


def open_streams() -> None:
    """Makes the standard streams usable, whatever their state is. A command calls it first.

    - A closed stream is connected to the null device. Otherwise the next opened file would get its number, and output
      of libraries would go into that file.
    - A character outside a stream's encoding is written as an escape.
    """
    for number, name, mode in ((0, "stdin", "r"), (1, "stdout", "w"), (2, "stderr", "w")):
        if getattr(sys, name) is None:
            with contextlib.suppress(OSError):
                os.fstat(number)
                continue
            # The system assigns the lowest free number, which is this one: those below it are open.
            os.open(os.devnull, os.O_RDONLY if mode == "r" else os.O_WRONLY)
            setattr(sys, name, open(number, mode, encoding="utf-8", closefd=False))  # noqa: SIM115 (stays open)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def note(text: str) -> None:
    """Prints a line on stderr. Errors of stderr are ignored."""
    with contextlib.suppress(OSError, ValueError):
        print(printable(text, LINE_MAX) + "\n", end="", file=sys.stderr, flush=True)


def say(text: str, lines: bool = False) -> None:
    """Prints a text on stdout. lines: whether it may have several lines. Raises OSError."""
    print(printable(text, lines=lines))


class ProgressStream(io.TextIOBase):
    """stderr for progress bars, whose errors do not end the work."""

    def write(self, text: str) -> int:
        """Writes a text unchanged. Errors of stderr are ignored."""
        with contextlib.suppress(OSError, ValueError):
            sys.stderr.write(text)
        return len(text)

    def flush(self) -> None:
        """Flushes stderr. Errors are ignored."""
        with contextlib.suppress(OSError, ValueError):
            sys.stderr.flush()

    @property
    def encoding(self) -> str:  # type: ignore[override]
        """The encoding of stderr, by which tqdm chooses bar characters."""
        return sys.stderr.encoding or "ascii"

    def isatty(self) -> bool:
        """Whether stderr is a terminal."""
        return sys.stderr.isatty()

    def fileno(self) -> int:
        """Returns the descriptor of stderr."""
        return sys.stderr.fileno()


class _LogStream(ProgressStream):
    """The stream of a bar that is no bar: each state is a line."""

    def write(self, text: str) -> int:
        """Writes what is visible of a text as a line."""
        if visible := text.strip():
            note(visible)
        return len(text)


def bar_options() -> dict[str, Any]:
    """Returns options of tqdm. Without a terminal there is a line each minute instead of a bar, as logs are read."""
    if sys.stderr.isatty():
        return {"file": ProgressStream(), "leave": False}
    form = "{desc} {n_fmt} of {total_fmt} {unit} after {elapsed}{postfix}"
    minute = dict.fromkeys(("mininterval", "maxinterval", "delay"), 60)
    return {"file": _LogStream(), "leave": False, "bar_format": form, **minute}


def silence_stdout() -> None:
    """Discards pending output of a failed stdout, so that Python does not fail at exit."""
    with contextlib.suppress(OSError, ValueError):
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, sys.stdout.fileno())
        os.close(nowhere)
