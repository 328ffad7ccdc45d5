"""One decoder process, bounded: its time, its memory, the files that it writes, and everything that it starts.

A process decodes one file, or serves: it then reads a request for each file from stdin, and answers on stdout. Either
is a line of JSON.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import queue
import resource
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO

# The longest file that a decoder may write; the largest reconstruction and trace of the suite are well below it.
FILE_BYTES = 64 << 20
# What is kept of stderr: its end.
STDERR_BYTES = 16 << 10
# The longest answer of a process that serves.
ANSWER_BYTES = 1 << 20
# Seconds between two looks at a process.
_LOOK = 0.02
# A process that waits is ended after this many times its seconds.
_PATIENCE = 10
_TICK = 1 / os.sysconf("SC_CLK_TCK")
_RSS_UNIT = 1 if sys.platform == "darwin" else 1024
# A shell's `ulimit` counts blocks of 512 bytes (POSIX). It binds from the decoder's first instruction on, and what that
# starts too.
_LIMITS = f'ulimit -c 0; ulimit -f {FILE_BYTES // 512}; exec "$@"'


class CommandError(Exception):
    """A command that cannot be started."""


class StoppedError(Exception):
    """The run was ended from outside while the process ran."""


@dataclass(frozen=True)
class Ended:
    """How a process ended.

    status: exit status, None if a signal ended it. signal: its number, None if it exited. over: the bound that it
    passed ("time", "memory" or "output"), "answer" for a server's answer that cannot be read, or None. stderr: the
    end of it. seconds: wall time. peak: bytes of resident memory of its largest process, None where the runner's own
    is larger, which hides it.
    """

    status: int | None
    signal: int | None
    over: str | None
    stderr: bytes
    seconds: float
    peak: int | None


def fill(template: Sequence[str], places: dict[str, Path]) -> list[str]:
    """A command with the paths in the place of {input} and the like; other braces stay."""
    command = []
    for word in template:
        for name, path in places.items():
            word = word.replace(f"{{{name}}}", str(path))  # noqa: PLW2901
        command.append(word)
    return command


def check_command(command: Sequence[str]) -> None:
    """Raises CommandError for a program that is not there or cannot be run."""
    if shutil.which(command[0]) is None:
        raise CommandError(f"there is no program {command[0]} that can be run")


@dataclass(frozen=True)
class _Use:
    """What a process and those that it started use: bytes of resident memory, seconds of processor time."""

    memory: int
    seconds: float


def _use(pid: int) -> _Use:
    """Where the system does not say: no memory, and endless time, so that wall time alone counts."""
    try:
        # The second field is a name in parentheses, which may hold anything.
        fields = Path(f"/proc/{pid}/stat").read_bytes().rpartition(b")")[2].split()
        children = [_use(int(child)) for task in os.listdir(f"/proc/{pid}/task") for child in _children(pid, task)]
    except (OSError, IndexError, ValueError):
        return _Use(0, 0.0 if Path("/proc/self/stat").exists() else math.inf)
    # utime, stime, and those of children that have ended; rss
    seconds = sum(map(int, fields[11:15])) * _TICK
    memory = int(fields[21]) * resource.getpagesize()
    return _Use(memory + sum(c.memory for c in children), seconds + sum(c.seconds for c in children))


def _over(use: _Use, wall: float, seconds: float, memory: int) -> str | None:
    """The bound that is passed, if any.

    A process is late if both its wall time and its processor time are above the bound: neither one that other work of
    the machine keeps from running, nor one that is quick on many cores.
    """
    if wall > seconds * _PATIENCE or min(wall, use.seconds) > seconds:
        return "time"
    return "memory" if use.memory > memory else None


def _children(pid: int, task: str) -> list[str]:
    try:
        return Path(f"/proc/{pid}/task/{task}/children").read_text().split()
    except OSError:
        return []


def _kill(group: int) -> None:
    try:
        os.killpg(group, signal.SIGKILL)
    except (ProcessLookupError, PermissionError):  # the latter for a group of zombies, on some systems
        return


def _start(command: Sequence[str], stderr: Path, serves: bool) -> subprocess.Popen[bytes]:
    pipe = subprocess.PIPE if serves else subprocess.DEVNULL
    with stderr.open("wb") as file:
        try:
            return subprocess.Popen(
                ["/bin/sh", "-c", _LIMITS, "sh", *command], stdin=pipe, stdout=pipe, stderr=file, start_new_session=True
            )
        except (OSError, ValueError) as error:
            raise CommandError(f"{command[0]}: {error}") from None


def run(
    command: Sequence[str], stderr: Path, seconds: float, memory: int, stop: threading.Event, output: Path | None = None
) -> Ended:
    """Runs a command to its end, or to a bound: seconds (_over), bytes of resident memory, FILE_BYTES of each file.

    stderr: where its error output goes. output: the file whose length is looked at. Address space is not bounded,
    because interpreters and sanitizers reserve much that they never use. Every process of its group is killed at the
    end. Raises CommandError and, if `stop` is set meanwhile, StoppedError.
    """
    began = time.monotonic()
    process = _start(command, stderr, serves=False)
    # Read after the start: another thread may have grown meanwhile.
    floor = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * _RSS_UNIT
    ended: list[tuple[int, resource.struct_rusage]] = []
    waiter = threading.Thread(target=lambda: ended.append(os.wait4(process.pid, 0)[1:]), daemon=True)
    waiter.start()
    over = None
    while True:
        waiter.join(_LOOK)
        if not waiter.is_alive():
            break
        over = over or _over(_use(process.pid), time.monotonic() - began, seconds, memory)
        if over or stop.is_set():
            _kill(process.pid)
    took = time.monotonic() - began
    _kill(process.pid)
    if stop.is_set():
        raise StoppedError
    status, usage = ended[0]
    process.returncode = os.waitstatus_to_exitcode(status)
    # A process inherits the peak of the one that started it.
    peak = usage.ru_maxrss * _RSS_UNIT if usage.ru_maxrss * _RSS_UNIT > floor else None
    over = over or _over(_Use(peak or 0, usage.ru_utime + usage.ru_stime), took, seconds, memory)
    if over is None and any(
        path is not None and path.is_file() and path.stat().st_size >= FILE_BYTES for path in (output, stderr)
    ):
        over = "output"
    return Ended(
        process.returncode if process.returncode >= 0 else None,
        -process.returncode if process.returncode < 0 else None,
        over,
        _tail(stderr),
        took,
        peak,
    )


def _tail(path: Path) -> bytes:
    with path.open("rb") as file:
        file.seek(max(0, path.stat().st_size - STDERR_BYTES))
        return file.read()


class Server:
    """A decoder that stays: started at the first request, and again after one that it did not survive."""

    def __init__(self, command: Sequence[str], stderr: Path) -> None:
        self._command, self._stderr = command, stderr
        self._process: subprocess.Popen[bytes] | None = None
        self._lines: queue.SimpleQueue[bytes] = queue.SimpleQueue()

    def ask(self, request: dict[str, str], seconds: float, memory: int, stop: threading.Event) -> Ended:
        """How a process for this request would have ended.

        The bounds are those of run(). An answer has that of the output.
        """
        process = self._process
        if process is None or process.poll() is not None:
            self.close()
            process = self._process = _start(self._command, self._stderr, serves=True)
            # One for each process: what an old one said last is not taken for an answer.
            self._lines = queue.SimpleQueue()
            threading.Thread(target=_read_lines, args=(process.stdout, self._lines), daemon=True).start()
        began, before = time.monotonic(), _use(process.pid).seconds
        try:
            assert process.stdin is not None
            process.stdin.write(json.dumps(request).encode() + b"\n")
            process.stdin.flush()
        except OSError:
            pass  # it ended before it was asked, which its last line, an empty one, says
        over = None
        while True:
            try:
                line = self._lines.get(timeout=_LOOK)
                break
            except queue.Empty:
                use = _use(process.pid)
                spent = max(0.0, use.seconds - before) if before < math.inf else use.seconds
                over = over or _over(_Use(use.memory, spent), time.monotonic() - began, seconds, memory)
                if over or stop.is_set():
                    _kill(process.pid)
        took = time.monotonic() - began
        if stop.is_set():
            raise StoppedError
        ended = _answer(line, took) if line and not over else None
        if ended:
            return ended
        if not line and not over:
            # It ended by itself; how, is known in a moment.
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(1)
        crashed = process.poll() is not None and process.returncode < 0
        over = over or (None if crashed else "answer")
        _kill(process.pid)
        status = process.wait()
        return Ended(
            status if status >= 0 else None, -status if status < 0 else None, over, _tail(self._stderr), took, None
        )

    def close(self) -> None:
        """Ends the process, if there is one."""
        if self._process is not None:
            _kill(self._process.pid)
            self._process.wait()
            for pipe in (self._process.stdin, self._process.stdout):
                assert pipe is not None
                try:
                    pipe.close()
                except OSError:  # what could not be written before
                    continue


def _read_lines(pipe: IO[bytes], lines: queue.SimpleQueue[bytes]) -> None:
    """Puts each line into the queue; an empty one at the end, or in the place of one that is too long."""
    line = b"\n"
    while line.endswith(b"\n"):
        try:
            line = pipe.readline(ANSWER_BYTES)
        except (OSError, ValueError):
            line = b""
        lines.put(line if line.endswith(b"\n") else b"")


def _answer(line: bytes, took: float) -> Ended | None:
    """What an answer says; None if it is none."""
    try:
        said = json.loads(line)
        status, number, text = said.get("status"), said.get("signal"), said.get("stderr", "")
    except (ValueError, AttributeError, RecursionError):
        return None
    # Of status and signal one is a number, and the other null or not there.
    if not isinstance(text, str) or {type(status), type(number)} != {int, type(None)}:
        return None
    return Ended(status, number, None, text.encode("utf-8", "replace")[-STDERR_BYTES:], took, None)
