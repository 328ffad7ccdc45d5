"""Chunks that are decoded or encoded side by side, in bounded memory (SPEC.md 13.1), and the error that counts among theirs."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from .chunks import Part
from .entropy import Decoder, Trace, open_substream
from .errors import BitstreamError

# Bounds of a group's memory: its anchors and its chunks. They have no effect on the result.
GROUP_ANCHORS = 65536
GROUP_CHUNKS = 1024

# Told of work: the stage's name, how much of it is done, and how much there is.
Progress = Callable[[str, int, int], None]
T = TypeVar("T")


def no_progress(stage: str, done: int, total: int) -> None:
    """Tells nobody."""


@dataclass(frozen=True)
class Live:
    """The chunks that no error has taken yet: their numbers in the file, and the anchors of every chunk of the file.

    Arrays of anchors hold those of the live chunks alone, in order. What a damaged file only claims to have costs nothing.
    """

    numbers: list[int]
    chunks: list[range]

    def groups(self) -> Iterator[tuple[list[int], slice]]:
        """Runs of chunks that are coded side by side, and the rows of their anchors."""
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
        """The anchors of some chunks, by their numbers in the file."""
        return [self.chunks[number] for number in group]

    def without(self, damage: Mapping[int, BitstreamError] | None) -> tuple[Live, NDArray[np.bool_]]:
        """What is left, and which rows that are."""
        lost = damage or {}
        keep = [number not in lost for number in self.numbers]
        rows = np.repeat(np.array(keep, dtype=bool), [len(self.chunks[number]) for number in self.numbers])
        return Live([number for number, kept in zip(self.numbers, keep, strict=True) if kept], self.chunks), rows


def each_group(work: Callable[[list[int], slice], T], live: Live, stage: str, progress: Progress) -> Iterator[T]:
    """What `work` gives for each group, in order. A group is worked on when its result is asked for."""
    groups = list(live.groups())
    progress(stage, 0, len(groups))
    for done, group in enumerate(groups, start=1):
        yield work(*group)
        progress(stage, done, len(groups))


def settle(
    results: Iterable[tuple[T, dict[int, BitstreamError]]], damage: dict[int, BitstreamError] | None
) -> Iterator[T]:
    """SPEC 10.1: raises the error of the lowest chunk, before any further group is looked at. With `damage`, notes the
    first error of each chunk there instead."""
    for value, errors in results:
        for number, error in errors.items():
            if damage is None:
                raise error
            damage.setdefault(number, error)
        yield value


class PartDecoder:
    """Decodes one part of a group of chunks, and merges the errors of each chunk into one verdict."""

    def __init__(self, data: bytes, part: Part, lanes: int, group: list[int], trace: Trace | None) -> None:
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
        """The first error of each chunk that has one, by chunk."""
        found = {}
        for number, before, after in zip(self.group, self.errors, self.decoder.finish(), strict=True):
            error = before or after
            if error is not None:
                found[number] = error
        return found
