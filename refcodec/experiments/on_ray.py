"""Jobs as tasks of Ray, on this machine or on a cluster whose machines share the folder, as RAY_ADDRESS says."""

import contextlib
import logging
import os
import signal
import uuid
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from .. import __version__
from ..files.stage import write_file
from ..statuses import FAULT
from .jobs import Job, Outcome, Run, RunError, Wanted, run_job


@contextlib.contextmanager
def on_ray(folder: Path, jobs: int | None, processors: int, gpus: int) -> Iterator[tuple[int, Run]]:
    """Yields the number of jobs at a time, and what runs one. folder: shared by all machines.

    jobs: the most at a time, None for as many as fit. processors, gpus: of a job. Raises ModuleNotFoundError without
    Ray, and RunError without a cluster or with too few processors in it.
    """
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    import ray  # noqa: PLC0415 (an extra, and slow to load)

    # The file states the signal to all machines.
    file = folder / f"stop-{uuid.uuid4().hex}"
    try:
        options: dict[str, Any] = {"num_cpus": os.cpu_count(), "include_dashboard": False}
        options = {} if os.environ.get("RAY_ADDRESS") else options
        try:
            ray.init(log_to_driver=False, logging_level=logging.ERROR, **options)
        except (ConnectionError, RuntimeError, ValueError) as error:
            raise RunError(f"Ray: {' '.join(str(error).split())}") from None
        there = {kind: int(ray.cluster_resources().get(kind, 0)) for kind in ("CPU", "GPU")}
        room = min(there["CPU"] // processors, there["GPU"] // gpus if gpus else there["CPU"])
        if room < 1:
            raise RunError(f"a cell needs {processors} processors and {gpus} GPUs, and Ray has {there}")
        remote = ray.remote(_run).options(num_cpus=processors, num_gpus=gpus)

        def run(job: Job, wanted: Wanted) -> Outcome:
            reference, sent = remote.remote(job, file, __version__), 0
            while not ray.wait([reference], timeout=0.5)[0]:
                if wanted() != sent:
                    sent = wanted()
                    write_file(file, str(int(sent)).encode())
            try:
                return ray.get(reference)
            # The process or its machine was lost.
            except ray.exceptions.RayError as error:
                return Outcome(job.name, FAULT, f"Ray: {str(error).strip()}")

        yield min(room, jobs or room), run
    finally:
        file.unlink(missing_ok=True)
        ray.shutdown()


def _run(job: Job, file: Path, version: str) -> Outcome:
    """Runs a job in a process of Ray. These block SIGINT, which the commands that they start would inherit."""
    if version != __version__:
        return Outcome(job.name, FAULT, f"the machine of this cell has refcodec {__version__} instead of {version}")
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    sent = 0

    def wanted() -> int:
        nonlocal sent
        # The folder of another machine fails now and then: the signal remains what it was.
        with contextlib.suppress(OSError, ValueError):
            sent = int(file.read_text())
        return sent

    return run_job(job, wanted)
