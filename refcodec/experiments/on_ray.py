"""The engine `ray`: cells as tasks of Ray, on this machine or on a cluster whose machines share the folder.

RAY_ADDRESS names a cluster. Without it a Ray of this machine is started, and ended with the call. A task asks for as
many processors as its training has threads, and for one GPU if its training runs on one.
"""

from __future__ import annotations

import contextlib
import logging
import os
import signal
import uuid
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from .. import statuses
from ..files.stage import write_file
from .engines import Stop
from .runs import RunError
from .work import Outcome, Task, run_cell

# Seconds between two looks at whether to stop.
_LOOK = 0.5


@dataclass(frozen=True)
class OnRay:
    """An Engine.

    folder: of the experiment, shared by all machines. jobs: cells at a time, None for as many as there is room for.
    """

    folder: Path
    jobs: int | None

    def __call__(
        self, tasks: Sequence[Task], stop: Stop, begun: Callable[[Task], None], ended: Callable[[Outcome], None]
    ) -> None:
        """As Engine. Raises ModuleNotFoundError without Ray, RunError if there is no cluster, or no room in it."""
        # A file tells all machines to stop. It holds the number of the signal.
        file = self.folder / f"stop-{uuid.uuid4().hex}"
        with _ray() as ray:
            remote = ray.remote(_run)
            left, told = list(tasks), 0
            running: dict[Any, Task] = {}
            try:
                while left or running:
                    if stop.number:
                        left.clear()
                    if stop.number != told:
                        told = stop.number
                        _write(file, told)
                    while left and len(running) < self._room(ray, left[0]):
                        task = left.pop(0)
                        options = {"num_cpus": task.threads, "num_gpus": task.gpus, "name": task.name}
                        running[remote.options(**options).remote(task, file)] = task
                        begun(task)
                    if running:
                        for reference in ray.wait(list(running), timeout=_LOOK)[0]:
                            ended(_outcome(ray, reference, running.pop(reference)))
            finally:
                file.unlink(missing_ok=True)

    def _room(self, ray: Any, task: Task) -> int:
        """How many tasks may be under way. A cluster may grow on the way."""
        found = ray.cluster_resources()
        room = int(found.get("CPU", 0) // task.threads)
        if task.gpus:
            room = min(room, int(found.get("GPU", 0) // task.gpus))
        if room < 1:
            words = f"{task.threads} processors" + (" and a GPU" if task.gpus else "")
            raise RunError(
                f"a cell needs {words}, and Ray has {found.get('CPU', 0):g} and {found.get('GPU', 0):g} GPUs"
            )
        return min(room, self.jobs or room)


def _write(file: Path, number: int) -> None:
    write_file(file, str(int(number)).encode())


@contextlib.contextmanager
def _ray() -> Iterator[Any]:
    """The module, connected. It sends nothing about its use, and starts no dashboard."""
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    import ray  # noqa: PLC0415 (an extra, and slow to load)

    options: dict[str, Any] = {"log_to_driver": False, "logging_level": logging.ERROR}
    if not os.environ.get("RAY_ADDRESS"):
        options |= {"num_cpus": os.cpu_count() or 1, "include_dashboard": False}
    try:
        ray.init(**options)
    except (ConnectionError, RuntimeError, ValueError) as error:
        raise RunError(f"Ray cannot be reached: {' '.join(str(error).split())}") from None
    try:
        yield ray
    finally:
        ray.shutdown()


def _run(task: Task, file: Path) -> Outcome:
    """What a task does, in a process of Ray."""
    # Ray's processes hold SIGINT back, and so would the commands that they start.
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})

    def wanted() -> int:
        try:
            return int(file.read_text())
        except (OSError, ValueError):
            return 0

    return run_cell(task, wanted)


def _outcome(ray: Any, reference: Any, task: Task) -> Outcome:
    """What became of a task. One whose process or machine was lost has failed."""
    try:
        found: Outcome = ray.get(reference)
    except ray.exceptions.RayError as error:
        return Outcome(task.name, statuses.FAULT, f"Ray: {str(error).strip()}")
    return found
