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
from .engines import Local, Stop
from .runs import RunError
from .work import Outcome, Task, Wanted, run_cell

# Seconds between two checks for a stop request.
_LOOK = 0.5


@dataclass(frozen=True)
class OnRay:
    """An Engine.

    folder: of the experiment, shared by all machines. jobs: cells at a time, None for as many as fit the cluster.
    """

    folder: Path
    jobs: int | None

    def __call__(
        self, tasks: Sequence[Task], stop: Stop, begun: Callable[[Task], None], ended: Callable[[Outcome], None]
    ) -> None:
        """As Engine. All tasks need as much as the first one.

        Raises ModuleNotFoundError without Ray, and RunError without a cluster or with too few processors in it.
        """
        # The file states the signal to all machines.
        file = self.folder / f"stop-{uuid.uuid4().hex}"
        with _ray() as ray:
            remote = ray.remote(_run)

            def run(task: Task, wanted: Wanted) -> Outcome:
                options = {"num_cpus": task.threads, "num_gpus": task.gpus, "name": task.name}
                reference, sent = remote.options(**options).remote(task, file), 0
                while not ray.wait([reference], timeout=_LOOK)[0]:
                    if wanted() != sent:
                        sent = wanted()
                        write_file(file, str(int(sent)).encode())
                try:
                    outcome: Outcome = ray.get(reference)
                # The process or its machine was lost.
                except ray.exceptions.RayError as error:
                    return Outcome(task.name, statuses.FAULT, f"Ray: {str(error).strip()}")
                return outcome

            try:
                Local(self._room(ray, tasks[0]), run)(tasks, stop, begun, ended)
            finally:
                file.unlink(missing_ok=True)

    def _room(self, ray: Any, task: Task) -> int:
        """The number of tasks at a time."""
        resources = ray.cluster_resources()
        room = int(resources.get("CPU", 0) // task.threads)
        if task.gpus:
            room = min(room, int(resources.get("GPU", 0) // task.gpus))
        if room < 1:
            words = f"{task.threads} processors" + (" and a GPU" if task.gpus else "")
            raise RunError(
                f"a cell needs {words}, and Ray has {resources.get('CPU', 0):g} and {resources.get('GPU', 0):g} GPUs"
            )
        return min(room, self.jobs or room)


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
    """Runs a task in a process of Ray."""
    # Ray's processes block SIGINT, and the commands that they start would inherit this.
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})

    def wanted() -> int:
        try:
            return int(file.read_text())
        except (OSError, ValueError):
            return 0

    return run_cell(task, wanted)
