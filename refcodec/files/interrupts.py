"""Signals that end a run early: SIGINT (Ctrl-C), SIGTERM, and the SIGHUP of a closing terminal."""

import contextlib
import signal
import threading
from collections.abc import Callable, Iterator
from types import FrameType

# SIGHUP is not on every system.
SIGNALS = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))


@contextlib.contextmanager
def on_interrupt(handle: Callable[[int, FrameType | None], object] = signal.default_int_handler) -> Iterator[None]:
    """Makes these signals call a function until the block ends, if the block runs in the main thread.

    An ignored SIGHUP stays ignored, as nohup requires. handle: the function. The default raises KeyboardInterrupt.
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
