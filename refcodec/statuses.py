"""Exit statuses of all commands of the project: one number means one thing. The error of wrong usage."""

from __future__ import annotations

# Done; the file is accepted; the decoder under test is right.
DONE = 0
# A verdict: the file is rejected (SPEC.md 10.1); the decoder under test is wrong.
REJECTED = 1
# A verdict: the file is not supported (SPEC.md 10.1).
UNSUPPORTED = 2
# No verdict: the conformance suite is damaged.
DAMAGED_SUITE = 3
# No verdict: nothing was selected, or all of it was skipped.
NOTHING = 4
# Wrong usage, or a file or folder that cannot be read or written (EX_USAGE).
USAGE = 64
# A fault of the program itself (EX_SOFTWARE).
FAULT = 70
# Ctrl-C.
INTERRUPTED = 130
# The reader of stdout went away.
BROKEN_PIPE = 141


class UsageError(Exception):
    """A wrong use that the caller can put right. The exit status is USAGE, and the text is one line."""
