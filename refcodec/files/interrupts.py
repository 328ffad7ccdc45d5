"""What ends a run early: Ctrl-C, the SIGTERM that stops programs, and the SIGHUP of a terminal that closes."""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Callable, Iterator
from types import FrameType

# SIGHUP is not on every system.
SIGNALS = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))


@contextlib.contextmanager
def on_interrupt(
    handle: Callable[[int, FrameType | None], object] = signal.default_int_handler,
) -> Iterator[None]:
    """Lets these signals call a function until the block ends. Only in the main thread can it do so.

    A SIGHUP that is ignored stays so: nohup asks for that. handle: the function. The default raises KeyboardInterrupt.
    """
    before = {}
    try:
        if threading.current_thread() is threading.main_thread():
            for number in SIGNALS:
                if number == signal.SIGINT or signal.getsignal(number) is not signal.SIG_IGN:
                    before[number] = signal.signal(number, handle)
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
