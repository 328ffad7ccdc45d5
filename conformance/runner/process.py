"""Decoder processes with bounds on time, memory, files and the number of processes.

A decoder process decodes one file, or serves: it reads a request for each file from stdin and answers on stdout. Each
request and each answer is a line of JSON.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import resource
import select
import shutil
import signal
import stat
import subprocess
import sys
import threading
import time
import uuid
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import psutil

from refcodec.files.documents import DocumentError, parse_json

from .folder import Folder

# The longest file that a decoder may write. The largest reconstruction and trace of the suite are well below it.
FILE_BYTES = 64 << 20
# The bounds of a vector's folder: the number of files and folders, and their bytes on the disk.
ENTRIES, FOLDER_BYTES = 1000, 256 << 20
# The most processes at a time.
PROCESSES = 100
# The parts of stderr that are kept: its first and its last bytes.
STDERR_HEAD, STDERR_TAIL = 4 << 10, 12 << 10
# The longest answer of a process that serves.
ANSWER_BYTES = 1 << 20
# The bound of wall time, as a factor of the seconds.
PATIENCE = 10
# The time in which killed processes must end, in seconds.
GONE = 5.0
# The intervals at which known processes are measured, and at which new ones are searched for, in seconds.
_LOOK, _SEARCH = 0.02, 0.1
# The most bytes of one read, and the most reads between two looks at a process.
_READ, _READS = 1 << 16, 64
_RSS_UNIT = 1 if sys.platform == "darwin" else 1024
# The most bytes by which the kernel's count of resident memory may be late.
_LATE = 1 << 20
# The environment variable that marks a decoder's processes, including those that left its tree.
_MARK = "C3GS_CONFORMANCE_RUN"


class CommandError(Exception):
    """A command that cannot be started."""


class StoppedError(Exception):
    """The run was stopped while the process ran."""


@dataclass(frozen=True)
class Ended:
    """The end of a process.

    status: exit status, None if a signal ended it. signal: its number, None if it exited. over: the reason why the end
    does not count, a name of grading.OVER, or None. stderr: all of it, or its first and last bytes with the number of
    bytes between them. seconds: wall time. peak: bytes of resident memory of the largest process; None if the runner
    itself is larger, which hides the peak.
    """

    status: int | None
    signal: int | None
    over: str | None
    stderr: bytes
    seconds: float
    peak: int | None


@dataclass(frozen=True)
class _Bounds:
    """seconds: time budget. memory: bytes. folder: of the vector. stop: set to stop the run."""

    seconds: float
    memory: int
    folder: Folder
    stop: threading.Event

    def passed(self, wall: float, spent: float, used: int) -> str | None:
        """The bound that is passed, if any.

        A process is late if both its wall time and its processor time are above the bound. Thus neither a busy machine
        nor parallel work makes a decoder late.
        """
        if wall > self.seconds * PATIENCE or min(wall, spent) > self.seconds:
            return "time"
        return "memory" if used > self.memory else None

    def stored(self) -> str | None:
        """The bound that the files of the folder pass, if any. Unreadable folders are ignored."""
        entries = taken = 0
        waiting = [str(self.folder.path)]
        while waiting:
            with contextlib.suppress(OSError), os.scandir(waiting.pop()) as found:
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
        return None


def fill(template: Sequence[str], places: dict[str, Path]) -> list[str]:
    """Replaces {input} and the like in a command by paths; other braces stay."""
    command = []
    for word in template:
        for name, path in places.items():
            word = word.replace(f"{{{name}}}", str(path))  # noqa: PLW2901
        command.append(word)
    return command


def check_command(command: Sequence[str]) -> None:
    """Raises CommandError for a program that does not exist or cannot be executed."""
    if shutil.which(command[0]) is None:
        raise CommandError(f"there is no executable program {command[0]}")


def _excerpt(data: bytes | bytearray) -> bytes:
    """The first and the last bytes of an error output, with the number of bytes between them."""
    left = len(data) - STDERR_HEAD - STDERR_TAIL
    if left > 0:
        data = data[:STDERR_HEAD] + b"\n[%d bytes left out] " % left + data[-STDERR_TAIL:]
    return bytes(data)


class _Decoder:
    """A decoder process and every process that it started.

    usage: of the process, once it has ended. took: wall time until it was killed.
    """

    def __init__(self, command: Sequence[str], temporary: Path, serves: bool = False) -> None:
        """Starts the process. Raises OSError or ValueError."""
        pipe = subprocess.PIPE if serves else subprocess.DEVNULL
        self._mark, self._before = uuid.uuid4().hex, set(psutil.pids())
        self.began, self.took, self._gone, self._spent = time.monotonic(), 0.0, False, 0.0
        self._process = subprocess.Popen(
            command,
            stdin=pipe,
            stdout=pipe,
            stderr=subprocess.PIPE,
            bufsize=0,
            env={**os.environ, "TMPDIR": str(temporary), _MARK: self._mark},
            start_new_session=True,
        )
        # Read after the start: a process inherits the peak that the process that started it has until then.
        self._floor = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * _RSS_UNIT + _LATE
        self._root = psutil.Process(self._process.pid)
        self._known = {self._root}
        if sys.platform == "linux":
            for limit, most in ((resource.RLIMIT_CORE, 0), (resource.RLIMIT_FSIZE, FILE_BYTES)):
                with contextlib.suppress(OSError, ValueError):  # the process has ended, or has a lower limit
                    resource.prlimit(self._process.pid, limit, (most, most))
        self.usage: resource.struct_rusage | None = None
        self._files = [f for f in (self._process.stdin, self._process.stdout, self._process.stderr) if f]
        for file in self._files:
            os.set_blocking(file.fileno(), False)
        self._open = [f for f in self._files if f is not self._process.stdin]
        self.errors, self.answer = bytearray(), bytearray()

    def ready(self) -> bool:
        """Whether a server waits for a request: it runs, and did not write unasked."""
        self._read(0)
        return self.usage is None and not self.answer and self._process.stdout in self._open

    def put(self, line: bytes) -> None:
        """Writes a request to a server, without waiting. The end of a server is observed later."""
        assert self._process.stdin
        self.errors.clear()
        self.began, self._spent = time.monotonic(), self._use()[1]
        with contextlib.suppress(BrokenPipeError):
            self._process.stdin.write(line)

    def wait(self, bounds: _Bounds) -> str | None:
        """Waits for the end, a line of an answer, or a passed bound; returns the bound. Raises StoppedError."""
        looked = searched = self.began
        silent = math.inf
        while True:
            self._read(_LOOK)
            if bounds.stop.is_set():
                raise StoppedError
            if len(self.errors) >= FILE_BYTES:
                return "output"
            if self.usage or b"\n" in self.answer:
                return None
            now = time.monotonic()
            if self._process.stdout and self._process.stdout not in self._open:
                silent = min(silent, now)  # a server that ends closes its stdout a moment earlier
            if len(self.answer) >= ANSWER_BYTES or now > silent + 1:
                return "answer"
            if now - looked >= _LOOK:
                looked = now
                if now - searched >= _SEARCH:
                    searched = now
                    self._search()
                used, spent = self._use()
                over = "processes" if len(self._known) > PROCESSES else None
                over = over or bounds.passed(now - self.began, spent - self._spent, used) or bounds.stored()
                if over:
                    return over

    def kill(self) -> None:
        """Kills the decoder and every process that it started, and reads what they wrote."""
        now = time.monotonic()
        self.took, end = now - self.began, now + GONE
        while not self._gone and time.monotonic() < end:
            self._search()
            with contextlib.suppress(ProcessLookupError, PermissionError):  # the latter for zombies on some systems
                os.killpg(self._process.pid, signal.SIGKILL)
            for process in self._known:
                with contextlib.suppress(psutil.Error):
                    process.kill()
            self._read(0.002 if self._known else 0)
            self._gone = self.usage is not None and not self._known
        for file in self._files:
            file.close()

    def ended(self, over: str | None, bounds: _Bounds) -> Ended:
        """The end of a killed decoder, after a last check of the bounds."""
        if over or not self._gone or self.usage is None:
            return Ended(None, None, over or "left", _excerpt(self.errors), self.took, None)
        peak = self.usage.ru_maxrss * _RSS_UNIT
        peak = peak if peak > self._floor else 0
        spent = self.usage.ru_utime + self.usage.ru_stime - self._spent
        over = bounds.passed(self.took, spent, peak) or bounds.stored()
        code = self._process.returncode
        status, number = (code, None) if code >= 0 else (None, -code)
        return Ended(status, number, over, _excerpt(self.errors), self.took, peak or None)

    def _read(self, seconds: float) -> None:
        """Reads the output or waits for some, and observes the end of the process."""
        if not self._open:
            time.sleep(min(seconds, 0.001))
        for _ in range(_READS):
            ready = select.select(self._open, [], [], seconds)[0] if self._open else []
            for file in ready:
                data = file.read(_READ)
                if data == b"":
                    self._open.remove(file)
                (self.errors if file is self._process.stderr else self.answer).extend(data or b"")
            if not ready:
                break
            seconds = 0
        if self.usage is None:
            pid, status, usage = os.wait4(self._process.pid, os.WNOHANG)
            if pid:
                self.usage, self._process.returncode = usage, os.waitstatus_to_exitcode(status)

    def _search(self) -> None:
        """Updates the known processes: the tree of the decoder, and marked processes that left it."""
        found = set(self._known)
        if self.usage is None:
            with contextlib.suppress(psutil.Error):
                found.update(self._root.children(recursive=True))
        for pid in set(psutil.pids()) - self._before - {process.pid for process in found}:
            with contextlib.suppress(psutil.Error):
                process = psutil.Process(pid)
                if process.environ().get(_MARK) == self._mark:
                    found.add(process)
        self._known = {process for process in found if _lives(process)}

    def _use(self) -> tuple[int, float]:
        """Bytes of resident memory and seconds of processor time of the known processes and their ended children."""
        memory, spent = 0, 0.0
        for process in self._known:
            with contextlib.suppress(psutil.Error):
                memory += process.memory_info().rss
                spent += sum(process.cpu_times()[:4])
        return memory, spent


def _lives(process: psutil.Process) -> bool:
    with contextlib.suppress(psutil.Error):
        return process.is_running() and process.status() != psutil.STATUS_ZOMBIE
    return False


class Watcher:
    """Runs decoders, one at a time. Every process that a decoder started ends with it."""

    def __init__(self) -> None:
        self._server: _Decoder | None = None
        self._home: Folder | None = None
        self._asked = 0

    def run(self, command: Sequence[str], seconds: float, memory: int, stop: threading.Event, folder: Folder) -> Ended:
        """Runs a command until its end or until it passes a bound.

        The bounds are wall time and processor time in seconds (README.md), bytes of resident memory of all its
        processes, and the files of `folder`. Address space is unbounded, because interpreters and sanitizers reserve
        more than they use. Raises StoppedError if `stop` is set meanwhile.
        """
        bounds = _Bounds(seconds, memory, folder, stop)
        try:
            decoder = _Decoder(command, folder.temporary)
        except (OSError, ValueError) as error:
            return _not_started(command, error)
        try:
            over = decoder.wait(bounds)
        finally:
            decoder.kill()
        return decoder.ended(over, bounds)

    def ask(
        self,
        command: Sequence[str],
        request: dict[str, Any],
        seconds: float,
        memory: int,
        stop: threading.Event,
        folder: Folder,
    ) -> Ended:
        """Asks a decoder that serves. Returns the end that a process for this request would have had.

        The bounds are those of run(), and the size of an answer. A decoder that passes one is started again.
        """
        bounds = _Bounds(seconds, memory, folder, stop)
        found = self._ask(command, request, bounds)
        # A late answer to an earlier request is not a fault of this one.
        return self._ask(command, request, bounds) if found.over == "other" else found

    def _ask(self, command: Sequence[str], request: dict[str, Any], bounds: _Bounds) -> Ended:
        if self._server and not self._server.ready():
            self._end()
        self._home = self._home or Folder()
        try:
            server = self._server = self._server or _Decoder(command, self._home.temporary, serves=True)
        except (OSError, ValueError) as error:
            return _not_started(command, error)
        self._asked += 1
        good = False
        try:
            server.put(json.dumps({"id": self._asked, **request}).encode() + b"\n")
            over = server.wait(bounds)
            took = time.monotonic() - server.began
            answer, end, more = server.answer.partition(b"\n")
            if end and not over:
                server.answer.clear()
                found = _read_answer(bytes(answer), self._asked, took)
                found = replace(found, over="twice" if more else found.over or bounds.stored())
                good = found.over is None
                return found
        finally:
            # A server is not asked again after a fault.
            if not good:
                self._end()
        found = server.ended(over, bounds)
        return found if found.over or found.signal else replace(found, status=None, over="answer")

    def _end(self) -> None:
        server, self._server = self._server, None
        if server:
            server.kill()

    def close(self) -> None:
        """Ends the decoder that serves, if there is one."""
        self._end()
        if self._home:
            self._home.close()
            self._home = None


def _not_started(command: Sequence[str], error: Exception) -> Ended:
    return Ended(None, None, "start", f"{command[0]}: {error}".encode("utf-8", "replace"), 0.0, None)


def _read_answer(line: bytes, number: int, took: float) -> Ended:
    """Reads the answer to a request."""
    wrong = Ended(None, None, "answer", _excerpt(line), took, None)
    try:
        said = parse_json(line, ANSWER_BYTES)
    except DocumentError:
        return wrong
    if not isinstance(said, dict):
        return wrong
    status, ended_by, text = said.get("status"), said.get("signal"), said.get("stderr", "")
    # Either status or signal is a number; the other is null or missing.
    if not isinstance(text, str) or {type(status), type(ended_by)} != {int, type(None)}:
        return wrong
    if said.get("id", number) != number:
        return replace(wrong, over="other")
    return Ended(status, ended_by, None, _excerpt(text.encode("utf-8", "replace")), took, None)
