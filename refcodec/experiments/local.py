"""The engine `local`: cells as processes of this machine."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

from .engines import Stop
from .work import Outcome, Task, run_cell


@dataclass(frozen=True)
class Local:
    """An Engine. jobs: cells at a time."""

    jobs: int

    def __call__(
        self, tasks: Sequence[Task], stop: Stop, begun: Callable[[Task], None], ended: Callable[[Outcome], None]
    ) -> None:
        """As Engine."""

        def run(task: Task) -> None:
            if not stop.number:
                begun(task)
                ended(run_cell(task, stop.wanted))

        with ThreadPoolExecutor(self.jobs) as pool:
            futures = [pool.submit(run, task) for task in tasks]
        for future in futures:
            future.result()
