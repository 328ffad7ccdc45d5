"""Decoder processes, each bounded by a watcher: time, memory, files, and everything that it starts.

A process decodes one file, or serves: it then reads a request for each file from stdin, and answers on stdout. Either
is a line of JSON.
"""

from __future__ import annotations

import contextlib
import json
import os
import select
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from refcodec.files.documents import DocumentError, parse_json

from . import watcher
from .folder import Folder, Temporary
from .watcher import ANSWER_BYTES, GONE, PATIENCE, STDERR_HEAD, STDERR_TAIL

# What is kept of stderr.
STDERR_BYTES = STDERR_HEAD + STDERR_TAIL
# Milliseconds between two looks at whether the run is to stop.
_LOOK = 100
# Seconds that a watcher may be late with what it says of a process.
_GRACE = 10.0
# Watchers that this process started, which are not to be taken for what a decoder left behind; and those who start and
# look for them.
_watchers: set[int] = set()
_starting = threading.Lock()
_adopts = threading.Event()


class CommandError(Exception):
    """A command that cannot be started."""


class StoppedError(Exception):
    """The run was ended from outside while the process ran."""


class WatcherError(Exception):
    """A fault of the watcher's own."""


@dataclass(frozen=True)
class Ended:
    """How a process ended.

    status: exit status, None if a signal ended it. signal: its number, None if it exited. over: why that does not
    count, a name of grading.OVER, or None. stderr: all of it, or its beginning and its end, with a word of how much is
    left out. seconds: wall time. peak: bytes of resident memory of its largest process, None where the watcher's own is
    larger, which hides it.
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


@contextlib.contextmanager
def adopting() -> Iterator[None]:
    """While it lasts, what a decoder left behind when it killed its watcher comes to this process (on Linux).

    It is ended when the watcher is missed, and at last. No other part of the program may start sessions meanwhile.
    """
    before = set(watcher.children(os.getpid()))
    with _starting:
        _watchers.update(before)
    watcher.adopt()
    _adopts.set()
    try:
        yield
    finally:
        _end_strangers()
        _adopts.clear()
        watcher.adopt(False)
        with _starting:
            _watchers.difference_update(before)


def _end_strangers() -> None:
    """Kills children of this process that it did not start.

    A decoder begins a session, and no process comes back to ours from another one.
    """
    ours, end = str(os.getsid(0)).encode(), time.monotonic() + GONE
    while time.monotonic() < end:
        with _starting:
            found = [pid for pid in watcher.children(os.getpid()) if pid not in _watchers]
            strangers = [pid for pid in found if watcher.stat_fields(pid)[3:4] not in ([], [ours])]
        for pid in strangers:
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.kill(pid, signal.SIGKILL)
            with contextlib.suppress(ChildProcessError):
                os.waitpid(pid, os.WNOHANG)
        if not strangers:
            return
        time.sleep(0.002)


class Watcher:
    """A watcher's process: started at the first decoder, and again after one that it did not survive.

    It has one decoder at a time. Each is killed at its end with all that came of it (watcher.py).
    """

    def __init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None
        # Of a decoder that serves.
        self._temporary: Temporary | None = None
        self._fresh, self._asked = False, 0

    def run(
        self, command: Sequence[str], seconds: float, memory: int, stop: threading.Event, folder: Folder | None = None
    ) -> Ended:
        """Runs a command to its end, or to a bound.

        Bounds are wall time and processor time (README.md), bytes of resident memory of all its processes, and the
        files of `folder`. Address space is not bounded, because interpreters and sanitizers reserve much that they
        never use. Raises StoppedError if `stop` is set meanwhile.
        """
        return _ended(self._request(command, None, seconds, memory, stop, folder))

    def ask(
        self,
        command: Sequence[str],
        request: dict[str, Any],
        seconds: float,
        memory: int,
        stop: threading.Event,
        folder: Folder | None = None,
    ) -> Ended:
        """How a process for this request would have ended, as a decoder that stays says it.

        The bounds are those of run(). An answer has one too. A decoder that passes one is started again.
        """
        found = self._asked_once(command, request, seconds, memory, stop, folder)
        if found.over == "other":
            # A late answer to an earlier request is not the fault of this one.
            found = self._asked_once(command, request, seconds, memory, stop, folder)
        return found

    def _asked_once(
        self,
        command: Sequence[str],
        request: dict[str, Any],
        seconds: float,
        memory: int,
        stop: threading.Event,
        folder: Folder | None,
    ) -> Ended:
        self._asked += 1
        reply = self._request(command, {"id": self._asked, **request}, seconds, memory, stop, folder)
        if reply["over"] or not reply["answer"]:
            return _ended(reply)
        found = _answer(reply["answer"].encode("latin-1"), self._asked, reply["seconds"])
        # Whoever says something wrong is not asked again.
        self._fresh = found.over is not None
        return found

    def close(self) -> None:
        """Ends the decoder and the watcher, if there is one."""
        process, self._process = self._process, None
        if process is not None:
            assert process.stdin is not None
            assert process.stdout is not None
            with contextlib.suppress(OSError):
                process.stdin.close()
            try:
                process.wait(GONE + 1)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
            process.stdout.close()
            with _starting:
                _watchers.discard(process.pid)
        if self._temporary is not None:
            self._temporary.close()
            self._temporary = None

    def _started(self) -> subprocess.Popen[bytes]:
        if self._process is None:
            # By its path, and isolated: what the caller's environment says of Python is for the decoder.
            command = [sys.executable, "-I", "-S", str(Path(watcher.__file__).resolve())]
            with _starting:
                self._process = subprocess.Popen(
                    command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, start_new_session=True
                )
                _watchers.add(self._process.pid)
            self._fresh = False
        return self._process

    def _request(
        self,
        command: Sequence[str],
        ask: dict[str, Any] | None,
        seconds: float,
        memory: int,
        stop: threading.Event,
        folder: Folder | None,
    ) -> dict[str, Any]:
        if self._temporary is None and (ask is not None or folder is None):
            self._temporary = Temporary()
        place = self._temporary.path if self._temporary else folder.temporary  # type: ignore[union-attr]
        line = {
            "command": list(command),
            "ask": None if ask is None else json.dumps(ask),
            "fresh": self._fresh,
            "seconds": seconds,
            "memory": memory,
            "temporary": str(place),
            "folder": None if folder is None else str(folder.path),
        }
        self._fresh = False
        process, began = self._started(), time.monotonic()
        assert process.stdin is not None
        with contextlib.suppress(OSError):  # it has gone, which reading will tell
            process.stdin.write(json.dumps(line).encode() + b"\n")
            process.stdin.flush()
        said = self._read(process, began + seconds * PATIENCE + GONE + _GRACE, stop)
        if stop.is_set():
            self.close()
            raise StoppedError
        if not said.endswith(b"\n"):
            process.kill()
            self.close()
            if _adopts.is_set():
                _end_strangers()
            return {"over": "watcher", "seconds": time.monotonic() - began}
        reply: dict[str, Any] = json.loads(said)
        if "fault" in reply:
            raise WatcherError(reply["fault"])
        return reply

    def _read(self, process: subprocess.Popen[bytes], end: float, stop: threading.Event) -> bytes:
        """A line; without its end if the watcher has gone, is stopped, or is silent."""
        assert process.stdout is not None
        said, poll = b"", select.poll()
        poll.register(process.stdout, select.POLLIN)
        while not said.endswith(b"\n") and not stop.is_set():
            if poll.poll(_LOOK):
                data = os.read(process.stdout.fileno(), 1 << 16)
                if not data:
                    break
                said += data
            elif time.monotonic() > end or _is_stopped(process):
                break
        return said


def _is_stopped(process: subprocess.Popen[bytes]) -> bool:
    """Whether a child was sent SIGSTOP."""
    try:
        pid, status = os.waitpid(process.pid, os.WNOHANG | os.WUNTRACED)
    except ChildProcessError:
        return True
    if pid and not os.WIFSTOPPED(status):
        process.returncode = os.waitstatus_to_exitcode(status)
    return bool(pid)


def _ended(reply: dict[str, Any]) -> Ended:
    return Ended(
        reply.get("status"),
        reply.get("signal"),
        reply["over"],
        reply.get("stderr", "").encode("latin-1"),
        reply["seconds"],
        reply.get("peak"),
    )


def _answer(line: bytes, number: int, took: float) -> Ended:
    """What an answer to a request says."""
    wrong = Ended(None, None, "answer", line[:STDERR_BYTES], took, None)
    try:
        said = parse_json(line, ANSWER_BYTES)
    except DocumentError:
        return wrong
    if not isinstance(said, dict):
        return wrong
    status, ended_by, text = said.get("status"), said.get("signal"), said.get("stderr", "")
    # Of status and signal one is a number, and the other null or not there.
    if not isinstance(text, str) or {type(status), type(ended_by)} != {int, type(None)}:
        return wrong
    if said.get("id", number) != number:
        return Ended(None, None, "other", line[:STDERR_BYTES], took, None)
    errors = watcher.Excerpt()
    errors.add(text.encode("utf-8", "replace"))
    return Ended(status, ended_by, None, errors.text(), took, None)
