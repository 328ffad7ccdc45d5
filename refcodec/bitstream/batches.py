"""Chunks coded in parallel, in bounded memory (SPEC.md 13.1).

The reported error is independent of the parallelism (SPEC.md 10.1).
"""

import contextlib
import os
import threading
from collections.abc import Callable, Iterator

from threadpoolctl import threadpool_limits

from .entropy import Decoder, Trace, open_substream
from .errors import BitstreamError
from .source import Piece

# The most anchors and the most chunks of a group, which bound its memory. No result depends on them.
GROUP_ANCHORS = 65536
GROUP_CHUNKS = 1024

# A callback for progress: the name of the stage, the work done, and the total work.
Progress = Callable[[str, int, int], None]


def no_progress(stage: str, done: int, total: int) -> None:
    """Does nothing: the Progress of a caller without one."""


class _OneThread:
    """Limits NumPy's BLAS to one thread. The limit is that of the process, so one thread at a time sets it.

    The thread that sets the limit restores the old one. A concurrent thread changes nothing, because it would save the
    limit of the first as the number to restore.
    """

    def __init__(self) -> None:
        self._owner: int | None = None
        self._limits: threadpool_limits | None = None
        self._lock = threading.Lock()
        if hasattr(os, "register_at_fork"):
            os.register_at_fork(after_in_child=self._forked)

    @contextlib.contextmanager
    def __call__(self) -> Iterator[None]:
        if not self._lock.acquire(blocking=False):
            yield
            return
        try:
            self._owner = threading.get_ident()
            with threadpool_limits(1, "blas") as self._limits:
                yield
        finally:
            self._limits = None
            self._lock.release()

    def _forked(self) -> None:
        """Restores the old limit in a child process, which lacks the thread that set it."""
        if self._limits is not None and self._owner != threading.get_ident():
            self._limits.restore_original_limits()
            self._limits, self._lock = None, threading.Lock()


one_thread: _OneThread = _OneThread()


def groups(chunks: list[range]) -> Iterator[tuple[range, slice]]:
    """Yields groups of chunks to code in parallel, as chunk numbers and the rows of their anchors.

    chunks: the anchors of each chunk.
    """
    first = 0
    for number, chunk in enumerate(chunks):
        if number > first and (chunk.stop - chunks[first].start > GROUP_ANCHORS or number - first == GROUP_CHUNKS):
            yield range(first, number), slice(chunks[first].start, chunks[number - 1].stop)
            first = number
    if first < len(chunks):
        yield range(first, len(chunks)), slice(chunks[first].start, chunks[-1].stop)


class PartDecoder:
    """Decodes the same part of several chunks in parallel, and finds the first error of each."""

    errors: list[BitstreamError | None]
    decoder: Decoder

    def __init__(self, parts: list[tuple[Piece, str]], lanes: int, trace: Trace | None) -> None:
        """parts: at least one, each with its path. lanes: the lanes of each substream."""
        opened = [open_substream(piece, lanes, path) for piece, path in parts]
        self.errors = [error for _, error in opened]
        self.decoder = Decoder([stream for stream, _ in opened], trace)

    def verdicts(self) -> list[BitstreamError | None]:
        """Returns the first error of each part, or None. Call it after the last group of symbols."""
        return [before or after for before, after in zip(self.errors, self.decoder.finish(), strict=True)]
