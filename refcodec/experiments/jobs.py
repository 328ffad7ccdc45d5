"""Jobs: chains of commands that write files. They run in parallel, stop at Ctrl-C, and go on where they stopped.

A step of a job is done if the record of the job has it with the same key, and its output is there. The key is the
digest of the step's command, of the files that it reads, and of whatever else the job names. Thus a step runs again
after any change before it, and only then.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import Any, TypeVar

import msgspec
from msgspec import Struct

from .. import __version__
from ..files.documents import DocumentError, checked, read_json
from ..files.interrupts import on_interrupt
from ..files.lock import is_empty
from ..files.present import NotAFileError, is_there
from ..files.stage import Stage, write_file
from ..files.terminal import ProgressStream, note
from ..files.text import printable, shell_word
from ..statuses import DONE, FAULT, INTERRUPTED, USAGE, UsageError

PROGRAM = (sys.executable, "-m")
# Lines of a failed command's stderr that are worth repeating.
_LAST_LINES = 12
# Seconds between two checks for a stop request.
_LOOK = 0.1

T = TypeVar("T")
# Takes the name of a job, and a line of one of its commands.
Show = Callable[[str, str], None]
# Returns 0, or the signal to send to the running command.
Wanted = Callable[[], int]


class RunError(UsageError):
    """A command that failed, with its exit status, or a folder that cannot be used (64)."""

    several_lines = True

    def __init__(self, text: str, status: int = USAGE) -> None:
        self.status = status
        super().__init__(text)


# --- files ------------------------------------------------------------------------------------------------------------


def has(path: Path) -> bool:
    """Whether the output of a command exists. Raises RunError for something else in its place, and OSError.

    An unreadable output is not missing, so that hours of work are not repeated.
    """
    try:
        return is_there(path)
    except NotAFileError as error:
        raise RunError(f"{path}: {error}; remove it, and the same command makes it again") from None


def read(path: Path, kind: type[T]) -> T:
    """Returns the content of a JSON file that a command made, as a Struct. Raises RunError."""
    try:
        value: T = checked(read_json(path), kind)
        return value
    except DocumentError as error:
        raise RunError(f"{path}: {error}; remove it, and the same command makes it again") from None
    except OSError as error:
        raise RunError(f"{path}: {error.strerror or error}") from None


def dumped(document: Any) -> bytes:
    """Returns a Struct, or any value of JSON, as an indented text."""
    return msgspec.json.format(msgspec.json.encode(document), indent=1) + b"\n"


def claim(folder: Path, mark: str, format: str) -> None:
    """Makes a folder, or checks that it is one of this kind. mark: the name of the file that says so.

    Raises RunError for a folder with other content, and OSError. A mark that cannot be read is an OSError, because the
    folder may well be of this kind.
    """
    place = folder / mark
    folder.mkdir(parents=True, exist_ok=True)
    with contextlib.suppress(NotAFileError, DocumentError, TypeError, KeyError):
        if not is_there(place) and is_empty(folder):
            write_file(place, dumped({"format": format}))
        if is_there(place) and read_json(place)["format"] == format:
            return
    raise RunError(f"{folder} exists and is not a folder of this command: choose another one, or empty it")


# --- steps ------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Step:
    """A command of a job.

    words: of the command line, the name of the command first. output: the file that it makes. inputs: files whose
    content the output depends on, besides the words. printed: whether the output is what it prints. state: the file
    that an interrupted command leaves, for --resume. free: further words on which the output does not depend, such as
    the threads. module: the Python module that is run.
    """

    words: tuple[str, ...]
    output: Path
    inputs: tuple[Path, ...] = ()
    printed: bool = False
    state: Path | None = None
    free: tuple[str, ...] = ()
    module: str = "refcodec"

    @property
    def name(self) -> str:
        """The name of the command, unique in a job."""
        return self.words[0]

    def __str__(self) -> str:
        """As it is typed in a shell."""
        program = [self.module] if self.module == "refcodec" else ["python", "-m", self.module]
        text = " ".join(map(shell_word, [*program, *self.words, *self.free]))
        return f"{text} > {shell_word(str(self.output))}" if self.printed else text

    def key(self, other: str) -> str:
        """The digest of everything on which the output depends. other: of the job. Raises OSError for a missing input.

        An input is a file that an earlier step made.
        """
        made_of = [__version__, self.module, *self.words, other]
        made_of += [hashlib.sha256(path.read_bytes()).hexdigest() for path in self.inputs]
        return hashlib.sha256(json.dumps(made_of).encode()).hexdigest()


class Entry(Struct):
    """A step in a record. seconds, processor_seconds: of all its runs, interrupted ones included. done: completed."""

    key: str
    seconds: float = 0.0
    processor_seconds: float = 0.0
    done: bool = False


@dataclass(frozen=True)
class Job:
    """Steps that run one after the other.

    record: the JSON file of what is done; beside it are the lines of all commands, `.log`. depends: the digest of
    further inputs. finish: called with the job after the last step, in the process that ran it.
    """

    name: str
    record: Path
    steps: tuple[Step, ...]
    depends: str = ""
    finish: Callable[[Job], None] | None = None

    @property
    def log(self) -> Path:
        """The file of the lines that the commands write to stderr."""
        return self.record.with_suffix(".log")

    def entries(self) -> dict[str, Entry]:
        """The record by step, empty if it is missing or damaged. Raises RunError and OSError if it cannot be read."""
        with contextlib.suppress(DocumentError):
            return checked(read_json(self.record), dict[str, Entry]) if has(self.record) else {}
        return {}

    def is_done(self, step: Step) -> bool:
        """Whether a step is done. Raises RunError and OSError."""
        entry = self.entries().get(step.name)
        return entry is not None and entry.done and has(step.output) and entry.key == step.key(self.depends)


@dataclass(frozen=True)
class Outcome:
    """The end of a job. status: an exit status (statuses.py). text: why it failed. seconds: its duration."""

    name: str
    status: int
    text: str = ""
    seconds: float = 0.0


def run_job(job: Job, wanted: Wanted, show: Show = lambda name, line: None) -> Outcome:
    """Runs the steps of a job that are not done. It may be called in any thread and process.

    Interrupted commands are resumed. show: receives the lines of the log, too.
    """
    began = time.monotonic()
    status, text = DONE, ""
    try:
        job.record.parent.mkdir(parents=True, exist_ok=True)
        for step in job.steps:
            if job.is_done(step):
                show(job.name, f"{step.name}: done before")
            elif wanted():
                raise RunError("stopped", INTERRUPTED)
            else:
                _run_step(job, step, wanted, show)
        if job.finish:
            job.finish(job)
    except RunError as error:
        status, text = error.status, str(error)
    except OSError as error:
        status, text = USAGE, f"{error.filename or job.record}: {error.strerror or error}"
    return Outcome(job.name, status, text, time.monotonic() - began)


def _run_step(job: Job, step: Step, wanted: Wanted, show: Show) -> None:
    """Runs the command of a step, and notes it in the record. Raises OSError, and RunError if it fails or stops."""
    entry, key = job.entries().get(step.name), step.key(job.depends)
    goes_on = entry is not None and entry.key == key and step.state is not None and has(step.state)
    if step.state is not None and not goes_on:
        # The state belongs to another command. The step does not start while it exists.
        step.state.unlink(missing_ok=True)
    entry = entry if entry is not None and goes_on else Entry(key)

    def noted(done: bool) -> None:
        entry.done = done
        write_file(job.record, dumped({**job.entries(), step.name: entry}))

    noted(False)
    began, sent, rest = time.perf_counter(), 0, ""
    with Stage() as stage, job.log.open("ab") as log, job.log.open(encoding="utf-8", errors="replace") as lines:
        start = lines.seek(0, os.SEEK_END)
        process = subprocess.Popen(
            [*PROGRAM, step.module, *step.words, *step.free, *(["--resume"] if goes_on else [])],
            stdout=stage.open(step.output) if step.printed else subprocess.DEVNULL,
            stderr=log,
            # In its own process group, it receives Ctrl-C only from here, and thus once.
            process_group=0,
        )
        try:
            while True:
                # Like process.poll(), but also returns the processor time.
                ended, status, used = os.wait4(process.pid, os.WNOHANG)
                if ended:
                    process.returncode = os.waitstatus_to_exitcode(status)
                *whole, rest = (rest + lines.read()).split("\n")
                for line in whole:
                    show(job.name, f"{step.name}: {line.strip()}")
                if ended:
                    break
                if wanted() != sent:
                    sent = wanted()
                    os.kill(process.pid, sent)
                time.sleep(_LOOK)
        finally:
            # After an exception the command would go on without anybody who waits for it.
            process.kill()
            process.wait()
        status = process.returncode
        if status:
            stage.cancel()
            lines.seek(start)
            last = lines.read().splitlines()[-_LAST_LINES:]
    entry.seconds += time.perf_counter() - began
    entry.processor_seconds += used.ru_utime + used.ru_stime
    noted(status == DONE)
    if status == DONE:
        show(job.name, f"{step.name}: done in {time.perf_counter() - began:.1f} s")
    elif wanted():
        raise RunError(f"{step.name} was stopped", INTERRUPTED)
    elif goes_on and step.state is not None and status == USAGE:
        show(job.name, f"{step.name}: cannot be resumed, and begins anew")
        refused = step.state.replace(step.state.with_name(f"{step.state.name}.refused"))
        try:
            _run_step(job, step, wanted, show)
        except RunError:
            # The state was not the reason.
            if not has(step.state):
                refused.replace(step.state)
            raise
        refused.unlink()
    else:
        raise RunError("\n".join([f"this command failed: {step}", *last]), status if status > 0 else FAULT)


# --- several jobs -----------------------------------------------------------------------------------------------------

# Runs a job, in any thread.
Run = Callable[[Job, Wanted], Outcome]


def run_jobs(
    jobs: Sequence[Job], workers: int, run: Run = run_job, watch: Watch | None = None, *, together: bool = False
) -> tuple[list[Outcome], bool]:
    """Runs jobs, some at a time. Returns the outcomes of those that began, and whether a signal stopped them.

    The signals of files.interrupts are passed on to the running commands as SIGINT, so that training runs save their
    state, and no other job begins. A second signal kills the commands.

    workers: the number of jobs at a time. together: whether a failed job stops the others.
    """
    sent, interrupted = 0, False

    def handle(number: int, frame: FrameType | None) -> None:
        nonlocal sent, interrupted
        sent, interrupted = signal.SIGKILL if sent else signal.SIGINT, True

    def one(job: Job) -> Outcome | None:
        nonlocal sent
        if sent:
            return None
        if watch:
            watch.begun(job)
        outcome = run(job, lambda: sent)
        if together and outcome.status not in (DONE, INTERRUPTED):
            sent = sent or signal.SIGINT
        if watch:
            watch.ended(outcome)
        return outcome

    with on_interrupt(handle), ThreadPoolExecutor(workers) as pool:
        outcomes = [*pool.map(one, jobs)]
    return [outcome for outcome in outcomes if outcome], interrupted


class Watch:
    """Reports on stderr which jobs begin and end. total: the number of jobs, of which `done` were done before."""

    def __init__(self, total: int, done: int) -> None:
        self.total, self.done, self._lock = total, done, threading.Lock()

    def begun(self, job: Job) -> None:
        """A job begins."""
        note(f"{job.name} begins")

    def ended(self, outcome: Outcome) -> None:
        """A job has ended."""
        words = {DONE: f"is done in {outcome.seconds:.0f} s", INTERRUPTED: "is interrupted"}
        with self._lock:
            self.done += outcome.status == DONE
            note(f"{outcome.name} {words.get(outcome.status, 'has failed')}; {self.done} of {self.total} done")


@contextlib.contextmanager
def shown(names: Sequence[str]) -> Iterator[Show]:
    """Shows the lines of jobs. On a terminal each job has one line, which is overwritten. Elsewhere all are kept."""
    width = max(map(len, names))
    if not sys.stderr.isatty():
        yield lambda name, text: note(f"{name:<{width}}  {text}")
        return
    from tqdm import tqdm  # noqa: PLC0415

    with contextlib.ExitStack() as stack:
        options: dict[str, Any] = {"bar_format": "{desc}", "dynamic_ncols": True, "file": ProgressStream()}
        bars = {name: stack.enter_context(tqdm(total=0, position=i, **options)) for i, name in enumerate(names)}
        yield lambda name, text: bars[name].set_description_str(f"{name:<{width}}  {printable(text)}")
