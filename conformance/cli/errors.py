"""Errors that the caller can put right: a line on stderr, and an exit status."""

from __future__ import annotations

import sys

from refcodec import statuses
from refcodec.statuses import UsageError


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
    """Tells a line on stderr."""
    print(f"conformance: {text}", file=sys.stderr)
