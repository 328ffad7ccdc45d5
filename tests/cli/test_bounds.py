"""{commands} x {bounds} x {ways of reading}: larger files are refused by the header. The memory is measured."""

import os
import re
import shutil
import sys
import threading
import tracemalloc
from collections.abc import Callable
from contextlib import contextmanager
from dataclasses import replace
from inspect import isfunction, signature
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cli_inputs import DECODING, EXAMPLE, VECTORS, Call, lacking
from random_scenes import random_scene

import refcodec
from benchmarks.large import made_static
from benchmarks.resident import measured, usage
from conformance.cases.checksums import lengthened
from conformance.cases.scenes import MAIN_DIMENSIONS
from refcodec import UsageError, api
from refcodec.api.command import words
from refcodec.bitstream import codec
from refcodec.bitstream.bounds import PROGRAM, BoundPassedError, Limits, memory_needed, section_bytes
from refcodec.bitstream.errors import BitstreamError
from refcodec.bitstream.reader import Reader, decode_chunk
from refcodec.bitstream.scene import take_anchors
from refcodec.bitstream.source import Arriving, StoredFile, WholeFile
from refcodec.files.remote import RemoteFile

# Each command that takes a file.
COMMANDS = [*DECODING, "inspect FILE", "view FILE --no-browser"]
# What takes a file in Python besides commands, and what an open file has.
PYTHON = {
    "open": "refcodec.open(F, limits=L).header",
    "decode": "refcodec.decode(F, limits=L).digest()",
    "splats": "refcodec.splats(F, limits=L)",
    "File.chunks": "any(chunk is None for chunk in refcodec.open(F, limits=L).chunks())",
    **{f"File.{part}": f"refcodec.open(F, limits=L).{part}" for part in ("sizes", "metadata", "cameras", "decode()")},
}
BOUND, CLAIM = 400 << 20, 1500 << 20


def prepare(command: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Skips a command whose packages are not there. None serves a page."""
    monkeypatch.setattr("refcodec.viewer.server.serve", pytest.fail)
    if lacking(command):
        pytest.skip("needs the extra render")


def test_each_command_of_a_file_has_bounds() -> None:
    bounded = {name for names in api.COMMANDS.values() for name in names if "max_memory" in words(getattr(api, name))}
    assert bounded - {"encode"} == {command.split()[0].replace("eval", "evaluate") for command in COMMANDS}
    functions = {name: getattr(refcodec, name) for name in refcodec.__all__ if name != "encode"}
    limited = {n for n, use in functions.items() if isfunction(use) and "limits" in signature(use).parameters}
    parts = {f"File.{name}" for name in vars(refcodec.File) if not re.match("_|close|.*_count", name)}
    assert limited | parts == {name.removesuffix("()") for name in PYTHON}


@pytest.mark.parametrize("command", COMMANDS)
def test_more_is_refused_before_any_work(
    command: str, place: Path, monkeypatch: pytest.MonkeyPatch, call: Call
) -> None:
    prepare(command, monkeypatch)
    before = sorted(place.iterdir())
    # What decodes calls it first of all.
    monkeypatch.setattr(Reader, "open", pytest.fail)
    for bound in (["--max-anchors", "4"], ["--max-work", "46349"], ["--max-memory", "64K"], ["--max-memory", "64M"]):
        status, out, err = call(*command.replace("FILE", str(EXAMPLE)).split(), *bound)
        assert (status, out, len(err.splitlines())) == (64, "", 1)
        assert bound[0] in err
        assert "not a verdict" in err
    assert sorted(place.iterdir()) == before


@contextmanager
def lying(kind: str, way: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Yields the name of a file whose header claims a long section, or chunks, which only the index tells.

    No bytes are read that the bound does not allow.
    """
    for stored in (StoredFile, RemoteFile):

        def checked(self: Any, start: int, size: int, read: Any = stored.read) -> bytes:
            assert size < BOUND
            return bytes(read(self, start, size))

        monkeypatch.setattr(stored, "read", checked)
    head, size = lengthened(EXAMPLE.read_bytes(), kind.encode(), CLAIM)
    file = folder / "a.c3gs"
    if way == "pipe":
        os.mkfifo(file)
        writer = threading.Thread(target=file.write_bytes, args=(head,))
        writer.start()
        yield str(file)
        writer.join()
        return
    file.write_bytes(head)
    os.truncate(file, size)
    if way == "URL":
        pytest.importorskip("fsspec")
    yield f"file://{file}" if way == "URL" else str(file)


@pytest.mark.parametrize("way", ["name", "pipe", "URL"])
@pytest.mark.parametrize("kind", ["PLNS", "mETa", "DATA"])
@pytest.mark.parametrize("command", COMMANDS)
def test_long_parts_are_refused_before_they_are_read(
    command: str, kind: str, way: str, place: Path, call: Call, monkeypatch: pytest.MonkeyPatch
) -> None:
    prepare(command, monkeypatch)
    with lying(kind, way, place, monkeypatch) as name:
        status, _, err = call(*command.replace("FILE", name).split(), "--max-memory", BOUND)
    # Without --decode, inspect reads no chunk of a file that it reads by parts.
    if command == "inspect FILE" and kind == "DATA" and way != "pipe":
        assert status == 0
        return
    assert (status, len(err.splitlines())) == (64, 1)
    assert f"--max-memory allows {BOUND}" in err
    assert "not a verdict" in err


@pytest.mark.parametrize("way", ["name", "pipe", "URL"])
@pytest.mark.parametrize("kind", ["PLNS", "DATA"])
def test_long_parts_are_refused_in_python(kind: str, way: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    limits, refused = Limits(memory=BOUND), pytest.raises(BoundPassedError, match="memory")
    with lying(kind, way, tmp_path, monkeypatch) as name:
        if way == "pipe":
            with refused:
                refcodec.open(name, limits=limits)
            return
        with refcodec.open(name, limits=limits) as opened:
            for use in (lambda: list(opened), lambda: list(opened.chunks(range(2))), opened.decode):
                with pytest.raises(BoundPassedError, match="memory"):
                    use()
            assert sum(opened.sizes.values()) > CLAIM
        with refused:
            refcodec.decode(name, limits=limits)
        with pytest.raises(BoundPassedError, match="memory"):
            decode_chunk(StoredFile((tmp_path / "a.c3gs").open("rb")), 1, limits=limits)


def test_tables_of_a_file_are_within_the_bounds() -> None:
    """What shows a file reads its metadata and its index."""
    with refcodec.open(EXAMPLE, limits=Limits(memory=100, program=0)) as opened:
        for show in (lambda: opened.sizes, lambda: opened.metadata, lambda: opened.cameras, opened._repr_html_):
            with pytest.raises(BoundPassedError, match="memory"):
                show()


@pytest.mark.parametrize("command", [*DECODING[:6], "inspect FILE"])
def test_a_url_has_a_bound_unless_the_caller_gives_one(
    command: str, place: Path, monkeypatch: pytest.MonkeyPatch, call: Call
) -> None:
    pytest.importorskip("fsspec")
    (place / "a.c3gs").write_bytes(EXAMPLE.read_bytes())
    url = f"file://{place}/a.c3gs"
    monkeypatch.setattr("refcodec.bitstream.bounds.URL_MEMORY", 1 << 20)
    line = command.replace("FILE", url).split()
    assert "--max-memory allows 1048576 by default" in call(*line)[2]
    assert call(*line, "--max-memory", "200M")[0] == 0
    with pytest.raises(BoundPassedError):
        refcodec.decode(url)
    assert refcodec.decode(url, limits=Limits(memory=100 << 20)).anchor_count == 5


def test_what_is_within_the_bounds_is_done(place: Path, call: Call) -> None:
    bounds = ["--max-anchors", "6", "--max-memory", "1g"]
    for command in ("validate FILE", "digest FILE", "decode FILE -o new", "inspect FILE"):
        assert call(*command.replace("FILE", "scene.c3gs").split(), *bounds)[0] == 0
    assert call("validate", EXAMPLE, "--max-work", "46350")[0] == 0
    assert call("encode", "new", "-o", "a.c3gs", *bounds)[0] == 0
    for bound in (["--max-anchors", "5"], ["--max-memory", "1M"]):
        status, _, err = call("encode", "new", "-o", "b.c3gs", *bound)
        assert (status, "not a verdict" in err, Path("b.c3gs").exists()) == (64, True, False)
    # A header that is not allowed is a verdict, whatever the bounds are.
    Path("a.c3gs").write_bytes(EXAMPLE.read_bytes()[:100])
    assert call("validate", "a.c3gs", "--max-anchors", "1")[0] == 1


@pytest.mark.parametrize("name", ["anchors", "work", "memory", "program"])
@pytest.mark.parametrize("value", [-1, 1.5, float("nan"), float("inf"), "1G", True, b"", [1]])
def test_limits_that_are_none(name: str, value: Any) -> None:
    with pytest.raises(UsageError, match=f"limits.{name} must be an integer of at least 0, not "):
        Limits(**{name: value})


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="memory is read from /proc")
@pytest.mark.slow
def test_the_estimate_is_one_to_two_times_what_is_measured(tmp_path: Path) -> None:
    scene = codec.parse((VECTORS / "valid" / "trained-snowmiku.c3gs").read_bytes()).scene
    many = take_anchors(replace(scene, position_model=None), np.resize(np.arange(scene.anchor_count), 40_000))
    file = tmp_path / "many.c3gs"
    file.write_bytes(codec.emit(many))
    header = codec.parse_container(file.read_bytes())
    for command in ("validate FILE", "digest FILE", f"decode FILE -o {tmp_path}/out", "inspect FILE --decode"):
        # The native kernel takes less.
        line = command.replace("FILE", str(file)).split()
        status, most = measured(line, {**os.environ, "REFCODEC_PATH": "numpy"})
        estimate = PROGRAM + memory_needed(header, 65536, more=section_bytes(header, True))
        assert status == 0
        assert most < estimate < 2 * most, command


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="memory is read from /proc")
@pytest.mark.slow
@pytest.mark.parametrize(("static", "anchors"), [(False, 8_000), (True, 20_000), (False, 5)])
def test_what_a_command_takes_is_within_what_it_states(static: bool, anchors: int, place: Path, call: Call) -> None:
    """The memory that --max-memory compares: mostly Gaussians of a static scene, and packages for a small file."""
    scene = codec.parse((VECTORS / "valid" / "trained-snowmiku.c3gs").read_bytes()).scene
    scene = replace(made_static(scene, 3) if static else scene, position_model=None)
    file = place / "many.c3gs"
    file.write_bytes(codec.emit(take_anchors(scene, np.resize(np.arange(scene.anchor_count), anchors))))
    splats = [f"decode FILE --splat new.{suffix}" for suffix in ("ply", "spz", "sog", "glb")] * static
    needed, alone = re.compile(r"may take (\d+) bytes"), {"OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}
    bounds = []
    for command in (each for each in [*DECODING, *splats] if not lacking(each)):
        line = command.replace("FILE", str(file)).split()
        _, _, refused = call(*line, "--max-memory", "64M")
        stated = needed.search(refused)
        assert stated, command
        bounds.append(int(stated[1]))
        inside = [str(place / word) if word.startswith("new") or (place / word).exists() else word for word in line[1:]]
        status, most = measured([line[0], *inside], alone)
        assert status == 0, command
        assert most < bounds[-1], command
        for made in place.glob("new*"):
            shutil.rmtree(made) if made.is_dir() else made.unlink()
    # A page has a picture where the bound allows drawing. The index states more than the header.
    page, least = ["inspect", str(file), "--html", str(place / "new.html"), "--max-memory"], str(64 << 20)
    while stated := needed.search(call(*page, least)[2]):
        least = stated[1]
    for bound, pictures in ((least, 0), (str(max(bounds)), 0 if lacking("render FILE") else 1)):
        status, most = measured([*page, bound], alone)
        assert (status, (place / "new.html").read_text().count('default view"')) == (0, pictures)
        assert most < int(bound), bound
    for name, use in ((name, use) for name, use in PYTHON.items() if static or name != "splats"):
        program, bounds = f"import refcodec\nF, L = {str(file)!r}, refcodec.Limits(memory=%d)\n{use}", [0]
        # The index states more than the header.
        for bound in bounds:
            try:
                exec(program % bound, {})
            except BoundPassedError as error:
                bounds.append(error.needed)
        done = usage([sys.executable, "-c", program % bound])
        assert (done.status, done.peak < bound or name == "open") == (0, True), (use, done, bound)


# --- from Python ------------------------------------------------------------------------------------------------------


def test_a_pipe_from_python(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    writer = threading.Thread(target=(tmp_path / "pipe").write_bytes, args=(EXAMPLE.read_bytes(),))
    writer.start()
    assert refcodec.decode(tmp_path / "pipe").anchor_count == 5
    writer.join()


def readers(data: bytes, limits: Limits | None) -> list[Callable[[], object]]:
    """The three ways of reading, of which each takes the bounds of its caller."""
    return [
        lambda: codec.parse(data, limits=limits),
        lambda: Reader(Arriving(iter([data])), limits=limits),
        lambda: decode_chunk(WholeFile(data), 1, limits=limits),
    ]


@pytest.mark.parametrize("way", range(3))
def test_the_bound_that_stopped_it_is_said(way: int, monkeypatch: pytest.MonkeyPatch) -> None:
    data = EXAMPLE.read_bytes()
    for allowed in (None, Limits(), Limits(5, memory=1 << 20, program=0)):
        readers(data, allowed)[way]()
    monkeypatch.setattr(Reader, "open", pytest.fail)
    for bounds, which, needed, message in (
        (Limits(4, memory=1), "anchors", 5, "it has 5 anchors, but --max-anchors allows 4"),
        (Limits(5, work=1000), "work", 46350, "units of work"),
        (Limits(5, memory=999, program=0), "memory", None, "memory"),
    ):
        with pytest.raises(BoundPassedError, match=f"{message}.*verdict") as raised:
            readers(data, bounds)[way]()
        assert raised.value.bound == which
        assert raised.value.allowed == getattr(bounds, which)
        assert raised.value.needed == (needed or raised.value.needed)
        assert raised.value.needed > raised.value.allowed


@pytest.mark.parametrize("way", range(3))
def test_errors_of_the_header_come_before_bounds(way: int) -> None:
    with pytest.raises(BitstreamError):
        readers(EXAMPLE.read_bytes()[:100], Limits(0, memory=1))[way]()


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
