"""The work of one cell, the same under every engine: its commands, its log, its result."""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import json
import shutil
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

from .. import __version__, statuses
from ..files.documents import DocumentError, read_json
from ..files.stage import write_file
from .cells import FORMAT, LOG, RESULT, WORK, hash_of, read_result
from .runs import Command, Notes, OtherFolderError, RunError, Runner

NOTES = "commands.json"
# Seconds between two checks for a stop request.
_LOOK = 0.2

# Returns 0, or the signal to send to the running commands.
Wanted = Callable[[], int]


@dataclass(frozen=True)
class Task:
    """A cell to run. folder: of the cell. definition: the inputs of its result. threads, gpus: its resources."""

    name: str
    folder: Path
    commands: tuple[Command, ...]
    definition: dict[str, Any]
    threads: int
    gpus: int


@dataclass(frozen=True)
class Outcome:
    """The outcome of a task. status: an exit status (statuses.py). text: why it failed. seconds: its duration."""

    name: str
    status: int
    text: str = ""
    seconds: float = 0.0


def run_cell(task: Task, wanted: Wanted) -> Outcome:
    """Runs the missing commands of a cell, and writes its result. It may be called in any thread and process.

    Interrupted commands are resumed. Results of another definition are removed first.
    """
    began = time.monotonic()

    def outcome(status: int, text: str = "") -> Outcome:
        return Outcome(task.name, status, text, time.monotonic() - began)

    try:
        if task.definition["refcodec"] != __version__:
            raise RunError(
                f"refcodec is {__version__} here, but {task.definition['refcodec']} at the caller: install one version"
            )
        task.folder.mkdir(parents=True, exist_ok=True)
        with _locked(task.folder / "lock", wanted) as held:
            if held is None:
                return outcome(statuses.INTERRUPTED)
            done = read_result(task.folder)
            if done is None or done["hash"] != hash_of(task.definition):
                _run(task, held, wanted)
        return outcome(statuses.DONE)
    except _InterruptedError:
        return outcome(statuses.INTERRUPTED)
    except RunError as error:
        return outcome(error.status, str(error))
    except OSError as error:
        return outcome(statuses.USAGE, f"{error.filename or task.folder}: {error.strerror or error}")


class _InterruptedError(Exception):
    """The commands were stopped before the last one was done."""


@contextlib.contextmanager
def _locked(path: Path, wanted: Wanted) -> Iterator[IO[str] | None]:
    """Holds a lock that the commands inherit, and keep beyond their caller. Yields None after a stop request."""
    with path.open("w") as file:
        while not _taken(file):
            if wanted():
                yield None
                return
            time.sleep(_LOOK)
        yield file


def _taken(file: IO[str]) -> bool:
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


def _run(task: Task, held: IO[str], wanted: Wanted) -> None:
    work, kind = task.folder / WORK, f"{FORMAT} {hash_of(task.definition)}"
    (task.folder / RESULT).unlink(missing_ok=True)
    try:
        notes = Notes.open(work, NOTES, kind)
    except OtherFolderError:
        # The notes are of another definition, or damaged. Unreadable notes raise another error, and are kept.
        shutil.rmtree(work)
        notes = Notes.open(work, NOTES, kind)
    with (task.folder / LOG).open("a", encoding="utf-8") as log:

        def show(_: str, text: str) -> None:
            print(text, file=log, flush=True)

        runner = Runner(notes, show, 1, (held.fileno(),))
        with _watched(runner, wanted):
            for command in task.commands:
                runner.chain([command])
                if not notes.is_done(command):
                    raise _InterruptedError
    result = {"format": FORMAT, "hash": hash_of(task.definition), **_result(task, notes)}
    write_file(task.folder / RESULT, f"{json.dumps(result, indent=1)}\n".encode())


@contextlib.contextmanager
def _watched(runner: Runner, wanted: Wanted) -> Iterator[None]:
    """Forwards each requested signal once."""
    ended = threading.Event()

    def watch() -> None:
        sent = 0
        while not ended.wait(_LOOK):
            number = wanted()
            if number != sent:
                runner.stop(number)
                sent = number

    thread = threading.Thread(target=watch, daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


def _result(task: Task, notes: Notes) -> dict[str, Any]:
    train, *others = task.commands
    try:
        shown, report = read_json(others[-1].output), read_json(train.output)
        figures = {key: shown[key] for key in ("bytes", "anchors", "parts", "mean", "images")}
        training = {key: report[key] for key in ("steps", "anchors", "bytes")}
    except (DocumentError, KeyError, TypeError) as error:
        raise RunError(f"{task.folder / WORK}: the figures are not whole ({error})", statuses.FAULT) from None
    files = [command.output for command in others if command.arguments[0] == "encode"]
    return {
        "definition": task.definition,
        **figures,
        "training": training,
        "sha256": hashlib.sha256(files[0].read_bytes()).hexdigest() if files else None,
        "seconds": {c.arguments[0]: round(notes.seconds(c.name), 2) for c in task.commands},
        "processor_seconds": {c.arguments[0]: round(notes.processor_seconds(c.name), 2) for c in task.commands},
    }
