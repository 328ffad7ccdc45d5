"""--max-anchors, --max-work and --max-memory: larger files are refused by the header. The memory is measured."""

from __future__ import annotations

import os
import sys
import threading
import tracemalloc
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from random_scenes import random_scene

import refcodec
from benchmarks.resident import measured
from conformance.cases.checksums import lengthened
from conformance.cases.scenes import MAIN_DIMENSIONS
from refcodec.bitstream import codec
from refcodec.bitstream.attributes import Attributes
from refcodec.bitstream.bounds import BoundPassedError, Bounds, memory_needed
from refcodec.bitstream.errors import BitstreamError
from refcodec.bitstream.reader import Reader, decode_chunk
from refcodec.bitstream.source import Arriving, StoredFile, WholeFile
from refcodec.cli.bounds import PROGRAM, needed_memory
from refcodec.cli.main import main
from refcodec.files.remote import RemoteFile

VECTORS = Path(__file__).resolve().parents[2] / "vectors"
EXAMPLE = VECTORS / "tiny-example.c3gs"
COMMANDS = [
    ["validate"],
    ["digest"],
    ["decode", "-o", "OUT"],
    ["reconstruct", "OUT"],
    ["inspect"],
    ["inspect", "--trace"],
    ["render", "-o", "OUT"],
    ["export", "--scaffold", "-o", "OUT"],
    ["eval", str(VECTORS.parent / "examples" / "photographs" / "caliterra"), "--size", "48"],
]
LINUX = pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="memory is read from /proc")


def words(command: list[str], file: Path, output: Path) -> list[str]:
    first, *rest = (str(output) if word == "OUT" else word for word in command)
    return [first, str(file), *rest]


@pytest.mark.parametrize("command", COMMANDS, ids=lambda command: " ".join(command[:2]).split("/")[0])
def test_more_is_refused_before_any_work(
    command: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    if command[0] in ("render", "eval"):
        pytest.importorskip("numba")
    # What decodes calls it first of all.
    monkeypatch.setattr(Reader, "open", pytest.fail)
    for bound in (["--max-anchors", "4"], ["--max-work", "46349"], ["--max-memory", "64K"], ["--max-memory", "64M"]):
        assert main([*words(command, EXAMPLE, tmp_path / "out"), *bound]) == 64
        said = capsys.readouterr()
        assert said.out == ""
        assert len(said.err.splitlines()) == 1
        assert bound[0] in said.err
        assert "not a verdict" in said.err
    assert not (tmp_path / "out").exists()


def test_torch_is_not_loaded_beyond_the_bound(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """It takes more than the caller allows, before the file is looked at."""
    monkeypatch.setitem(sys.modules, "torch", None)
    arguments = ["export", str(EXAMPLE), "--scaffold", "-o", str(tmp_path / "out"), "--max-memory"]
    assert main([*arguments, "200M"]) == 64
    assert "--max-memory" in capsys.readouterr().err
    assert main([*arguments, "400M"]) == 64
    assert "needs torch" in capsys.readouterr().err


@pytest.fixture
def no_large_read(monkeypatch: pytest.MonkeyPatch) -> None:
    """No bytes are read that the bound does not allow."""
    for kind in (StoredFile, RemoteFile):
        read = kind.read

        def checked(self: Any, start: int, size: int, read: Any = read) -> bytes:
            assert size < BOUND
            return bytes(read(self, start, size))

        monkeypatch.setattr(kind, "read", checked)


BOUND, CLAIM = 400 << 20, 1500 << 20


@pytest.mark.usefixtures("no_large_read")
@pytest.mark.parametrize("way", ["name", "pipe", "URL"])
@pytest.mark.parametrize("kind", ["PLNS", "mETa", "DATA"])
@pytest.mark.parametrize("command", COMMANDS, ids=lambda command: " ".join(command[:2]).split("/")[0])
def test_long_parts_are_refused_before_they_are_read(
    command: list[str], kind: str, way: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Sections, and chunks, which only the index tells."""
    if command[0] in ("render", "eval", "export"):
        pytest.importorskip("numba")
        pytest.importorskip("torch")
    head, size = lengthened(EXAMPLE.read_bytes(), kind.encode(), CLAIM)
    file, name = tmp_path / "a.c3gs", str(tmp_path / "a.c3gs")
    writer = None
    if way == "pipe":
        os.mkfifo(file)
        writer = threading.Thread(target=file.write_bytes, args=(head,))
        writer.start()
    else:
        file.write_bytes(head)
        os.truncate(file, size)
        if way == "URL":
            pytest.importorskip("fsspec")
            name = f"file://{name}"
    arguments = words(command, Path("FILE"), tmp_path / "out")
    status = main([*(name if word == "FILE" else word for word in arguments), "--max-memory", str(BOUND)])
    if writer:
        writer.join()
    said = capsys.readouterr()
    # Without --decode, inspect reads no chunk of a file that it reads by parts.
    if command == ["inspect"] and kind == "DATA" and way != "pipe":
        assert status == 0
        return
    assert status == 64
    assert len(said.err.splitlines()) == 1
    assert f"--max-memory allows {BOUND}" in said.err
    assert "not a verdict" in said.err


@pytest.mark.usefixtures("no_large_read")
@pytest.mark.parametrize("way", ["name", "pipe", "URL"])
@pytest.mark.parametrize("kind", ["PLNS", "DATA"])
def test_long_parts_are_refused_in_python(kind: str, way: str, tmp_path: Path) -> None:
    head, size = lengthened(EXAMPLE.read_bytes(), kind.encode(), CLAIM)
    file = tmp_path / "a.c3gs"
    place = str(file)
    if way == "pipe":
        os.mkfifo(file)
        writer = threading.Thread(target=file.write_bytes, args=(head,))
        writer.start()
        with pytest.raises(BoundPassedError, match="memory"):
            refcodec.open(place, max_memory=BOUND)
        writer.join()
        return
    file.write_bytes(head)
    os.truncate(file, size)
    if way == "URL":
        pytest.importorskip("fsspec")
        place = f"file://{place}"
    with refcodec.open(place, max_memory=BOUND) as opened:
        for use in (lambda: list(opened), lambda: list(opened.chunks(range(2))), opened.decode):
            with pytest.raises(BoundPassedError, match="memory"):
                use()
        assert sum(opened.sizes.values()) == size
    with pytest.raises(BoundPassedError, match="memory"):
        refcodec.decode(place, max_memory=BOUND)
    with pytest.raises(BoundPassedError, match="memory"):
        decode_chunk(StoredFile(file.open("rb")), 1, bounds=Bounds(memory=BOUND))


def test_tables_of_a_file_are_within_the_bounds() -> None:
    """What shows a file reads its metadata and its index."""
    with refcodec.open(EXAMPLE, max_memory=100) as opened:
        for show in (lambda: opened.sizes, lambda: opened.metadata, lambda: opened.cameras, opened._repr_html_):
            with pytest.raises(BoundPassedError, match="memory"):
                show()


def test_a_url_has_a_bound_unless_the_caller_gives_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("fsspec")
    (tmp_path / "a.c3gs").write_bytes(EXAMPLE.read_bytes())
    url = f"file://{tmp_path}/a.c3gs"
    monkeypatch.setattr("refcodec.cli.bounds.MEMORY_MAX", 1 << 20)
    monkeypatch.setattr("refcodec.api.opening.MEMORY_MAX", 1 << 10)
    for command in COMMANDS[:6]:
        name, _, *options = words(command, EXAMPLE, tmp_path / "out")
        assert main([name, url, *options]) == 64
        assert "--max-memory allows 1048576 by default" in capsys.readouterr().err
    assert main(["validate", url, "--max-memory", "100M"]) == 0
    with pytest.raises(BoundPassedError):
        refcodec.decode(url)
    assert refcodec.decode(url, max_memory=100 << 20).anchor_count == 5


def test_a_pipe_from_python(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    writer = threading.Thread(target=(tmp_path / "pipe").write_bytes, args=(EXAMPLE.read_bytes(),))
    writer.start()
    assert refcodec.decode(tmp_path / "pipe").anchor_count == 5
    writer.join()


def test_what_is_within_the_bounds_is_done(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bounds = ["--max-anchors", "5", "--max-memory", "1g"]
    for command in (["validate"], ["digest"], ["decode", "-o", "OUT"], ["inspect"]):
        assert main([*words(command, EXAMPLE, tmp_path / "scene"), *bounds]) == 0
    assert main(["validate", str(EXAMPLE), "--max-work", "46350"]) == 0
    assert main(["encode", str(tmp_path / "scene"), "-o", str(tmp_path / "a.c3gs"), *bounds]) == 0
    for bound in (["--max-anchors", "4"], ["--max-memory", "1M"]):
        assert main(["encode", str(tmp_path / "scene"), "-o", str(tmp_path / "b.c3gs"), *bound]) == 64
        assert "not a verdict" in capsys.readouterr().err
    assert not (tmp_path / "b.c3gs").exists()


def test_verdicts_stay_within_the_bounds(tmp_path: Path) -> None:
    """A header that is not allowed is a verdict, whatever the bounds are."""
    (tmp_path / "a.c3gs").write_bytes(EXAMPLE.read_bytes()[:100])
    assert main(["validate", str(tmp_path / "a.c3gs"), "--max-anchors", "1"]) == 1


@pytest.mark.parametrize("value", ["", "0", "-1", "1.5", "1T", "9" * 30, "M"])
def test_bounds_that_are_none(value: str) -> None:
    assert main(["validate", str(EXAMPLE), f"--max-memory={value}"]) == 64


@LINUX
@pytest.mark.slow
def test_the_estimate_is_one_to_two_times_what_is_measured(tmp_path: Path) -> None:
    scene = codec.parse((VECTORS / "valid" / "trained-snowmiku.c3gs").read_bytes()).scene
    rows, a = np.resize(np.arange(scene.anchor_count), 40_000), scene.attributes
    many = replace(
        scene,
        positions=scene.positions[rows],
        masks=scene.masks[rows],
        attributes=Attributes(a.features[rows], a.scalings[rows], a.offsets[rows], a.steps[rows]),
        position_model=None,
        chunk_anchors=None,
        position_forms=None,
    )
    file = tmp_path / "many.c3gs"
    file.write_bytes(codec.emit(many))
    header = codec.parse_container(file.read_bytes())
    for command in (["validate"], ["digest"], ["decode", "-o", "OUT"], ["inspect", "--decode"]):
        # The native kernel takes less.
        status, most = measured(words(command, file, tmp_path / "out"), {**os.environ, "REFCODEC_PATH": "numpy"})
        estimate = PROGRAM + needed_memory(header, 0)
        assert status == 0
        assert most < estimate < 2 * most, command


# --- from Python ------------------------------------------------------------------------------------------------------


def readers(data: bytes, bounds: Bounds | None) -> list[Callable[[], object]]:
    """The three ways of reading, of which each takes the bounds of its caller."""
    return [
        lambda: codec.parse(data, bounds=bounds),
        lambda: Reader(Arriving(iter([data])), bounds=bounds),
        lambda: decode_chunk(WholeFile(data), 1, bounds=bounds),
    ]


@pytest.mark.parametrize("way", range(3))
def test_the_bound_that_stopped_it_is_said(way: int, monkeypatch: pytest.MonkeyPatch) -> None:
    data = EXAMPLE.read_bytes()
    for allowed in (None, Bounds(), Bounds(5, 1 << 20)):
        readers(data, allowed)[way]()
    monkeypatch.setattr(Reader, "open", pytest.fail)
    for bounds, which, needed in ((Bounds(4, 1), "anchors", 5), (Bounds(5, 999), "memory", None)):
        with pytest.raises(BoundPassedError, match=f"{which}.*verdict") as raised:
            readers(data, bounds)[way]()
        assert raised.value.bound == which
        assert raised.value.allowed == getattr(bounds, which)
        assert raised.value.needed == (needed or raised.value.needed)
        assert raised.value.needed > raised.value.allowed


@pytest.mark.parametrize("way", range(3))
def test_errors_of_the_header_come_before_bounds(way: int) -> None:
    with pytest.raises(BitstreamError):
        readers(EXAMPLE.read_bytes()[:100], Bounds(0, 1))[way]()


@pytest.mark.parametrize("plane_size", [2, 60])
def test_memory_is_at_most_what_is_estimated(plane_size: int) -> None:
    """Of what Python and numpy allocate for a file, beside the tables: read chunk by chunk, and as a whole."""
    scene = random_scene(3, 700, replace(MAIN_DIMENSIONS, plane_size=plane_size), chunk_size=256)
    data = codec.emit(scene)
    codec.parse(data)
    header = Reader(WholeFile(data)).header

    def streamed() -> None:
        reader = Reader(Arriving(data[at : at + 1000] for at in range(0, len(data), 1000)))
        opened = reader.open()
        for _ in opened.chunks():
            pass
        opened.close()

    for run, needed in (
        (streamed, memory_needed(header, 256)),
        (lambda: codec.parse(data), memory_needed(header, 700, 700, len(data))),
    ):
        tracemalloc.start()
        run()
        most = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert most < needed < 4 * most + (1 << 20)
