"""Errors that the caller can put right: a line on stderr, and an exit status."""

from __future__ import annotations

import sys

from refcodec import statuses
from refcodec.files.text import printable
from refcodec.statuses import UsageError

# The longest text that is told, in characters.
_TEXT = 4000


def status_of(error: Exception) -> int | None:
    """The exit status of an error that the caller can put right, None for any other one."""
    # They need the extra `conformance`, and its absence is an error to be told.
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
    """Tells a line on stderr, or the lines of a list. Names in it may be anybody's."""
    print(f"conformance: {printable(text, _TEXT, lines=True)}", file=sys.stderr)
