"""Peak memory of a process, or of a command of refcodec."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
# Runs a command, and prints its exit status and its peak memory. The value of getrusage for a child process is at least
# the memory of its parent, and thus may be too large.
_PROGRAM = """
import sys
from benchmarks.resident import resident
from refcodec.cli.main import main
print(main(sys.argv[1:]), resident(), file=sys.stderr)
"""


def resident(field: str = "VmHWM") -> int:
    """Returns the peak resident bytes of this process, from /proc (Linux).

    field: of /proc/self/status. VmRSS is the current value.
    """
    fields = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines())
    return int(fields[field].split()[0]) << 10


def measured(arguments: list[str], environment: Mapping[str, str] | None = None) -> tuple[int, int]:
    """Runs a command in a separate process. Returns its exit status and its peak memory in bytes.

    arguments: of refcodec, with absolute paths. environment: None for that of this process.
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
