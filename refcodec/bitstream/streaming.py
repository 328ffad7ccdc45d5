"""Decoding of a file some chunks at a time, in bounded memory (SPEC.md 10.2 and 13.1).

`decoded_chunks` is for programs that need chunks, as symbols and as values. `pieces` is for one pass over a whole file:
it yields as many chunks at once as are decoded in parallel.
"""

import io
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from .batches import GROUP_ANCHORS, Progress, no_progress
from .bounds import Limits
from .errors import BitstreamError
from .header import Header, read_header
from .reader import Chunk, Opened, Reader
from .reconstruction import Reconstruction, reconstruct
from .scene import Scene
from .source import Readable, Source, read_up_to

# The block size, in bytes, for a file without a known length.
_BLOCK_BYTES = 1 << 20


@dataclass(frozen=True, eq=False)
class DecodedChunk:
    """A decoded chunk.

    number: of the chunk. first: the number of its first anchor in the file.
    scene: with only the chunk's anchors, as symbols. values: the same anchors as float32.
    """

    number: int
    first: int
    scene: Scene
    values: Reconstruction


def decoded_chunks(
    source: Source, numbers: range | None = None, *, side_by_side: bool = True, limits: Limits | None = None
) -> Iterator[DecodedChunk]:
    """SPEC 10.2: yields the chunks of a file in order, decoded.

    Without `numbers` the whole file is read and checked: the iterator ends only if the file is accepted. With them,
    only the sections that decoding needs and the bytes of these chunks are read.

    Args:
        source: a file on a disk, fetched by ranges, or arriving.
        numbers: of the wanted chunks, ascending.
        side_by_side: whether many chunks are read and decoded at once, which is faster. Otherwise a chunk is yielded
            before the next one is read.
        limits: the caller's.

    Raises:
        BitstreamError: the first error; the chunks yielded before it are valid.
        BoundPassedError: before the bytes that exceed the limits are read.
        IndexError: the file lacks one of these chunks.
    """
    reader = Reader(source, keep_ancillary=False, limits=limits, at_once=GROUP_ANCHORS if side_by_side else 0)
    opened = reader.open(critical_only=numbers is not None)
    check_numbers(numbers, len(opened.index))
    for entries in opened.groups(numbers, side_by_side=side_by_side):
        for entry, outcome in zip(entries, opened.decode(entries), strict=True):
            if isinstance(outcome, BitstreamError):
                raise outcome
            scene = opened.scene([outcome])
            yield DecodedChunk(entry.number, entry.anchors.start, scene, reconstruct(scene))
    if numbers is None:
        opened.close()


def check_numbers(numbers: range | None, count: int) -> None:
    """Raises IndexError if a file with `count` chunks lacks one of these numbers. None means all chunks."""
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
    """SPEC 10.1, CHUNKS: yields the anchors of chunks in order, each time as a scene of chunks decoded in parallel.

    Args:
        opened: the file.
        numbers: of the wanted chunks, ascending, or None for all.
        damage: receives the first error of each damaged chunk, by number, and the chunk is omitted. Without it, the
            error is raised.
        progress: called as work is done.
    """
    total = len(opened.index) if numbers is None else len(numbers)
    done = 0
    progress("chunks", 0, total)
    for entries in opened.groups(numbers):
        good: list[Chunk] = []
        for entry, outcome in zip(entries, opened.decode(entries), strict=True):
            if isinstance(outcome, Chunk):
                good.append(outcome)
            elif damage is None:
                raise outcome
            else:
                damage[entry.number] = outcome
        done += len(entries)
        yield opened.scene(good)
        progress("chunks", done, total)


class _Beginning:
    """The first bytes of a file, as far as requested (source.Source). held: these bytes."""

    def __init__(self, file: Readable) -> None:
        self._file, self.held = file, b""

    def read(self, start: int, size: int) -> bytes:
        self.held += read_up_to(self._file, max(0, start + size - len(self.held)))
        return self.held[start : start + size]

    def length(self) -> int:
        """As Source.length, which is called only at the end of the file."""
        return len(self.held)


def stated_bytes(file: Readable, check: Callable[[Header], None]) -> bytes:
    """Returns the bytes of a pipe, or another file without a length, up to one past the end that its header states.

    check: called with the header before the bytes after it are read. Raises BitstreamError for the header, and OSError.
    """
    beginning = _Beginning(file)
    header = read_header(beginning)
    check(header)
    # The header is untrusted: its lengths may exceed the file and the memory.
    whole = io.BytesIO(beginning.held)
    left = header.sections[-1].end + 1 - whole.seek(0, io.SEEK_END)
    while left > 0 and (block := file.read(min(left, _BLOCK_BYTES))):
        left -= whole.write(block)
    return whole.getvalue()
