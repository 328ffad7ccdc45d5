"""The most memory that a process takes, and a command of refcodec."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
# Runs a command, and prints its exit status and its memory. What getrusage says of a process that another one started
# would be that of the other one, if that was larger.
_PROGRAM = """
import sys
from benchmarks.resident import resident
from refcodec.cli.main import main
print(main(sys.argv[1:]), resident(), file=sys.stderr)
"""


def resident(field: str = "VmHWM") -> int:
    """Returns the most bytes that this process had in memory. It is read from /proc, which Linux has.

    field: of /proc/self/status. VmRSS is what the process has now.
    """
    fields = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines())
    return int(fields[field].split()[0]) << 10


def measured(arguments: list[str], environment: Mapping[str, str] | None = None) -> tuple[int, int]:
    """Returns the exit status of a command, which runs in a process of its own, and its memory in bytes.

    arguments: of refcodec, with absolute paths. environment: of the process, or None for that of this one.
    """
    run = subprocess.run(
        [sys.executable, "-c", _PROGRAM, *arguments],
        cwd=ROOT,
        env=environment,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        check=True,
    )
    status, most = run.stderr.splitlines()[-1].split()
    return int(status), int(most)
