"""Errors that the caller can correct: a line on stderr and an exit status."""

import sys

from refcodec import statuses
from refcodec.files.text import printable
from refcodec.statuses import UsageError

# The longest message, in characters.
_TEXT = 4000


def status_of(error: Exception) -> int | None:
    """Returns the exit status of an error that the caller can correct, None for any other error."""
    # These modules need the extra `conformance`, whose absence is reported as an error.
    from ..manifest import ManifestError  # noqa: PLC0415
    from ..report.record import RecordError  # noqa: PLC0415
    from ..runner.process import CommandError  # noqa: PLC0415
    from ..runner.selection import SelectionError  # noqa: PLC0415

    if isinstance(error, ManifestError):
        return statuses.DAMAGED_SUITE
    if isinstance(error, OSError | UsageError | SelectionError | CommandError | RecordError):
        return statuses.USAGE
    return None


def note(text: str) -> None:
    """Prints a message on stderr, in printable form."""
    print(f"conformance: {printable(text, _TEXT, lines=True)}", file=sys.stderr)
