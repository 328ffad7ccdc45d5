"""What engines have in common: the signal to stop, and what they tell of their cells."""

from __future__ import annotations

import contextlib
import signal
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from types import FrameType
from typing import Protocol

from ..files.interrupts import on_interrupt
from .work import Outcome, Task


@dataclass
class Stop:
    """Whether to stop. number: 0, or the signal that what runs is to get."""

    number: int = 0

    def wanted(self) -> int:
        """As work.Wanted."""
        return self.number

    @contextlib.contextmanager
    def on_signals(self) -> Iterator[None]:
        """The signals of files.interrupts stop trainings, which keep what they have. A second one kills them."""

        def handle(number: int, frame: FrameType | None) -> None:
            self.number = signal.SIGKILL if self.number else signal.SIGINT

        with on_interrupt(handle):
            yield


class Engine(Protocol):
    """Runs cells.

    It calls `begun` with a task that begins and `ended` with what became of it, from any thread. What it has not begun
    when it is stopped, it leaves out. No task ends the others.
    """

    def __call__(
        self, tasks: Sequence[Task], stop: Stop, begun: Callable[[Task], None], ended: Callable[[Outcome], None]
    ) -> None:
        """Returns when all tasks have ended or are left out."""
