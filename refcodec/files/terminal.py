"""The standard streams of a command: what is said on them cannot fail, and cannot steer a terminal."""

from __future__ import annotations

import contextlib
import io
import os
import sys

from .text import printable

# The most characters of a line on stderr.
LINE_MAX = 10_000


def open_streams() -> None:
    """Makes the standard streams usable, whatever the caller did with them. A command calls it before anything else.

    - A stream that is closed becomes one to nowhere. Else the next file to be opened would get its number, and what
      libraries print would go into that file.
    - A character that a stream's encoding lacks is written as an escape.
    """
    for number, name, mode in ((0, "stdin", "r"), (1, "stdout", "w"), (2, "stderr", "w")):
        if getattr(sys, name) is None:
            with contextlib.suppress(OSError):
                os.fstat(number)
                continue
            # The lowest free number is taken, which is this one: those below it are open.
            os.open(os.devnull, os.O_RDONLY if mode == "r" else os.O_WRONLY)
            setattr(sys, name, open(number, mode, encoding="utf-8", closefd=False))  # noqa: SIM115 (stays open)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def note(text: str) -> None:
    """Prints a line on stderr. If stderr takes nothing, nothing is said."""
    with contextlib.suppress(OSError, ValueError):
        print(printable(text, LINE_MAX), file=sys.stderr, flush=True)


def say(text: str, lines: bool = False) -> None:
    """Prints a text on stdout. lines: whether it has several. Raises OSError if stdout takes nothing."""
    print(printable(text, lines=lines))


class ProgressStream(io.TextIOBase):
    """stderr for bars of progress. Work does not end because nobody can be told of it."""

    def write(self, text: str) -> int:
        """Writes a text as it is, if stderr takes it."""
        with contextlib.suppress(OSError, ValueError):
            sys.stderr.write(text)
        return len(text)

    def flush(self) -> None:
        """Shows what has been written, if stderr takes it."""
        with contextlib.suppress(OSError, ValueError):
            sys.stderr.flush()

    @property
    def encoding(self) -> str:  # type: ignore[override]
        """The encoding of stderr, by which tqdm chooses the characters of a bar."""
        return sys.stderr.encoding or "ascii"

    def isatty(self) -> bool:
        """Whether stderr is a terminal."""
        return sys.stderr.isatty()

    def fileno(self) -> int:
        """Returns the number of stderr."""
        return sys.stderr.fileno()


def silence_stdout() -> None:
    """Lets what is left to write to a stdout that failed go nowhere, so that Python does not fail at its end."""
    with contextlib.suppress(OSError, ValueError):
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, sys.stdout.fileno())
        os.close(nowhere)
