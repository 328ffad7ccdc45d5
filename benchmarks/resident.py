"""Time and peak memory of a process."""

import os
import subprocess
import sys
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from .results import ROOT

# Runs a command, and prints its exit status, seconds, processor seconds, and peak memory in KiB on stderr. It is small,
# because the peak memory that the system states for a process is at least that of the process which starts it.
_LAUNCHER = """
import os, sys, time
began = time.perf_counter()
process = os.posix_spawnp(sys.argv[1], sys.argv[1:], os.environ)
_, status, usage = os.wait4(process, 0)
seconds, processor = time.perf_counter() - began, usage.ru_utime + usage.ru_stime
print("\\n", os.waitstatus_to_exitcode(status), seconds, processor, usage.ru_maxrss, file=sys.stderr)
"""


class Usage(NamedTuple):
    """What a process took. processor: seconds of all its threads. peak: its largest resident memory, bytes."""

    status: int
    seconds: float
    processor: float
    peak: int
    printed: str


def usage(command: Sequence[str | os.PathLike[str]], environment: Mapping[str, str] | None = None) -> Usage:
    """Runs a command in the repository's folder. environment: variables to add."""
    launched, variables = [sys.executable, "-S", "-c", _LAUNCHER, *command], {**os.environ, **(environment or {})}
    done = subprocess.run(launched, cwd=ROOT, env=variables, capture_output=True, text=True, check=True)
    status, seconds, processor, peak = done.stderr.split()[-4:]
    return Usage(int(status), float(seconds), float(processor), int(peak) << 10, done.stdout)


def measured(arguments: Sequence[str], environment: Mapping[str, str] | None = None) -> tuple[int, int]:
    """Runs a command of refcodec. Returns its exit status and its peak memory in bytes.

    arguments: with absolute paths. environment: variables to add.
    """
    spent = usage([sys.executable, "-m", "refcodec", *arguments], environment)
    return spent.status, spent.peak
