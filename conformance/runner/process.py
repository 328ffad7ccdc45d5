"""Decoder processes with bounds on time, memory and output.

A decoder process decodes one file, or serves: it reads a request for each file from stdin and answers on stdout. Each
request and each answer is a line of JSON. What a process writes goes to files, so that nothing is read while it runs.
"""

import contextlib
import fcntl
import json
import os
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, BinaryIO

import psutil

from refcodec.files.documents import DocumentError, parse_json

from .folder import Folder

# The longest file that a decoder may write. The largest reconstruction and trace of the suite are well below it.
FILE_BYTES = 64 << 20
# The parts of stderr that are kept: its first and its last bytes.
STDERR_HEAD, STDERR_TAIL = 4 << 10, 12 << 10
# The longest answer of a process that serves.
ANSWER_BYTES = 1 << 20
# The bound of wall time, as a factor of the seconds.
PATIENCE = 10
# The time that killed processes have to end, in seconds.
_GONE = 5.0
# The shortest pause between two looks at a process, the longest one, and the interval at which new processes are
# searched for, in seconds.
_PAUSE, _LOOK, _SEARCH = 0.001, 0.02, 0.1
_RSS_UNIT = 1 if sys.platform == "darwin" else 1024
# The most bytes by which the kernel's count of resident memory may be late.
_LATE = 1 << 20


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
class Bounds:
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


def _excerpt(data: bytes) -> bytes:
    """The first and the last bytes of an error output, with the number of bytes between them."""
    left = len(data) - STDERR_HEAD - STDERR_TAIL
    return data if left <= 0 else data[:STDERR_HEAD] + b"\n[%d bytes left out] " % left + data[-STDERR_TAIL:]


def _appended() -> BinaryIO:
    """Opens a temporary file to whose end every process writes, also after it was cut."""
    file = tempfile.TemporaryFile(buffering=0)  # noqa: SIM115
    fcntl.fcntl(file, fcntl.F_SETFL, os.O_APPEND)
    return file


class _Decoder:
    """A decoder process and every process that it started.

    usage: of the process, once it has ended. began: when it got its last request, or was started.
    """

    def __init__(self, command: Sequence[str], temporary: Path, serves: bool = False) -> None:
        """Starts the process. Raises OSError or ValueError."""
        self._errors, self._answers = _appended(), _appended()
        self.began, self._spent = time.monotonic(), 0.0
        self.usage: resource.struct_rusage | None = None
        self._process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE if serves else subprocess.DEVNULL,
            stdout=self._answers if serves else subprocess.DEVNULL,
            stderr=self._errors,
            bufsize=0,
            env={**os.environ, "TMPDIR": str(temporary)},
            start_new_session=True,
        )
        # Read after the start: a process inherits the peak that the process that started it has until then.
        self._floor = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * _RSS_UNIT + _LATE
        self._root = psutil.Process(self._process.pid)
        self._known = {self._root}
        if sys.platform == "linux":
            for limit, most in ((resource.RLIMIT_CORE, 0), (resource.RLIMIT_FSIZE, FILE_BYTES)):
                with contextlib.suppress(OSError, ValueError):  # the process has ended, or has a lower limit
                    # Only the soft limit: a sanitizer sets that of core dumps at its start, with the hard one it read.
                    resource.prlimit(self._process.pid, limit, (most, resource.getrlimit(limit)[1]))

    def put(self, line: bytes) -> bool:
        """Writes a request to a server. Returns False if the server has ended, or wrote unasked."""
        assert self._process.stdin
        if self._reap() or self.answer():
            return False
        for file in (self._errors, self._answers):
            file.truncate(0)
        self.began, self._spent = time.monotonic(), self._use()[1]
        with contextlib.suppress(BrokenPipeError):  # its end is observed later
            self._process.stdin.write(line)
        return True

    def answer(self) -> bytes:
        """What a server has written since its last request, or the beginning of it."""
        return os.pread(self._answers.fileno(), ANSWER_BYTES + 1, 0)

    def take_answer(self) -> bytes:
        """Returns the answer to a request, which is read only once."""
        answer = self.answer()
        self._answers.truncate(0)
        return answer

    def wait(self, bounds: Bounds) -> str | None:
        """Waits for the end, a line of an answer, or a passed bound; returns the bound. Raises StoppedError."""
        looked = searched = self.began
        pause = _PAUSE
        while not (self._reap() or b"\n" in self.answer()):
            if bounds.stop.is_set():
                raise StoppedError
            if len(self.answer()) > ANSWER_BYTES:
                return "answer"
            now = time.monotonic()
            if now - looked >= _LOOK:
                looked = now
                if now - searched >= _SEARCH:
                    searched = now
                    self._search()
                used, spent = self._use()
                if over := bounds.passed(now - self.began, spent - self._spent, used) or self._wrote(bounds):
                    return over
            time.sleep(pause)
            pause = min(2 * pause, _LOOK)
        return None

    def kill(self) -> None:
        """Kills the decoder's process group, and its known descendants outside the group.

        A process of another user cannot be killed: it is waited for as long as for others, and then left.
        """
        self._search()
        with contextlib.suppress(ProcessLookupError, PermissionError):  # the latter for zombies on some systems
            os.killpg(self._process.pid, signal.SIGKILL)
        for process in self._known:
            with contextlib.suppress(psutil.Error):
                process.kill()
        end = time.monotonic() + _GONE
        while not self._reap() and time.monotonic() < end:
            time.sleep(_PAUSE)
        psutil.wait_procs(self._known - {self._root}, timeout=max(end - time.monotonic(), 0))

    def ended(self, over: str | None, bounds: Bounds) -> Ended:
        """Kills the decoder. Returns its end, after a last check of the bounds."""
        took = time.monotonic() - self.began
        self.kill()
        stderr = _excerpt(os.pread(self._errors.fileno(), FILE_BYTES, 0))
        over = over or self._wrote(bounds)
        if over or self.usage is None:
            return Ended(None, None, over or "left", stderr, took, None)
        peak = self.usage.ru_maxrss * _RSS_UNIT
        peak = peak if peak > self._floor else 0
        over = bounds.passed(took, self.usage.ru_utime + self.usage.ru_stime - self._spent, peak)
        code = self._process.returncode
        status, number = (code, None) if code >= 0 else (None, -code)
        return Ended(status, number, over, stderr, took, peak or None)

    def close(self) -> None:
        """Kills the decoder, and closes its files."""
        self.kill()
        for file in (self._process.stdin, self._errors, self._answers):
            if file:
                file.close()

    def _wrote(self, bounds: Bounds) -> str | None:
        """The bound of output, if it is passed by stderr, a server's stdout, the output or the trace."""
        sizes = [os.fstat(file.fileno()).st_size for file in (self._errors, self._answers)]
        for path in (bounds.folder.output, bounds.folder.trace):
            with contextlib.suppress(OSError):
                sizes.append(path.lstat().st_size)
        return "output" if max(sizes) >= FILE_BYTES else None

    def _reap(self) -> bool:
        """Whether the process has ended."""
        if self.usage is None:
            pid, status, usage = os.wait4(self._process.pid, os.WNOHANG)
            if pid:
                self.usage, self._process.returncode = usage, os.waitstatus_to_exitcode(status)
        return self.usage is not None

    def _search(self) -> None:
        """Updates the known processes: the decoder, and the descendants that it had at any search."""
        with contextlib.suppress(psutil.Error):
            self._known.update(self._root.children(recursive=True))
        self._known = {process for process in self._known if process.is_running()}

    def _use(self) -> tuple[int, float]:
        """Bytes of resident memory and seconds of processor time of the known processes and their ended children."""
        memory, spent = 0, 0.0
        for process in self._known:
            with contextlib.suppress(psutil.Error):
                memory += process.memory_info().rss
                spent += sum(process.cpu_times()[:4])
        return memory, spent


class Watcher:
    """Runs decoders, one at a time."""

    def __init__(self) -> None:
        self._server: _Decoder | None = None
        self._home: Folder | None = None
        self._asked = 0

    def run(self, command: Sequence[str], bounds: Bounds) -> Ended:
        """Runs a command until its end or until it passes a bound.

        The bounds are wall time and processor time in seconds (README.md), bytes of resident memory of its processes,
        and bytes of each file. Address space is unbounded, because interpreters and sanitizers reserve more than they
        use. Raises StoppedError if the run is stopped meanwhile.
        """
        try:
            decoder = _Decoder(command, bounds.folder.temporary)
        except (OSError, ValueError) as error:
            return _not_started(command, error)
        with contextlib.closing(decoder):
            return decoder.ended(decoder.wait(bounds), bounds)

    def ask(self, command: Sequence[str], request: dict[str, Any], bounds: Bounds) -> Ended:
        """Asks a decoder that serves. Returns the end that a process for this request would have had.

        The bounds are those of run(), and the size of an answer. A decoder that passes one is started again.
        """
        ended = self._ask(command, request, bounds)
        # A late answer to an earlier request is not a fault of this one, for which the decoder is started again.
        ended = self._ask(command, request, bounds) if ended.over == "other" else ended
        return replace(ended, over="answer") if ended.over == "other" else ended

    def _ask(self, command: Sequence[str], request: dict[str, Any], bounds: Bounds) -> Ended:
        """As ask, once. The end of an answer to another request is "other"."""
        self._home = self._home or Folder()
        self._asked += 1
        line = json.dumps({"id": self._asked, **request}).encode() + b"\n"
        if self._server and not self._server.put(line):
            self._end()
        try:
            if self._server is None:
                self._server = _Decoder(command, self._home.temporary, serves=True)
                self._server.put(line)
        except (OSError, ValueError) as error:
            return _not_started(command, error)
        server, ended = self._server, None
        try:
            over = server.wait(bounds)
            line = b"" if over else server.take_answer()
            if line.endswith(b"\n"):
                ended = _read_answer(line, self._asked, time.monotonic() - server.began)
            else:
                # A server that ends without an answer gives none.
                ended = server.ended(over, bounds)
                ended = ended if ended.over or ended.signal else replace(ended, status=None, over="answer")
            return ended
        finally:
            # A server is not asked again after a fault.
            if ended is None or ended.over or server.usage:
                self._end()

    def _end(self) -> None:
        server, self._server = self._server, None
        if server:
            server.close()

    def close(self) -> None:
        """Ends the decoder that serves, if there is one."""
        self._end()
        if self._home:
            self._home.close()
            self._home = None


def _not_started(command: Sequence[str], error: Exception) -> Ended:
    return Ended(None, None, "start", f"{command[0]}: {error}".encode("utf-8", "replace"), 0.0, None)


def _read_answer(line: bytes, number: int, took: float) -> Ended:
    """Reads the answer to a request, which is one line."""
    try:
        answer = parse_json(line, ANSWER_BYTES)
    except DocumentError:
        answer = None
    if isinstance(answer, dict) and answer.get("id", number) != number:
        return Ended(None, None, "other", _excerpt(line), took, None)
    if isinstance(answer, dict):
        status, ended_by, text = answer.get("status"), answer.get("signal"), answer.get("stderr", "")
        # Either status or signal is a number; the other is null or missing.
        if isinstance(text, str) and {type(status), type(ended_by)} == {int, type(None)}:
            return Ended(status, ended_by, None, _excerpt(text.encode("utf-8", "replace")), took, None)
    return Ended(None, None, "answer", _excerpt(line), took, None)
