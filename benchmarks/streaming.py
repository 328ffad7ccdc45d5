"""Three ways of reading a file: whole, as its bytes arrive, and one chunk by ranges. Memory, bytes and time of each.

python -m benchmarks.streaming [--anchors 100000]

It writes a section of RESULTS.md. The scene is random: its symbols cost more bytes than those of a trained scene, and
the memory of decoding depends on the number of anchors alone.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

from conformance.cases.scenes import MAIN_DIMENSIONS, random_scene
from refcodec.bitstream.codec import emit
from refcodec.bitstream.directory import DATA
from refcodec.bitstream.reader import Reader
from refcodec.bitstream.source import WholeFile
from refcodec.encoder.quantise import packed
from refcodec.encoder.sizes import choose_lanes, choose_plane_size

from .results import machine, table, write_section

# Bytes of a block of a file that arrives.
BLOCK = 1000
# Runs one way in a process of its own. It prints the largest traced memory, or without tracing the largest resident
# one and the seconds; then the bytes that were read, the reads, the bytes before the first anchors, and a digest.
MEASURED = """
import json, sys, time, tracemalloc
from pathlib import Path
import numpy as np
from refcodec.bitstream.codec import parse
from refcodec.bitstream.reader import Reader, decode_chunk
from refcodec.bitstream.reconstruction import StreamDigest, chunk_digest, digest
from refcodec.bitstream.source import Arriving, Ranges
from refcodec.bitstream.tables import tables
path, way, traced = sys.argv[1], sys.argv[2], sys.argv[3] == "traced"
file = open(path, "rb")
tables()
read = reads = first = 0
def fetch(start, size):
    global read, reads
    file.seek(start)
    read, reads = read + size, reads + 1
    return file.read(size)
def blocks(size):
    global read, reads
    while block := file.read(size):
        read, reads = read + len(block), reads + 1
        yield block
if traced:
    tracemalloc.start()
start = time.perf_counter()
if way == "whole":
    data = file.read()
    read, reads, first = len(data), 1, len(data)
    found = digest(parse(data).scene)[0]
elif way == "arriving":
    reader, stream = Reader(Arriving(blocks(BLOCK))), StreamDigest()
    reader.open()
    for chunk in reader.chunks():
        stream.add(reader.scene([chunk]))
        first = first or read
    reader.close()
    found = stream.finish(reader.scene([]))
else:
    length = Path(path).stat().st_size
    found = chunk_digest(decode_chunk(Ranges(fetch, length), int(way)))
    first = read
seconds = time.perf_counter() - start
fields = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines())
most = tracemalloc.get_traced_memory()[1] if traced else int(fields["VmHWM"].split()[0]) << 10
print(json.dumps([most, seconds, read, reads, first, found]))
""".replace("BLOCK", str(BLOCK))


def measured(path: Path, way: str, traced: bool) -> list[float | str]:
    """What MEASURED prints."""
    command = [sys.executable, "-c", MEASURED, str(path), way, "traced" if traced else "resident"]
    found: list[float | str] = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
    return found


def mib(value: float) -> str:
    """Bytes as 2^20 bytes."""
    return f"{value / (1 << 20):.1f}"


def section(anchors: int) -> list[str]:
    """The section's text."""
    d = replace(MAIN_DIMENSIONS, plane_size=choose_plane_size(anchors))
    lanes = choose_lanes(anchors, 2.0 * d.attribute_width)
    scene = packed(random_scene(17, anchors, d, lanes=lanes), None, None)
    data = emit(scene)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "scene.c3gs"
        path.write_bytes(data)
        middle = str(len(scene.chunks) // 2)
        ways = {"whole file": "whole", f"blocks of {BLOCK} bytes": "arriving", f"chunk {middle} by ranges": middle}
        traced = {name: measured(path, way, True) for name, way in ways.items()}
        plain = {name: measured(path, way, False) for name, way in ways.items()}
    header = Reader(WholeFile(data)).header
    content = header.section(DATA)
    assert content is not None
    whole, arriving, _ = traced.values()
    if whole[5] != arriving[5]:
        raise AssertionError("the two readers do not agree")
    most = float(traced["whole file"][0])
    rows = []
    for name, (peak, _, read, reads, first, _) in traced.items():
        resident, seconds, *_ = plain[name]
        share = max(0.0, (float(first) - content.start) / content.length)
        rows.append(
            [
                name,
                mib(float(peak)),
                f"{float(peak) / most:.3f}",
                mib(float(resident)),
                f"{float(seconds):.2f}",
                f"{int(read):,}",
                f"{int(reads):,}",
                f"{share:.1%}" if name in list(traced)[:2] else "",
            ]
        )
    d = header.dimensions
    head = [
        "reading",
        "traced MiB",
        "share",
        "resident MiB",
        "seconds",
        "bytes",
        "reads",
        "first anchors",
    ]
    return [
        f"`python -m benchmarks.streaming --anchors {anchors}`",
        "",
        machine(),
        f"{anchors:,} random anchors in {len(scene.chunks)} chunks, {len(data):,} bytes.",
        f"{content.start:,} of them come before the chunks. Planes are 5 x {d.plane_channels} x {d.plane_size}^2.",
        "",
        *table(head, rows),
        "",
        "Traced: the largest sum of what Python and numpy allocated, without the program and its tables. Resident: of",
        "the process. Share: of what the whole file takes. First anchors: the share of the chunks' bytes that had",
        "arrived when the first chunk was decoded. The digests of the whole file and of the arriving one are equal.",
    ]


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--anchors", type=int, default=100_000)
    write_section("streaming", "Three ways of reading", section(parser.parse_args().anchors))


if __name__ == "__main__":
    main()
