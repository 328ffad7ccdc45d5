"""Exit statuses of all commands of the project: one number means one thing. The error of wrong usage."""

from __future__ import annotations

import contextlib
import errno
import mmap
from collections.abc import Iterator, Mapping

# Done; the file is accepted; the decoder under test is right.
DONE = 0
# A verdict: the file is rejected (SPEC.md 10.2); the decoder under test is wrong.
REJECTED = 1
# A verdict: the file is not supported (SPEC.md 10.2).
UNSUPPORTED = 2
# No verdict: the conformance suite is damaged.
DAMAGED_SUITE = 3
# No verdict: nothing was selected, or all of it was skipped.
NOTHING = 4
# Wrong usage, or a file or folder that cannot be read or written (EX_USAGE).
USAGE = 64
# A fault of the program itself (EX_SOFTWARE).
FAULT = 70
# No verdict: there is less memory than the work needs (EX_OSERR).
OUT_OF_MEMORY = 71
# Ctrl-C.
INTERRUPTED = 130
# The reader of stdout went away.
BROKEN_PIPE = 141


def is_out_of_memory(error: BaseException) -> bool:
    """Whether an error says that there is too little memory. torch and the system have other types for it."""
    if isinstance(error, OSError):
        return error.errno == errno.ENOMEM
    return isinstance(error, MemoryError) or (
        isinstance(error, RuntimeError)
        and (type(error).__name__ == "OutOfMemoryError" or "can't allocate memory" in str(error))
    )


def check_memory() -> None:
    """Raises OSError without the memory that NumPy takes. It would end the process with 1 or 2, which are verdicts."""
    mmap.mmap(-1, 128 << 20).close()


class UsageError(ValueError):
    """A wrong use that the caller can put right. The text is a line.

    It is the base of all such errors. status: the exit status of a command. several_lines: whether the text has some.
    about_input: whether it says "it" of the file that is read.
    """

    status: int = USAGE
    several_lines: bool = False
    about_input: bool = False

    def __init__(self, text: str) -> None:
        super().__init__(text)


@contextlib.contextmanager
def refusing(what: str = "", others: Mapping[type[Exception], str] | None = None) -> Iterator[None]:
    """Makes a ValueError of the block a UsageError.

    what: states what is refused, before the reason. others: the same for some errors, of which any may be there.
    """
    stated: dict[type[Exception], str] = {**(others or {}), ValueError: what}
    try:
        yield
    except UsageError:
        raise
    except tuple(stated) as error:
        text = next(text for kind, text in stated.items() if isinstance(error, kind))
        raise UsageError(f"{text}: {error}" if text else str(error)) from None
