"""Watches one decoder at a time: its time, its memory, its files, and all processes that come of it.

A program of its own, started by its path with `python -I -S`. It reads a request, a line of JSON, from stdin, and
answers it with a line on stdout. `process.Watcher` is the other end, and says what is in them. Only the standard
library is imported, because a start must cost little.

On Linux this process is a child subreaper (prctl(2)). Whatever comes of a decoder stays below it, whether it left its
group or its session, or whether its parent has ended. So it can be found, counted and killed. Elsewhere only the
decoder's process group is killed, and memory is looked at when the decoder has ended.
"""

from __future__ import annotations

import contextlib
import ctypes
import json
import math
import os
import resource
import select
import signal
import stat
import subprocess
import sys
import time
from typing import Any

# The longest file that a decoder may write; the largest reconstruction and trace of the suite are well below it.
FILE_BYTES = 64 << 20
# What may lie in its folder: files and folders, and bytes that they take on the disk.
ENTRIES, FOLDER_BYTES = 1000, 256 << 20
# Processes that may live at a time.
PROCESSES = 100
# What is kept of stderr: its beginning and its end.
STDERR_HEAD, STDERR_TAIL = 4 << 10, 12 << 10
# The longest answer of a process that serves.
ANSWER_BYTES = 1 << 20
# A process that waits is ended after this many times its seconds.
PATIENCE = 10
# Seconds in which what is killed must be gone.
GONE = 5.0
# Seconds between two looks at a process.
_LOOK = 0.02
_CONTROL = 0
_READ = 1 << 16
_PR_SET_CHILD_SUBREAPER = 36
_TICK = 1 / os.sysconf("SC_CLK_TCK")
_RSS_UNIT = 1 if sys.platform == "darwin" else 1024


def adopt(wanted: bool = True) -> None:
    """Makes this process the parent of what its descendants leave behind, or no longer. On Linux alone."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_CHILD_SUBREAPER, int(wanted), 0, 0, 0)


def children(pid: int) -> list[int]:
    """The children of a process. None where the system does not list them, and those of an ended process."""
    found: list[int] = []
    with contextlib.suppress(OSError):
        for task in os.listdir(f"/proc/{pid}/task"):
            with contextlib.suppress(OSError), open(f"/proc/{pid}/task/{task}/children", "rb") as file:
                found += map(int, file.read().split())
    return found


def descendants(pid: int, keep: int | None = None) -> list[int]:
    """The children of a process, their children and so on, without a process `keep` and all below it."""
    found = [child for child in children(pid) if child != keep]
    for child in found:  # it grows meanwhile
        found += children(child)
    return found


def stat_fields(pid: int) -> list[bytes]:
    """The fields of /proc/PID/stat from the third, the state, on (proc(5)); none if the process is gone."""
    try:
        with open(f"/proc/{pid}/stat", "rb") as file:
            # The second field is a name in parentheses, which may hold anything.
            return file.read().rpartition(b")")[2].split()
    except OSError:
        return []


def _use(pids: list[int]) -> tuple[int, float]:
    """Bytes of resident memory, and seconds of processor time, of processes and of their children that have ended."""
    memory, ticks = 0, 0
    for pid in pids:
        fields = stat_fields(pid)
        if fields:
            # rss; utime, stime, cutime, cstime
            memory += int(fields[21]) * resource.getpagesize()
            ticks += sum(map(int, fields[11:15]))
    return memory, ticks * _TICK


def _ended_seconds() -> float:
    """Seconds of processor time of all children that have ended."""
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def _stored(folder: str) -> str | None:
    """The bound that the files of a folder pass, if any. What cannot be read is not looked at."""
    entries = taken = 0
    waiting = [folder]
    while waiting:
        try:
            with os.scandir(waiting.pop()) as found:
                for entry in found:
                    status = entry.stat(follow_symlinks=False)
                    entries += 1
                    taken += status.st_blocks * 512
                    if stat.S_ISREG(status.st_mode) and status.st_size >= FILE_BYTES:
                        return "output"
                    if entries > ENTRIES or taken > FOLDER_BYTES:
                        return "files"
                    if stat.S_ISDIR(status.st_mode):
                        waiting.append(entry.path)
        except OSError:
            continue
    return None


class Excerpt:
    """The beginning and the end of what is written."""

    def __init__(self) -> None:
        self.size = 0
        self._head = self._tail = b""

    def add(self, data: bytes) -> None:
        self.size += len(data)
        room = STDERR_HEAD - len(self._head)
        self._head += data[:room]
        self._tail = (self._tail + data[room:])[-STDERR_TAIL:]

    def text(self) -> bytes:
        """Both. What stands between them begins no line, so that the end of a long line is no line of its own."""
        left = self.size - len(self._head) - len(self._tail)
        return self._head + (b"\n[%d bytes left out] " % left if left else b"") + self._tail


class Watcher:
    """The process that is watched, if there is one, and what it has said."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None
        # Exit status as wait4(2) gives it, and its use, once it has ended.
        self._end_of: tuple[int, resource.struct_rusage] | None = None
        self._pipes: dict[int, str] = {}
        self._errors, self._answer = Excerpt(), b""
        self._alone = True
        # A child's end wakes select.
        self._wake, write = os.pipe()
        for end in (self._wake, write):
            os.set_blocking(end, False)
        signal.set_wakeup_fd(write, warn_on_full_buffer=False)
        signal.signal(signal.SIGCHLD, lambda *_: None)

    def serve(self) -> None:
        """Answers requests until stdin ends."""
        for line in iter(sys.stdin.buffer.readline, b""):
            try:
                reply = self._handle(**json.loads(line))
            except Exception as error:  # the other end raises it
                reply = {"fault": f"{type(error).__name__}: {error}"}
            sys.stdout.buffer.write(json.dumps(reply).encode() + b"\n")
            sys.stdout.buffer.flush()
        self._kill()

    def _handle(
        self,
        command: list[str],
        ask: str | None,
        fresh: bool,
        seconds: float,
        memory: int,
        temporary: str,
        folder: str | None,
    ) -> dict[str, Any]:
        began = time.monotonic()
        self._read_pipes(0)
        # A server that ended, or spoke unasked, does not get the next request.
        silent = "stdout" not in self._pipes.values()
        if self._process is not None and (ask is None or fresh or self._end_of or self._answer or silent):
            self._kill()
        self._errors = Excerpt()
        before = _ended_seconds() + _use(descendants(os.getpid()))[1]
        if self._process is None:
            try:
                self._start(command, temporary, ask is not None)
            except (OSError, ValueError) as error:
                return self._reply("start", 0.0, error=f"{command[0]}: {error}")
        floor = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * _RSS_UNIT
        if ask is not None and not self._put(ask.encode() + b"\n"):
            over: str | None = "answer"
        else:
            over = self._wait(began, before, seconds, memory, folder, ask is not None)
        took = time.monotonic() - began
        if ask is not None and over is None and b"\n" in self._answer:
            return self._answered(took, folder)
        crashed = self._end_of is not None and os.WIFSIGNALED(self._end_of[0])
        if ask is not None and over is None and not crashed:
            over = "answer"
        if not self._kill():
            over = over or "left"
        if over is not None or self._end_of is None:
            return self._reply(over, took)
        # A process inherits the peak of the one that started it.
        peak = self._end_of[1].ru_maxrss * _RSS_UNIT
        peak = peak if peak > floor else 0
        over = _over(took, _ended_seconds() - before, seconds, peak, memory)
        return self._reply(over or (_stored(folder) if folder else None), took, peak=peak or None)

    def _answered(self, took: float, folder: str | None) -> dict[str, Any]:
        """What a server said. What it left behind is killed; what lives below it is its own."""
        assert self._process is not None
        gone = self._kill(self._process.pid)
        line, _, more = self._answer.partition(b"\n")
        self._answer = b""
        over = "left" if not gone else "twice" if more else _stored(folder) if folder else None
        if over:
            self._kill()
        return self._reply(over, took, answer=line)

    def _reply(
        self, over: str | None, took: float, peak: int | None = None, answer: bytes = b"", error: str = ""
    ) -> dict[str, Any]:
        status = number = None
        if self._end_of is not None:
            code = os.waitstatus_to_exitcode(self._end_of[0])
            status, number = (code, None) if code >= 0 else (None, -code)
        said = error.encode("utf-8", "surrogateescape") or self._errors.text()
        return {
            "status": status,
            "signal": number,
            "over": over,
            "stderr": said.decode("latin-1"),
            "seconds": took,
            "peak": peak,
            "answer": answer.decode("latin-1"),
        }

    def _start(self, command: list[str], temporary: str, serves: bool) -> None:
        pipe = subprocess.PIPE if serves else subprocess.DEVNULL
        self._end_of, self._answer = None, b""
        self._process = subprocess.Popen(
            command,
            stdin=pipe,
            stdout=pipe,
            stderr=subprocess.PIPE,
            env={**os.environ, "TMPDIR": temporary},
            start_new_session=True,
        )
        self._alone = False
        for file, name in (
            (self._process.stdin, "stdin"),
            (self._process.stdout, "stdout"),
            (self._process.stderr, ""),
        ):
            if file is not None:
                os.set_blocking(file.fileno(), False)
                if name != "stdin":
                    self._pipes[file.fileno()] = name

    def _put(self, data: bytes) -> bool:
        """Writes a request. One that ended already is found to have done so later; one that does not read is wrong."""
        assert self._process is not None
        assert self._process.stdin is not None
        try:
            return os.write(self._process.stdin.fileno(), data) == len(data)
        except BlockingIOError:
            return False
        except OSError:
            return True

    def _wait(
        self, began: float, before: float, seconds: float, memory: int, folder: str | None, serves: bool
    ) -> str | None:
        """Waits for the end, for a line of answer, or for a bound; returns the bound."""
        looked, silent = began, math.inf
        while True:
            if self._read_pipes(_LOOK):
                self._kill()
                os._exit(0)
            if self._errors.size >= FILE_BYTES:
                return "output"
            if b"\n" in self._answer or self._end_of:
                return None
            now = time.monotonic()
            if len(self._answer) >= ANSWER_BYTES or now > silent + 1:
                return "answer"
            if serves and "stdout" not in self._pipes.values():
                # It closed its stdout, mostly because it ends, which is known in a moment.
                silent = min(silent, now)
            if now - looked >= _LOOK:
                looked = now
                pids = descendants(os.getpid())
                used, spent = _use(pids)
                spent = _ended_seconds() + spent - before if os.path.exists("/proc/self/stat") else math.inf
                over = "processes" if len(pids) > PROCESSES else _over(now - began, spent, seconds, used, memory)
                over = over or (_stored(folder) if folder else None)
                if over:
                    return over

    def _read_pipes(self, seconds: float) -> bool:
        """Takes what there is, or waits for it; returns whether the other end of stdin went away."""
        watched = [*self._pipes, self._wake, *([_CONTROL] if seconds else [])]
        ready = select.select(watched, [], [], seconds)[0]
        for end in ready:
            if end in self._pipes:
                self._take(end)
        if self._wake in ready:
            with contextlib.suppress(BlockingIOError):
                os.read(self._wake, _READ)
        self._reap()
        return _CONTROL in ready

    def _take(self, end: int) -> bool:
        """Reads from a pipe once; returns whether there may be more."""
        try:
            data = os.read(end, _READ)
        except BlockingIOError:
            return False
        if not data:
            del self._pipes[end]
        elif self._pipes[end] == "stdout":
            self._answer += data
        else:
            self._errors.add(data)
        return bool(data)

    def _reap(self) -> None:
        while True:
            try:
                pid, status, usage = os.wait4(-1, os.WNOHANG)
            except ChildProcessError:
                self._alone = True
                return
            if pid == 0:
                return
            if self._process is not None and pid == self._process.pid:
                self._end_of = status, usage
                self._process.returncode = os.waitstatus_to_exitcode(status)

    def _kill(self, keep: int | None = None) -> bool:
        """Ends all that came of the process, and it too, but for `keep` and what is below it. Returns whether it is so.

        What is killed may have started more meanwhile, so it is looked for until there is no child any more.
        """
        end = time.monotonic() + GONE
        if self._process is not None and keep is None and self._end_of is None:
            with contextlib.suppress(ProcessLookupError, PermissionError):  # the latter for zombies, on some systems
                os.killpg(self._process.pid, signal.SIGKILL)
        while True:
            for pid in descendants(os.getpid(), keep):
                with contextlib.suppress(ProcessLookupError, PermissionError):
                    os.kill(pid, signal.SIGKILL)
            self._reap()
            gone = self._alone if keep is None else not set(children(os.getpid())) - {keep}
            if gone or time.monotonic() > end:
                break
            select.select([self._wake], [], [], 0.002)
            with contextlib.suppress(BlockingIOError):
                os.read(self._wake, _READ)
        if keep is None:
            self._close()
        return gone

    def _close(self) -> None:
        """Takes what is left in the pipes, and forgets the process."""
        for end in list(self._pipes):
            while self._errors.size < 2 * FILE_BYTES and self._take(end):
                continue
        self._pipes.clear()
        if self._process is not None:
            for file in (self._process.stdin, self._process.stdout, self._process.stderr):
                with contextlib.suppress(OSError):  # what could not be written before
                    if file is not None:
                        file.close()
        self._process = None


def _over(wall: float, spent: float, seconds: float, used: int, memory: int) -> str | None:
    """The bound that is passed, if any.

    A process is late if both its wall time and its processor time are above the bound: neither one that other work of
    the machine keeps from running, nor one that is quick on many cores.
    """
    if wall > seconds * PATIENCE or min(wall, spent) > seconds:
        return "time"
    return "memory" if used > memory else None


def main() -> None:
    """Watches."""
    adopt()
    # They bind from the decoder's first instruction on, and what it starts too.
    for limit, most in ((resource.RLIMIT_CORE, 0), (resource.RLIMIT_FSIZE, FILE_BYTES)):
        hard = resource.getrlimit(limit)[1]
        most = most if hard == resource.RLIM_INFINITY else min(most, hard)  # noqa: PLW2901
        resource.setrlimit(limit, (most, most))
    Watcher().serve()


if __name__ == "__main__":
    main()
