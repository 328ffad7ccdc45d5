"""One way of reading a file, in a process of its own: python -m benchmarks.reading FILE WAY [traced]

WAY is `whole`, `arriving` (the file's bytes come in blocks, and each chunk is decoded and let go), or the number of a
chunk, which is read by ranges. With `warm` before the number the file is open, and chunks were decoded before. The
process prints a Reading as JSON.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
import tracemalloc
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

from refcodec.bitstream.codec import parse
from refcodec.bitstream.errors import BitstreamError
from refcodec.bitstream.reader import Reader, decode_chunk
from refcodec.bitstream.reconstruction import StreamDigest, chunk_digest, digest, reconstruct
from refcodec.bitstream.source import Arriving, Ranges
from refcodec.bitstream.tables import tables

from .resident import resident

WHOLE, ARRIVING, WARM, TRACED = "whole", "arriving", "warm", "traced"
# Bytes of a block of a file that arrives.
BLOCK = 1000


@dataclass(frozen=True)
class Reading:
    """What reading a file took.

    peak: the most bytes, of what Python and numpy allocated if it is traced, else of what the process had in memory.
    seconds, processor: of decoding and of making float32 values, without the digest. read, reads: bytes, and in how
    many pieces. first: the bytes before the first anchors. digest: of the scene, or of the chunk.
    """

    peak: int
    seconds: float
    processor: float
    read: int
    reads: int
    first: int
    digest: str


class ReadingError(Exception):
    """A process that reads a file failed. The message is the last line that it printed, or its status."""


def reading(path: Path, way: str, traced: bool = False) -> Reading:
    """Reads a file in a process of its own. Raises ReadingError."""
    command = [sys.executable, "-m", "benchmarks.reading", str(path), way, *([TRACED] if traced else [])]
    root = str(Path(__file__).resolve().parent.parent)
    search = os.pathsep.join(filter(None, [root, os.environ.get("PYTHONPATH")]))
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=os.environ | {"PYTHONPATH": search})
    if done.returncode:
        raise ReadingError(next(reversed(done.stderr.splitlines()), f"status {done.returncode}"))
    return Reading(**json.loads(done.stdout))


class _Clock:
    """Measures seconds and processor seconds while it runs."""

    def __init__(self) -> None:
        self.seconds = self.processor = 0.0
        self.start()

    def start(self) -> None:
        self._seconds, self._processor = time.perf_counter(), time.process_time()

    def stop(self) -> None:
        self.seconds += time.perf_counter() - self._seconds
        self.processor += time.process_time() - self._processor


class _File:
    """A file that counts what is read of it."""

    def __init__(self, path: Path) -> None:
        self._file, self.size = path.open("rb"), path.stat().st_size
        self.read = self.reads = 0

    def fetch(self, start: int, size: int) -> bytes:
        self._file.seek(start)
        data = self._file.read(size)
        self.read, self.reads = self.read + size, self.reads + 1
        return data

    def blocks(self) -> Iterator[bytes]:
        for start in range(0, self.size, BLOCK):
            yield self.fetch(start, min(BLOCK, self.size - start))


def _read(path: Path, way: str, traced: bool) -> Reading:
    file = _File(path)
    tables()
    if traced:
        tracemalloc.start()

    def peak() -> int:
        return tracemalloc.get_traced_memory()[1] if traced else resident()

    first, clock = 0, _Clock()
    if way == WHOLE:
        first = file.size
        scene = parse(file.fetch(0, file.size)).scene
        values = reconstruct(scene)
        clock.stop()
        most = peak()
        del values
        found = digest(scene)[0]
    elif way == ARRIVING:
        reader, stream = Reader(Arriving(file.blocks())), StreamDigest()
        opened = reader.open()
        for chunk in opened.chunks():
            if isinstance(chunk, BitstreamError):
                raise chunk
            scene = opened.scene([chunk])
            reconstruct(scene)
            first = first or file.read
            clock.stop()
            stream.add(scene)
            clock.start()
        opened.close()
        clock.stop()
        most = peak()
        found = stream.finish(opened.scene([]))
    elif way.startswith(WARM):
        number = int(way.removeprefix(WARM))
        reader = Reader(Ranges(file.fetch, file.size), keep_ancillary=False)
        opened = reader.open(critical_only=True)
        index = opened.index
        opened.decode([index[number - 1]])
        file.read = file.reads = 0
        clock = _Clock()
        (chunk,) = opened.decode([index[number]])
        if isinstance(chunk, BitstreamError):
            raise chunk
        scene = opened.scene([chunk])
        reconstruct(scene)
        clock.stop()
        most, first = peak(), file.read
        found = chunk_digest(scene)
    else:
        scene = decode_chunk(Ranges(file.fetch, file.size), int(way))
        reconstruct(scene)
        clock.stop()
        most, first = peak(), file.read
        found = chunk_digest(scene)
    return Reading(most, clock.seconds, clock.processor, file.read, file.reads, first, found)


if __name__ == "__main__":
    print(json.dumps(asdict(_read(Path(sys.argv[1]), sys.argv[2], sys.argv[3:] == [TRACED]))))
