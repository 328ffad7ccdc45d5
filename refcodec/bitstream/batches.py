"""Chunks that are decoded or encoded side by side, in bounded memory (SPEC.md 13.1).

The error that is reported does not depend on what is decoded side by side (SPEC.md 10.1).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from .chunks import Part
from .entropy import Decoder, Trace, open_substream
from .errors import BitstreamError

# The most anchors and the most chunks of a group, which bound its memory. No result depends on them.
GROUP_ANCHORS = 65536
GROUP_CHUNKS = 1024

# A function that is told of the work: the name of the stage, how much of it is done, and how much there is.
Progress = Callable[[str, int, int], None]
T = TypeVar("T")


def no_progress(stage: str, done: int, total: int) -> None:
    """Does nothing. It is the Progress that tells nobody."""


@dataclass(frozen=True)
class Live:
    """The chunks in which no error has been found yet.

    numbers: their numbers in the file. chunks: the anchors of every chunk of the file.

    Arrays of anchors hold only the anchors of these chunks, in order. So chunks that a damaged file only claims to have
    take no memory.
    """

    numbers: list[int]
    chunks: list[range]

    def groups(self) -> Iterator[tuple[list[int], slice]]:
        """Yields the groups of chunks that are coded side by side, as their numbers and the rows of their anchors."""
        group: list[int] = []
        first = row = 0
        for number in self.numbers:
            size = len(self.chunks[number])
            if group and (row + size - first > GROUP_ANCHORS or len(group) == GROUP_CHUNKS):
                yield group, slice(first, row)
                group, first = [], row
            group.append(number)
            row += size
        if group:
            yield group, slice(first, row)

    def ranges(self, group: list[int]) -> list[range]:
        """Returns the anchors of some chunks. group: their numbers in the file."""
        return [self.chunks[number] for number in group]

    def without(self, damage: Mapping[int, BitstreamError] | None) -> tuple[Live, NDArray[np.bool_]]:
        """Returns the chunks that are left without the damaged ones, and which rows of anchors stay, bool [anchors].

        damage: by number of the chunk, or None.
        """
        lost = damage or {}
        keep = [number not in lost for number in self.numbers]
        rows = np.repeat(np.array(keep, dtype=bool), [len(self.chunks[number]) for number in self.numbers])
        return Live([number for number, kept in zip(self.numbers, keep, strict=True) if kept], self.chunks), rows


def each_group(work: Callable[[list[int], slice], T], live: Live, stage: str, progress: Progress) -> Iterator[T]:
    """Yields the result of `work` for each group, in order. A group is worked on when its result is asked for."""
    groups = list(live.groups())
    progress(stage, 0, len(groups))
    for done, group in enumerate(groups, start=1):
        yield work(*group)
        progress(stage, done, len(groups))


def settle(
    results: Iterable[tuple[T, dict[int, BitstreamError]]], damage: dict[int, BitstreamError] | None
) -> Iterator[T]:
    """SPEC 10.1: yields the values of results, and deals with their errors, which are by number of the chunk.

    damage: None, or where the first error of each chunk is noted. If it is None, the error of the lowest chunk is
    raised before any further result is asked for.
    """
    for value, errors in results:
        for number, error in errors.items():
            if damage is None:
                raise error
            damage.setdefault(number, error)
        yield value


class PartDecoder:
    """Decodes the parts of a group of chunks in one section, and finds the first error of each."""

    def __init__(self, data: bytes, part: Part, lanes: int, group: list[int], trace: Trace | None) -> None:
        """lanes: the lanes of each substream. group: the numbers of the chunks."""
        self.group = group
        self.errors: list[BitstreamError | None] = []
        streams = []
        for number in group:
            start, end = part.span(number)
            error = part.check(data, number)
            if error is not None:
                start = end = min(start, len(data))
            stream, syntax_error = open_substream(data, start, end, lanes, part.path(number))
            self.errors.append(error or syntax_error)
            streams.append(stream)
        self.decoder = Decoder(streams, trace)

    def verdicts(self) -> dict[int, BitstreamError]:
        """Returns the first error of each chunk that has one, by number. Call it after the last group."""
        found = {}
        for number, before, after in zip(self.group, self.errors, self.decoder.finish(), strict=True):
            error = before or after
            if error is not None:
                found[number] = error
        return found
