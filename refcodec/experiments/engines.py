"""Engines, which run the cells of an experiment, and the signal that stops them."""

from __future__ import annotations

import contextlib
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from types import FrameType

from ..files.interrupts import on_interrupt
from .work import Outcome, Task, Wanted, run_cell


@dataclass
class Stop:
    """Whether to stop. number: 0, or the signal that running commands receive."""

    number: int = 0

    def wanted(self) -> int:
        """As work.Wanted."""
        return self.number

    @contextlib.contextmanager
    def on_signals(self) -> Iterator[None]:
        """Makes the signals of files.interrupts stop training runs, which save their state. A second one kills them."""

        def handle(number: int, frame: FrameType | None) -> None:
            self.number = signal.SIGKILL if self.number else signal.SIGINT

        with on_interrupt(handle):
            yield


# Runs tasks. It calls its third argument with a task that begins and its fourth with the outcome, from any thread, and
# returns when all tasks have ended. A task that has not begun when the engine is stopped is left out. No task ends the
# others.
Engine = Callable[[Sequence[Task], Stop, Callable[[Task], None], Callable[[Outcome], None]], None]


@dataclass(frozen=True)
class Local:
    """An Engine of this machine. jobs: cells at a time. run: runs a cell, in any thread."""

    jobs: int
    run: Callable[[Task, Wanted], Outcome] = run_cell

    def __call__(
        self, tasks: Sequence[Task], stop: Stop, begun: Callable[[Task], None], ended: Callable[[Outcome], None]
    ) -> None:
        """As Engine."""

        def run(task: Task) -> None:
            if not stop.number:
                begun(task)
                ended(self.run(task, stop.wanted))

        with ThreadPoolExecutor(self.jobs) as pool:
            futures = [pool.submit(run, task) for task in tasks]
        for future in futures:
            future.result()
