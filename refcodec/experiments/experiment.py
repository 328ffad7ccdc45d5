"""An experiment in its folder: the cells that are done or missing, and the call that runs them."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from .. import statuses
from ..files.documents import DocumentError, read_json
from ..files.lock import is_empty
from ..files.present import NotAFileError, is_there
from ..files.stage import write_file
from ..files.terminal import note
from ..photographs.photographs import TEST_EVERY, PhotographError, parse_size, read_photographs
from .cells import Cell, hash_of, read_result
from .engines import Engine, Stop
from .identity import Identities
from .plan import Experiment, ExperimentError, Scene
from .work import Outcome, Task

FORMAT = "C3GS experiment"
MARK, COPY, PHOTOGRAPHS = "experiment.json", "experiment.toml", "photographs.json"
# The largest number of missing or failed cells that are named.
_NAMED = 20


class Folder:
    """The folder of an experiment, which is created. Raises ExperimentError if it has other content, and OSError.

    A mark that cannot be read is an OSError: the folder may well be that of an experiment.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        path.mkdir(parents=True, exist_ok=True)
        mark = path / MARK
        try:
            if not is_there(mark) and is_empty(path):
                write_file(mark, f"{json.dumps({'format': FORMAT})}\n".encode())
            if is_there(mark) and read_json(mark)["format"] == FORMAT:
                return
        except (NotAFileError, DocumentError, KeyError, TypeError):
            pass
        raise ExperimentError(f"{path} exists and is not the folder of an experiment: choose another one, or empty it")


@dataclass
class State:
    """Which cells of an experiment are done. results: theirs, by name. photographs: digests by scene.

    missing: cells that are not done. unknown: scenes whose photographs are missing, so that their results are used
    unchecked.
    """

    results: dict[str, dict[str, Any]]
    missing: list[Cell]
    photographs: dict[str, str]
    unknown: list[str]


def look(experiment: Experiment, folder: Folder, chosen: Sequence[Cell], need: bool) -> State:
    """Returns which of some cells are done.

    need: whether photographs must exist and be readable. Raises ExperimentError if they do not, PhotographError and
    OSError.
    """
    identities = Identities(folder.path / PHOTOGRAPHS)
    state = State({}, [], {}, [])
    sizes: dict[str, set[str]] = {}
    for cell in chosen:
        sizes.setdefault(cell.scene.name, set()).add(cell.settings.size)
    for scene in experiment.scenes:
        if scene.name in sizes:
            digest = _photographs(experiment, scene, sizes[scene.name], identities, need)
            if digest is None:
                state.unknown.append(scene.name)
            else:
                state.photographs[scene.name] = digest
    if need:
        identities.save()
    for cell in chosen:
        result = read_result(cell.folder(folder.path))
        # Missing photographs are assumed to be those of the result.
        digest = state.photographs.get(cell.scene.name) or (result["definition"]["photographs"] if result else "")
        if result and result["hash"] == hash_of(cell.definition(digest)):
            state.results[cell.name] = result
        else:
            state.missing.append(cell)
    return state


def _photographs(
    experiment: Experiment, scene: Scene, sizes: set[str], identities: Identities, need: bool
) -> str | None:
    """The digest of a scene's photographs, None if they are missing and not needed."""
    try:
        path = experiment.photographs(scene)
        if need:
            # Faults in them are reported before anything runs.
            for size in sorted(sizes):
                read_photographs(path, parse_size(size), holdout=TEST_EVERY if scene.holdout is None else scene.holdout)
        elif not path.is_dir():
            return None
        return identities.digest(path)
    except ExperimentError:
        if need:
            raise
        return None
    except PhotographError as error:
        raise ExperimentError(f"scene {scene.name}: {error}") from None


def tasks(experiment: Experiment, folder: Folder, state: State, threads: int) -> list[Task]:
    """Returns the missing cells as tasks for an engine, in the order of rates and seeds, so that curves fill evenly."""
    found = []
    for cell in state.missing:
        place = cell.folder(folder.path.absolute())
        commands = cell.commands(place / "work", experiment.photographs(cell.scene), threads)
        definition = cell.definition(state.photographs[cell.scene.name])
        found.append(Task(cell.name, place, commands, definition, threads, int(cell.device == "cuda")))
    return found


# --- running ----------------------------------------------------------------------------------------------------------


@dataclass
class Watch:
    """Reports on stderr which cells begin and end, how many are left, and about how long those take."""

    total: int
    done: int
    running: dict[str, float] = field(default_factory=dict)
    failed: list[Outcome] = field(default_factory=list)
    interrupted: int = 0
    _seconds: list[float] = field(default_factory=list)
    _lock: Any = field(default_factory=threading.Lock)

    def begun(self, task: Task) -> None:
        """A cell begins."""
        with self._lock:
            self.running[task.name] = time.monotonic()
            self._say(f"{task.name} begins")

    def ended(self, outcome: Outcome) -> None:
        """A cell has ended."""
        with self._lock:
            self.running.pop(outcome.name, None)
            if outcome.status == statuses.DONE:
                self.done += 1
                self._seconds.append(outcome.seconds)
                self._say(f"{outcome.name} is done in {outcome.seconds:.0f} s")
            elif outcome.status == statuses.INTERRUPTED:
                self.interrupted += 1
                self._say(f"{outcome.name} is interrupted")
            else:
                self.failed.append(outcome)
                self._say(f"{outcome.name} has failed")

    def _say(self, event: str) -> None:
        left = self.total - self.done - len(self.running) - len(self.failed) - self.interrupted
        words = f"{self.done} of {self.total} done, {len(self.running)} running, {left} left"
        words += f", {len(self.failed)} failed" if self.failed else ""
        if (seconds := self.seconds_left(left)) is not None:
            words += f", about {duration(seconds)} left"
        note(f"{event}; {words}")

    def seconds_left(self, left: int) -> float | None:
        """Estimated from the mean time of the cells of this call, None before the first. left: cells not begun."""
        if not self._seconds or not self.running:
            return None
        mean, now = sum(self._seconds) / len(self._seconds), time.monotonic()
        rest = sum(max(0.0, mean - (now - began)) for began in self.running.values())
        return (rest + mean * left) / len(self.running)


def duration(seconds: float) -> str:
    """A time in seconds as text for people."""
    if seconds < 100:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 6000 else f"{seconds / 3600:.1f} h"


def run(engine: Engine, wanted: Sequence[Task], total: int) -> tuple[Watch, bool]:
    """Runs tasks. Returns their outcomes, and whether a signal stopped the run.

    total: the number of cells, including those that were done before.
    """
    watch, stop = Watch(total, total - len(wanted)), Stop()
    with stop.on_signals():
        engine(wanted, stop, watch.begun, watch.ended)
    return watch, bool(stop.number)


def named(names: Sequence[str]) -> str:
    """Names as one text, which has only the first ones if they are many."""
    more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
    return ", ".join(names[:_NAMED]) + more
