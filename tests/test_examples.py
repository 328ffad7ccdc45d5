"""The programs of examples/ do what they say, on a file that arrives, and on one that is fetched by ranges."""

from __future__ import annotations

import re
import subprocess
import sys
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest

from conformance.cases.scenes import random_scene
from refcodec.bitstream.codec import emit
from refcodec.bitstream.directory import DATA
from refcodec.bitstream.header import Lanes
from refcodec.bitstream.reader import Reader
from refcodec.bitstream.reconstruction import chunk_digest, digest
from refcodec.bitstream.scene import Scene, take_anchors
from refcodec.bitstream.source import WholeFile

EXAMPLES = Path(__file__).resolve().parents[1] / "examples" / "reading"
CHUNKS, ANCHORS = 40, 50


@pytest.fixture(scope="module")
def scene() -> Scene:
    return random_scene(91, CHUNKS * ANCHORS, chunk_size=ANCHORS, lanes=Lanes(0, 0, 0))


@pytest.fixture(scope="module")
def data(scene: Scene) -> bytes:
    return emit(scene)


@pytest.fixture
def server(data: bytes) -> Iterator[str]:
    """A server that answers ranges, and its address."""

    class Handler(BaseHTTPRequestHandler):
        def do_HEAD(self) -> None:
            self.send_response(200)
            self.send_header("Content-Length", str(len(data)))
            self.end_headers()

        def do_GET(self) -> None:
            first, last = map(int, self.headers["Range"].removeprefix("bytes=").split("-"))
            self.send_response(206)
            self.send_header("Content-Length", str(last - first + 1))
            self.end_headers()
            self.wfile.write(data[first : last + 1])

        def log_message(self, *_: object) -> None:
            """Says nothing."""

    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as serving:
        threading.Thread(target=serving.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{serving.server_port}/scene.c3gs"
        serving.shutdown()


def run(program: str, *words: str, given: bytes | None = None) -> list[str]:
    command = [sys.executable, str(EXAMPLES / program), *words]
    return subprocess.run(command, input=given, capture_output=True, check=True).stdout.decode().splitlines()


@pytest.mark.parametrize("far", [False, True])
@pytest.mark.parametrize("number", [0, 17, CHUNKS - 1])
def test_one_chunk(number: int, far: bool, server: str, scene: Scene, data: bytes, tmp_path: Path) -> None:
    """One range has the chunk, the ranges before it have what serves every chunk, and no byte is fetched twice."""
    (tmp_path / "scene.c3gs").write_bytes(data)
    lines = run("one_chunk.py", server if far else str(tmp_path / "scene.c3gs"), str(number))
    fetched = [tuple(map(int, re.findall(r"\d+", line))) for line in lines if line.startswith("fetch")]
    reader = Reader(WholeFile(data))
    entry, section = reader.open().index[number], reader.header.section(DATA)
    assert section is not None
    assert fetched[-1] == (entry.length, entry.start)
    assert sum(size for size, _ in fetched[:-1]) == section.start
    chunk = take_anchors(scene, slice(number * ANCHORS, (number + 1) * ANCHORS))
    assert lines[-1] == f"digest {chunk_digest(chunk)}"


def test_a_file_that_arrives(scene: Scene, data: bytes) -> None:
    """The first anchors are there before a tenth of the chunks has arrived."""
    *chunks, last = run("arriving.py", given=data)
    assert last == f"digest {digest(scene)[0]}"
    assert len(chunks) == CHUNKS
    section = Reader(WholeFile(data)).header.section(DATA)
    assert section is not None
    first = int(re.findall(r"\d+", chunks[0])[0])
    assert first < section.start + section.length / 10
    assert f"{ANCHORS} anchors" in chunks[0]


def test_a_damaged_file_that_arrives(data: bytes) -> None:
    """What comes before the damage was delivered."""
    changed = bytearray(data)
    changed[-9] ^= 1
    done = subprocess.run(
        [sys.executable, str(EXAMPLES / "arriving.py")], input=bytes(changed), capture_output=True, check=False
    )
    assert done.returncode == 1
    assert b"R6.11-1" in done.stderr
    assert len(done.stdout.splitlines()) == CHUNKS - 1
