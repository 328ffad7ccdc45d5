"""One way of reading a file, in a separate process: python -m benchmarks.reading FILE WAY

WAY is `whole`, or `arriving`: the file's bytes come in blocks, and each chunk is decoded and released. The process
prints a Reading as JSON.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

from refcodec.bitstream.codec import parse
from refcodec.bitstream.errors import BitstreamError
from refcodec.bitstream.reader import Reader
from refcodec.bitstream.reconstruction import StreamDigest, digest, reconstruct
from refcodec.bitstream.source import Arriving
from refcodec.bitstream.tables import tables

from .resident import resident

WHOLE, ARRIVING = "whole", "arriving"
# Bytes of a block of an arriving file.
BLOCK = 1000


@dataclass(frozen=True)
class Reading:
    """Figures of reading a file.

    peak: the largest resident memory of the process, bytes. seconds, processor: of decoding and of making float32
    values, without the digest. digest: of the scene.
    """

    peak: int
    seconds: float
    processor: float
    digest: str


class ReadingError(Exception):
    """A process that reads a file failed. The message is the last line that it printed, or its status."""


def reading(path: Path, way: str) -> Reading:
    """Reads a file in a separate process. Raises ReadingError."""
    command = [sys.executable, "-m", "benchmarks.reading", str(path), way]
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


def _blocks(path: Path) -> Iterator[bytes]:
    with path.open("rb") as file:
        while block := file.read(BLOCK):
            yield block


def _read(path: Path, way: str) -> Reading:
    tables()
    clock = _Clock()
    if way == WHOLE:
        scene = parse(path.read_bytes()).scene
        values = reconstruct(scene)
        clock.stop()
        peak = resident()
        del values
        identity = digest(scene)[0]
    else:
        reader, stream = Reader(Arriving(_blocks(path))), StreamDigest()
        opened = reader.open()
        for chunk in opened.chunks():
            if isinstance(chunk, BitstreamError):
                raise chunk
            scene = opened.scene([chunk])
            reconstruct(scene)
            clock.stop()
            stream.add(scene)
            clock.start()
        opened.close()
        clock.stop()
        peak = resident()
        identity = stream.finish(opened.scene([]))
    return Reading(peak, clock.seconds, clock.processor, identity)


if __name__ == "__main__":
    print(json.dumps(asdict(_read(Path(sys.argv[1]), sys.argv[2]))))
