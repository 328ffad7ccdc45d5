"""The programs of examples/ do what they say: on a file, on one that arrives, and on one that is fetched by ranges."""

from __future__ import annotations

import re
import subprocess
import sys
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import numpy as np
import pytest
from random_scenes import random_scene

import refcodec
from refcodec.bitstream.codec import emit
from refcodec.bitstream.directory import DATA
from refcodec.bitstream.header import Lanes
from refcodec.bitstream.reader import Reader
from refcodec.bitstream.reconstruction import chunk_digest, digest
from refcodec.bitstream.scene import Scene, take_anchors
from refcodec.bitstream.source import WholeFile

ROOT = Path(__file__).resolve().parents[1]
EXAMPLES = ROOT / "examples" / "reading"
PYTHON = ROOT / "examples" / "python"
TRAINED = ROOT / "vectors" / "valid" / "trained-caliterra.c3gs"
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


def python(program: str, *words: str | Path) -> list[str]:
    command = [sys.executable, str(PYTHON / program), *map(str, words)]
    done = subprocess.run(command, capture_output=True, text=True, check=True, cwd=ROOT)
    assert done.stderr == ""
    return done.stdout.splitlines()


def test_the_notebook_runs() -> None:
    """All its cells, on its own file, which comes back byte for byte."""
    pytest.importorskip("numba")
    lines = python("notebook.py")
    scene = refcodec.decode(TRAINED)
    assert repr(scene) in lines
    assert f"encoded again: {TRAINED.stat().st_size:,} bytes, the same file: True" in lines
    assert lines[-1].startswith("error 441, SPEC.md 6.11, byte ")


def test_the_notebook_stores_no_place() -> None:
    """It runs wherever the project is, and on other files."""
    text = (PYTHON / "notebook.py").read_text(encoding="utf-8")
    assert not re.findall(r"[\"'](?:/|~|[A-Z]:)", text)
    assert text.count("# %%") > 10


def test_a_crop_keeps_anchors_as_they_are(tmp_path: Path) -> None:
    target = tmp_path / "middle.c3gs"
    lines = python("crop.py", TRAINED, target, "0.5")
    whole, middle = refcodec.decode(TRAINED), refcodec.decode(target)
    with pytest.raises(subprocess.CalledProcessError):
        python("crop.py", target, target, "0.5")
    assert refcodec.decode(target).digest() == middle.digest()
    assert lines[1] == f"{middle.anchor_count} anchors, {target.stat().st_size} bytes"
    assert whole.anchor_count / 2 <= middle.anchor_count < whole.anchor_count * 0.6
    # Each anchor of the middle is one of the whole scene, with the same features.
    rows = {row.tobytes() for row in np.hstack([whole.positions, whole.features])}
    assert {row.tobytes() for row in np.hstack([middle.positions, middle.features])} < rows


def test_a_contact_sheet_has_all_views(tmp_path: Path) -> None:
    pytest.importorskip("numba")
    from PIL import Image  # noqa: PLC0415

    assert python("contact_sheet.py", TRAINED, tmp_path / "sheet.png")[0].startswith("8 views of ")
    with Image.open(tmp_path / "sheet.png") as sheet:
        assert sheet.size == (4 * 160, 2 * 120)
