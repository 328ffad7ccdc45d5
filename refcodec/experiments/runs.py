"""refcodec's own commands as processes, several at a time. Finished commands are noted in a file, and not repeated."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType
from typing import Any

from .. import statuses
from ..files.documents import DocumentError, read_json
from ..files.interrupts import on_interrupt
from ..files.lock import is_empty
from ..files.present import NotAFileError, is_there
from ..files.stage import Stage, write_file
from ..files.terminal import ProgressStream, note
from ..files.text import printable, shell_word

PROGRAM = (sys.executable, "-m", "refcodec")
# Lines of a failed command's stderr that are worth repeating.
_LAST_LINES = 12

# The measures of `refcodec eval`.
FIGURES = {"psnr", "ssim", "psnr_3dgs", "ssim_3dgs"}

Show = Callable[[str, str], None]


class RunError(Exception):
    """A command that failed, with its exit status, or a folder that cannot be used (64)."""

    def __init__(self, text: str, status: int = 64) -> None:
        self.status = status
        super().__init__(text)


class OtherFolderError(RunError):
    """A folder that has no notes, or notes of something else, or damaged ones."""


@dataclass(frozen=True)
class Command:
    """refcodec with some arguments.

    subject: the name of its line of progress. output: the file or folder that it makes. after: names of commands
    whose output it reads. printed: whether its output is its stdout. state: the file that an interrupted command
    leaves, for --resume. free: further arguments on which its output does not depend, such as its threads.
    """

    subject: str
    arguments: tuple[str, ...]
    output: Path
    after: tuple[str, ...] = ()
    printed: bool = False
    state: Path | None = None
    free: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """Unique in its notes: no subject is given to a command twice."""
        return f"{self.subject} {self.arguments[0]}"

    def __str__(self) -> str:
        """As it is typed in a shell."""
        text = " ".join(map(shell_word, ["refcodec", *self.arguments, *self.free]))
        return f"{text} > {shell_word(str(self.output))}" if self.printed else text


def has(path: Path) -> bool:
    """Whether the output of a command exists. Raises RunError for something else in its place, and OSError.

    An unreadable output is not missing, so that hours of work are not repeated.
    """
    try:
        return is_there(path)
    except NotAFileError as error:
        raise RunError(f"{path}: {error}; remove it, and the same command makes it again") from None


def _are_notes(value: Any) -> bool:
    """Whether a JSON value has the form of the commands of Notes."""

    def texts(value: Any) -> bool:
        return isinstance(value, list) and all(isinstance(text, str) for text in value)

    return isinstance(value, dict) and all(
        isinstance(note, dict)
        and texts(note.get("arguments"))
        and texts(note.get("after"))
        and is_number(note.get("seconds"))
        and isinstance(note.get("done"), bool)
        for note in value.values()
    )


def is_number(value: Any) -> bool:
    """Whether a JSON value is a number."""
    return isinstance(value, int | float) and not isinstance(value, bool)


def read_result(path: Path, *right: Callable[[Any], bool]) -> Any:
    """Returns the JSON output of a command. right: the condition that it must meet. Raises RunError."""
    try:
        found = read_json(path)
        # A check that meets a value of another type has failed.
        if all(check(found) for check in right):
            return found
        problem = "it is not the output of the command"
    except DocumentError as error:
        problem = f"it is not JSON ({error})"
    except (KeyError, TypeError, AttributeError):
        problem = "it is not the output of the command"
    except OSError as error:
        problem = error.strerror or str(error)
    raise RunError(f"{path}: {problem}; remove it, and the same command makes it again")


def is_report(found: Any) -> bool:
    """Whether a document has the used fields of a training.json."""
    return is_number(found["steps"]) and all(is_number(e["seconds"]) and is_number(e["psnr"]) for e in found["history"])


def is_evaluation(found: Any) -> bool:
    """Whether a document has the used fields of the output of `refcodec eval --json`."""
    return (
        is_number(found["bytes"])
        and is_number(found["anchors"])
        and all(map(is_number, found["parts"].values()))
        and all(map(is_number, found["mean"].values()))
        and found["mean"].keys() >= FIGURES
        and all(isinstance(e["image"], str) and all(is_number(e[f]) for f in FIGURES) for e in found["images"])
    )


@dataclass
class Notes:
    """The record of the commands of a folder: a JSON file in it. format: the kind of folder."""

    path: Path
    format: str
    commands: dict[str, Any] = field(default_factory=dict)
    _lock: Any = field(default_factory=threading.Lock)

    @classmethod
    def open(cls, folder: Path, name: str, format: str) -> Notes:
        """Opens the notes of a folder, which is created.

        Raises OtherFolderError if it has other content, and RunError if it cannot be read or written.
        """
        path = folder / name
        try:
            folder.mkdir(parents=True, exist_ok=True)
            if is_there(path):
                found = read_json(path)
                if isinstance(found, dict) and found.get("format") == format and _are_notes(found.get("commands")):
                    return cls(path, format, found["commands"])
            elif is_empty(folder):
                notes = cls(path, format)
                notes._write()
                return notes
        except OSError as error:
            raise RunError(f"{error.filename}: {error.strerror}") from None
        except (DocumentError, NotAFileError):
            pass
        raise OtherFolderError(f"{folder} exists and is not a folder of this command: choose another one, or empty it")

    def _write(self) -> None:
        text = json.dumps({"format": self.format, "commands": self.commands}, indent=1) + "\n"
        write_file(self.path, text.encode())

    def is_done(self, command: Command) -> bool:
        """Whether a command finished with these arguments, and its output exists. Raises RunError and OSError."""
        note = self.commands.get(command.name, {})
        return bool(note.get("done")) and note["arguments"] == list(command.arguments) and has(command.output)

    def can_resume(self, command: Command) -> bool:
        """Whether a command with these arguments was interrupted and left its state. Raises RunError and OSError."""
        note = self.commands.get(command.name, {})
        return command.state is not None and has(command.state) and note.get("arguments") == list(command.arguments)

    def seconds(self, name: str) -> float:
        """The wall time of a command, including interrupted runs."""
        return float(self.commands[name]["seconds"])

    def processor_seconds(self, name: str) -> float:
        """The processor time of a command, including interrupted runs."""
        return float(self.commands[name].get("processor_seconds", 0.0))

    def begin(self, command: Command) -> None:
        """Notes that a command begins. Results made from its earlier output no longer count as done."""
        with self._lock:
            goes_on = self.can_resume(command)
            before = (self.seconds(command.name), self.processor_seconds(command.name)) if goes_on else (0.0, 0.0)
            gone = {command.name}
            while more := {
                name for name, note in self.commands.items() if name not in gone and gone & set(note["after"])
            }:
                gone |= more
            for name in gone:
                self.commands.pop(name, None)
            note = {
                "arguments": list(command.arguments),
                "after": list(command.after),
                "seconds": before[0],
                "processor_seconds": before[1],
                "done": False,
            }
            self.commands[command.name] = note
            self._write()

    def end(self, command: Command, seconds: float, done: bool, processor_seconds: float = 0.0) -> None:
        with self._lock:
            note = self.commands[command.name]
            note["seconds"] += seconds
            note["processor_seconds"] += processor_seconds
            note["done"] = done
            self._write()


class Runner:
    """Runs chains of commands, `jobs` at a time.

    show: receives the subject of a command and each line that it writes to stderr. held: file descriptors that the
    processes inherit. Under run(), the signals of files.interrupts are passed on to the processes as SIGINT, so that
    training runs save their state. A second signal kills them.
    """

    notes: Notes
    show: Show
    jobs: int
    held: tuple[int, ...]

    def __init__(self, notes: Notes, show: Show, jobs: int, held: tuple[int, ...] = ()) -> None:
        self.notes, self.show, self.jobs, self.held = notes, show, jobs, held
        self._running: set[subprocess.Popen[str]] = set()
        self._stopped = False

    def run(self, chains: Sequence[Sequence[Command]]) -> bool:
        """Runs the commands that are not done. Returns whether all are done now: False after an interrupt.

        Raises RunError if a command fails.
        """
        self._stopped = False
        with self._signals(), ThreadPoolExecutor(self.jobs) as pool:
            futures = [pool.submit(self.chain, chain) for chain in chains]
            wait(futures)
        for future in futures:
            future.result()
        return not self._stopped

    @contextlib.contextmanager
    def _signals(self) -> Iterator[None]:
        def pass_on(number: int, frame: FrameType | None) -> None:
            self.stop(signal.SIGKILL if self._stopped else signal.SIGINT)

        with on_interrupt(pass_on):
            yield

    def stop(self, number: int) -> None:
        """Sends a signal to the running processes, and starts no more."""
        # No lock: a handler may interrupt the thread that holds it.
        self._stopped = True
        for process in tuple(self._running):
            _send(process, number)

    def chain(self, commands: Sequence[Command]) -> None:
        """Runs the commands that are not done, one after the other, until stop(). Raises RunError if one fails."""
        for command in commands:
            if self._stopped:
                return
            if self.notes.is_done(command):
                self.show(command.subject, f"{command.arguments[0]}: done before")
            elif not self._one(command):
                return

    def _one(self, command: Command) -> bool:
        """Runs a command. Returns whether it finished. Raises RunError if it failed."""
        resume = ["--resume"] if self.notes.can_resume(command) else []
        if command.state is not None and not resume:
            # The state belongs to other arguments. The command does not start while it exists.
            command.state.unlink(missing_ok=True)
        self.notes.begin(command)
        began = time.perf_counter()
        with contextlib.ExitStack() as stack:
            stage = stack.enter_context(Stage())
            printed = stage.open(command.output) if command.printed else subprocess.DEVNULL
            # In its own process group, the process receives Ctrl-C only once, from stop().
            process = stack.enter_context(
                subprocess.Popen(
                    [*PROGRAM, *command.arguments, *command.free, *resume],
                    stdout=printed,
                    stderr=subprocess.PIPE,
                    text=True,
                    errors="replace",
                    process_group=0,
                    pass_fds=self.held,
                )
            )
            self._running.add(process)
            if self._stopped:
                _send(process, signal.SIGINT)
            assert process.stderr is not None
            last: list[str] = []
            for line in process.stderr:
                last = [*last[1 - _LAST_LINES :], line.rstrip()]
                self.show(command.subject, f"{command.arguments[0]}: {line.strip()}")
            # Like process.wait(), but also returns the processor time.
            _, ended, used = os.wait4(process.pid, 0)
            process.returncode = status = os.waitstatus_to_exitcode(ended)
            self._running.discard(process)
            if status:
                stage.cancel()
        seconds = time.perf_counter() - began
        self.notes.end(command, seconds, status == 0, used.ru_utime + used.ru_stime)
        if status == 0:
            self.show(command.subject, f"{command.arguments[0]}: done in {seconds:.1f} s")
            return True
        if self._stopped:
            return False
        if resume and status == statuses.USAGE:
            return self._anew(command)
        # If one command fails, the others are stopped and save their state.
        self.stop(signal.SIGINT)
        raise RunError("\n".join([f"this command failed: {command}", *last]), status if status > 0 else os.EX_SOFTWARE)

    def _anew(self, command: Command) -> bool:
        """Calls _one without the saved state, which is restored unless the run saves another one or finishes."""
        assert command.state is not None
        aside = command.state.with_name(f"{command.state.name}.refused")
        command.state.replace(aside)
        self.show(command.subject, f"{command.arguments[0]}: cannot be resumed, and is restarted")
        try:
            return self._one(command)
        finally:
            if has(command.state) or self.notes.is_done(command):
                aside.unlink()
            else:
                aside.replace(command.state)


def _send(process: subprocess.Popen[str], number: int) -> None:
    # Popen.send_signal may reap the process before the thread that waits for it does.
    with contextlib.suppress(ProcessLookupError):
        os.kill(process.pid, number)


@contextlib.contextmanager
def shown(names: Sequence[str]) -> Iterator[Show]:
    """Shows the stderr output of the commands, by subject.

    On a terminal each subject has one line, which is overwritten. Elsewhere all lines are kept.
    """
    width = max(len(name) for name in names)
    if not sys.stderr.isatty():
        yield lambda name, text: note(f"{name:<{width}}  {text}")
        return
    from tqdm import tqdm  # noqa: PLC0415

    bars = {
        name: tqdm(total=0, position=i, bar_format="{desc}", dynamic_ncols=True, file=ProgressStream())
        for i, name in enumerate(names)
    }
    try:
        yield lambda name, text: bars[name].set_description_str(f"{name:<{width}}  {printable(text)}")
    finally:
        for bar in bars.values():
            bar.close()
