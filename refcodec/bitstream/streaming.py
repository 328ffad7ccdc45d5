"""A file that is decoded some chunks at a time, in bounded memory (SPEC.md 10.2 and 13.1).

`decoded_chunks` is for programs that want chunks, as symbols and as values. `pieces` is for what goes over a whole
file: it gives as many chunks at once as are decoded side by side.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import BinaryIO

from .batches import GROUP_ANCHORS, Progress, no_progress
from .bounds import Bounds
from .errors import BitstreamError
from .header import Header, read_header
from .reader import Chunk, Opened, Reader
from .reconstruction import Reconstruction, reconstruct
from .scene import Scene
from .source import Source

# How many bytes are read at once of what does not tell its length.
_BLOCK_BYTES = 1 << 20


@dataclass(frozen=True, eq=False)
class DecodedChunk:
    """A decoded chunk.

    number: its place among the chunks. first: the number of its first anchor in the file.
    scene: with the anchors of the chunk alone, as symbols. values: the same anchors as float32.
    """

    number: int
    first: int
    scene: Scene
    values: Reconstruction


def decoded_chunks(
    source: Source, numbers: range | None = None, *, side_by_side: bool = True, bounds: Bounds | None = None
) -> Iterator[DecodedChunk]:
    """SPEC 10.2: yields the chunks of a file in order, decoded.

    Without `numbers` the whole file is read and checked: the iterator ends only if the file is accepted. With them, the
    sections that decoding needs and the bytes of these chunks are read, and nothing else.

    Args:
        source: a file on a disk, one that is fetched by ranges, or one that arrives.
        numbers: those of the wanted chunks, rising.
        side_by_side: whether many chunks are read and decoded at once, which is faster. Otherwise a chunk is yielded
            before the next one is read.
        bounds: what the caller allows.

    Raises:
        BitstreamError: what was yielded before is right.
        BoundPassedError: before the bytes are read that it is about.
        IndexError: the file has not all of these chunks.
    """
    reader = Reader(source, keep_ancillary=False, bounds=bounds, at_once=GROUP_ANCHORS if side_by_side else 0)
    opened = reader.open(critical_only=numbers is not None)
    check_numbers(numbers, len(opened.index))
    for entries in opened.groups(numbers, side_by_side=side_by_side):
        for entry, found in zip(entries, opened.decode(entries), strict=True):
            if isinstance(found, BitstreamError):
                raise found
            scene = opened.scene([found])
            yield DecodedChunk(entry.number, entry.anchors.start, scene, reconstruct(scene))
    if numbers is None:
        opened.close()


def check_numbers(numbers: range | None, count: int) -> None:
    """Raises IndexError if a file with `count` chunks has not all chunks of these numbers. None stands for all."""
    for number in (numbers[0], numbers[-1]) if numbers else ():
        if not 0 <= number < count:
            raise IndexError(f"there is no chunk {number}: the file has {count}")


def pieces(
    opened: Opened,
    numbers: Sequence[int] | None = None,
    *,
    damage: dict[int, BitstreamError] | None = None,
    progress: Progress = no_progress,
) -> Iterator[Scene]:
    """SPEC 10.1, CHUNKS: yields the anchors of chunks that are decoded side by side, in order, each time as a scene.

    Args:
        opened: the file.
        numbers: those of the wanted chunks, rising, or None for all.
        damage: gets the first error of each chunk that has one, by number. The chunk is left out then. Without it, such
            an error is raised.
        progress: told of the work.
    """
    total = len(opened.index) if numbers is None else len(numbers)
    done = 0
    progress("chunks", 0, total)
    for entries in opened.groups(numbers):
        good: list[Chunk] = []
        for entry, found in zip(entries, opened.decode(entries), strict=True):
            if isinstance(found, Chunk):
                good.append(found)
            elif damage is None:
                raise found
            else:
                damage[entry.number] = found
        done += len(entries)
        yield opened.scene(good)
        progress("chunks", done, total)


class _Beginning:
    """The first bytes of a file, as far as they were asked for (source.Source). held: these bytes."""

    def __init__(self, file: BinaryIO) -> None:
        self._file, self.held = file, b""

    def read(self, start: int, size: int) -> bytes:
        """As Source.read."""
        self.held += self._file.read(max(0, start + size - len(self.held)))
        return self.held[start : start + size]

    def length(self) -> int:
        """As Source.length: it is asked for only at the end of the file."""
        return len(self.held)


def stated_bytes(file: BinaryIO, check: Callable[[Header], None]) -> bytes:
    """Returns the bytes of a pipe, or another file without a length, up to one past the end that its header states.

    check: told of the header before what lies behind it is read. Raises BitstreamError for the header, and OSError.
    """
    beginning = _Beginning(file)
    header = read_header(beginning)
    check(header)
    # What the header states may be more than there is, and more than there is memory.
    found = io.BytesIO(beginning.held)
    left = header.sections[-1].end + 1 - found.seek(0, io.SEEK_END)
    while left > 0 and (block := file.read(min(left, _BLOCK_BYTES))):
        left -= found.write(block)
    return found.getvalue()
