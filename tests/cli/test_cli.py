"""The command line for users and scripts: exit statuses, output on stdout and stderr, and files on the disk."""

from __future__ import annotations

import argparse
import errno
import importlib
import json
import os
import re
import resource
import signal
import stat
import subprocess
import sys
import threading
import time
import zlib
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import count
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from random_scenes import random_scene, without_chunks

import refcodec
from conformance.cases.checksums import lengthened, repair
from conformance.cases.scenes import MAIN_DIMENSIONS, with_steps
from refcodec.bitstream import codec, directory
from refcodec.bitstream.codec import parse_container
from refcodec.bitstream.directory import DATA
from refcodec.bitstream.errors import BitstreamError
from refcodec.bitstream.header import PROLOGUE_BYTES, RenderInfo
from refcodec.bitstream.metadata import metadata
from refcodec.bitstream.reader import Reader
from refcodec.bitstream.reconstruction import Reconstruction, digest
from refcodec.bitstream.scene import Ancillary
from refcodec.cli import shared
from refcodec.cli.main import GROUPS, main, make_parser
from refcodec.folder.read import read_folder
from refcodec.folder.uncompressed import Uncompressed, write_uncompressed
from refcodec.folder.write import write_folder
from refcodec.native import library
from refcodec.native.library import describe

ROOT = Path(refcodec.__file__).parent
# More than any command here needs beside what Python and its libraries have taken.
MEMORY = 1 << 30


def run(*arguments: object, **options) -> subprocess.CompletedProcess[str]:
    """The command in a process of its own, where that is the point."""
    command = [sys.executable, "-m", "refcodec", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False, timeout=120, **options)


def test_groups_name_every_command() -> None:
    """A command imports the module of its group alone, so a command that GROUPS lacks could not be called."""
    modules = {path.stem for path in (ROOT / "cli").glob("*.py")} - {"__init__", "__main__", "main"}
    adding = {name for name in modules if hasattr(importlib.import_module(f"refcodec.cli.{name}"), "add")}
    assert adding == set(GROUPS)
    for group, names in GROUPS.items():
        commands = argparse.ArgumentParser().add_subparsers()
        importlib.import_module(f"refcodec.cli.{group}").add(commands)
        assert tuple(commands.choices) == names


@pytest.fixture
def call(capsys) -> Callable[..., tuple[int, str, str]]:
    """The command in this process: its exit status, stdout and stderr."""

    def command(*arguments: object) -> tuple[int, str, str]:
        status = main([str(argument) for argument in arguments])
        return status, *capsys.readouterr()

    return command


@pytest.fixture(scope="module")
def scene():
    return replace(random_scene(21, 40, chunk_size=16), ancillary=(Ancillary(b"noTE", 0, b"kept", 5),))


@pytest.fixture(scope="module")
def data(scene) -> bytes:
    return codec.emit(scene)


def test_encode_packs(tmp_path, call):
    """Positions and weights are packed in Main, and not in Tiny, unless the options or the folder say otherwise."""
    where = np.random.default_rng(1).permutation(900)[:300][:, None] // np.array([1, 30, 900]) % np.array([30, 30, 1])
    scene = random_scene(22, 300, replace(MAIN_DIMENSIONS, plane_size=4), chunk_size=256)
    scene = with_steps(replace(scene, positions=where.astype(np.float16)))
    write_folder(scene, tmp_path / "main")
    write_folder(random_scene(23, 9), tmp_path / "tiny")

    def modes(folder: str, *options: str) -> tuple[int, int]:
        target = tmp_path / "out.c3gs"
        assert call("encode", tmp_path / folder, "-o", target, *options)[:2] == (0, "")
        modes = {section.type: section.mode for section in parse_container(target.read_bytes()).sections}
        return modes[directory.WEIGHTS], modes[directory.INDEX]

    assert modes("tiny") == (0, 0)
    assert modes("tiny", "--weights", "packed", "--positions", "packed") == (1, 1)
    assert modes("main", "--weights", "raw", "--positions", "raw") == (0, 0)
    assert (tmp_path / "out.c3gs").read_bytes() == codec.emit(scene)
    assert modes("main") == (1, 1)
    data = (tmp_path / "out.c3gs").read_bytes()
    write_folder(codec.parse(data).scene, tmp_path / "again")
    assert modes("again") == (1, 1)
    assert (tmp_path / "out.c3gs").read_bytes() == data


@pytest.fixture
def file(data, tmp_path) -> Path:
    path = tmp_path / "scene.c3gs"
    path.write_bytes(data)
    return path


def sealed(data: bytes) -> bytes:
    """The CRC-32s of prologue, header and directory made right, so that what is inside them is met."""
    out = bytearray(data)
    out[16:20] = zlib.crc32(out[:16]).to_bytes(4, "little")
    end = PROLOGUE_BYTES + int.from_bytes(out[12:16], "little")
    out[end - 4 : end] = zlib.crc32(out[PROLOGUE_BYTES : end - 4]).to_bytes(4, "little")
    return bytes(out)


def verdict(err: str) -> dict:
    """The JSON line that ends stderr, after a line for people."""
    lines = err.splitlines()
    found = json.loads(lines[-1])
    assert list(found) == ["code", "name", "offset", "path", "clause", "requirement", "found", "allowed"]
    assert found["found"]
    assert found["allowed"]
    # A file of another kind has no spot to see.
    assert "It looks like" in lines[-2] or ("refcodec inspect" in lines[-2] and "--near" in lines[-2])
    assert "Traceback" not in err
    return found


def no_verdict(err: str) -> None:
    assert err.strip()
    assert '"code"' not in err
    assert "Traceback" not in err


# --- the commands -----------------------------------------------------------------------------------------------------


def test_decode_then_encode(file, data, tmp_path, call):
    folder, again = tmp_path / "scene", tmp_path / "again.c3gs"
    assert call("decode", file, "-o", folder) == (0, "", f"{folder}: 40 anchors of {file}\n")
    assert call("encode", folder, "-o", again) == (0, "", f"{again}: {len(data):,} bytes, 40 anchors\n")
    assert (tmp_path / "again.c3gs").read_bytes() == data
    assert sorted(os.listdir(tmp_path)) == ["again.c3gs", "scene", "scene.c3gs"]


def test_digest(file, scene, capsys):
    assert main(["digest", str(file)]) == 0
    whole, parts = digest(scene)
    assert capsys.readouterr().out == whole + "\n"
    assert main(["digest", str(file), "--parts"]) == 0
    lines = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert lines == [[name, value] for name, value in {**parts, "whole": whole}.items()]
    assert [name for name, _ in lines] == [
        "positions",
        "masks",
        "planes",
        "features",
        "scalings",
        "offsets",
        "weights",
        "whole",
    ]


def test_validate(file, capsys):
    assert main(["validate", str(file)]) == 0
    assert "accepted" in capsys.readouterr().out


@pytest.mark.parametrize("form", [[], ["--hex"], ["--json"], ["--trace"]])
def test_inspect(file, data, form, capsys):
    assert main(["inspect", str(file), *form]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    if form == ["--json"]:
        assert json.loads(out)["bytes"] == len(data)
    else:
        assert len(out.splitlines()) > 20


def test_reads_from_a_pipe(file, scene):
    with file.open("rb") as content:
        done = run("digest", "/dev/stdin", stdin=content)
    assert done.stdout.strip() == digest(scene)[0]
    done = subprocess.run(
        f"cat {file} | {sys.executable} -m refcodec digest /dev/stdin",
        shell=True,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.stdout.strip() == digest(scene)[0]


def test_a_slower_path_is_told(file, capsys, monkeypatch):
    """Once, if the chunks take over a second. The first line that is not the bar's has the reason."""
    monkeypatch.setattr(library, "load", lambda: None)
    monkeypatch.delenv(library.PATH_VARIABLE, raising=False)
    shared._note_slower_path.cache_clear()
    assert main(["validate", str(file)]) == 0
    assert capsys.readouterr().err == ""
    monkeypatch.setattr(shared, "time", SimpleNamespace(monotonic=count(step=2).__next__))
    for told in (1, 0):
        assert main(["validate", str(file)]) == 0
        err = capsys.readouterr().err
        assert err.count("\n") == told
        assert err.count("a slower path runs than the processor allows: the native kernel is not there; it is") == told
    shared._note_slower_path.cache_clear()
    assert main(["validate", str(file), "--progress"]) == 0
    assert "\rrefcodec: a slower path runs" in capsys.readouterr().err
    shared._note_slower_path.cache_clear()


def test_progress_only_when_wanted(file, capsys):
    assert main(["validate", str(file)]) == 0
    assert capsys.readouterr().err == ""
    assert main(["validate", str(file), "--progress"]) == 0
    err = capsys.readouterr().err
    assert err.count("chunks:   0%") == 1
    assert err.count("chunks: 100%") >= 1


# --- verdicts ---------------------------------------------------------------------------------------------------------

COMMANDS = {
    "validate": ["validate"],
    "digest": ["digest"],
    "decode": ["decode", "-o", "out"],
    "inspect": ["inspect", "--decode"],
    "hex": ["inspect", "--hex"],
    "json": ["inspect", "--json", "--decode"],
    "trace": ["inspect", "--trace"],
}


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize("fault", ["flipped", "cut", "empty", "text", "version", "profile"])
def test_every_command_rejects_alike(command, fault, data, tmp_path, monkeypatch, capsys):
    damaged = {
        "flipped": data[:-20] + bytes([data[-20] ^ 1]) + data[-19:],
        "cut": data[:-1],
        "empty": b"",
        "text": b"#!/bin/sh\necho not a scene at all\n",
        "version": sealed(data[:8] + b"\1" + data[9:]),
        "profile": sealed(data[:20] + b"\7" + data[21:]),
    }[fault]
    monkeypatch.chdir(tmp_path)
    Path("my file.c3gs").write_bytes(damaged)
    with pytest.raises(BitstreamError) as raised:
        codec.parse(damaged)
    name, *options = COMMANDS[command]
    status = main([name, "my file.c3gs", *options])
    out, err = capsys.readouterr()
    assert status == raised.value.exit_status == (2 if fault in ("version", "profile") else 1)
    assert verdict(err) == json.loads(raised.value.to_json())
    spot = "It looks like text" if fault == "text" else "refcodec inspect 'my file.c3gs' --near"
    assert spot in err
    assert not Path("out").exists()
    if command == "hex":
        assert f"^^ error {raised.value.kind.code}" in out
    if command == "json":
        assert json.loads(out)["error"]["code"] == raised.value.kind.code


def test_verdict_through_a_shell(file, data):
    file.write_bytes(data[:-1])
    done = run("validate", file)
    assert done.returncode == 1
    assert verdict(done.stderr)["name"] == "section.truncated"


def sparse(path: Path, head: bytes, size: int) -> Path:
    path.write_bytes(head)
    os.truncate(path, size)
    return path


@pytest.fixture
def little_memory() -> Iterator[None]:
    """Who reads a large file as a whole gets a MemoryError, and ends with status 71."""
    taken_pages = Path("/proc/self/statm")
    if not taken_pages.exists():
        pytest.skip("this system does not tell how much memory is taken")
    before = resource.getrlimit(resource.RLIMIT_AS)
    taken = int(taken_pages.read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (taken + MEMORY, before[1]))
    yield
    resource.setrlimit(resource.RLIMIT_AS, before)


@pytest.mark.usefixtures("little_memory")
def test_too_long_files_are_not_read(data, tmp_path, call):
    """Five GiB of nothing, and a scene followed by it: no more is read than the header states, and one byte."""
    status, _, err = call("validate", sparse(tmp_path / "zeros", b"", 5 << 30))
    assert (status, verdict(err)["name"]) == (1, "prologue.signature")
    for command in (["validate"], ["inspect", "--decode"], ["digest"]):
        status, _, err = call(*command, sparse(tmp_path / "long", data, 5 << 30))
        found = verdict(err)
        assert (status, found["name"], found["offset"]) == (1, "file.trailing", len(data))


@pytest.mark.usefixtures("little_memory")
def test_endless_file_ends(call):
    status, _, err = call("validate", "/dev/zero")
    assert (status, verdict(err)["name"]) == (1, "prologue.signature")


@pytest.mark.usefixtures("little_memory")
def test_the_bound_of_memory_bounds():
    with pytest.raises(MemoryError):
        bytes(2 * MEMORY)


@pytest.mark.usefixtures("little_memory")
@pytest.mark.parametrize("command", [["validate"], ["digest"], ["inspect", "--decode"], ["inspect", "--trace"]])
@pytest.mark.parametrize("length", [2 * MEMORY, 1 << 48])
def test_a_pipe_whose_header_lies(data, tmp_path, call, command, length):
    """It is read as far as it goes, and the verdict is that on the file by its name."""
    head, _ = lengthened(data, b"noTE", length)
    (tmp_path / "pipe").write_bytes(head)
    wanted = call(command[0], tmp_path / "pipe", *command[1:])
    assert wanted[0] == 1
    assert verdict(wanted[2])["name"] == "section.truncated"
    (tmp_path / "pipe").unlink()
    os.mkfifo(tmp_path / "pipe")
    writer = threading.Thread(target=(tmp_path / "pipe").write_bytes, args=(head,))
    writer.start()
    assert call(command[0], tmp_path / "pipe", *command[1:]) == wanted
    writer.join()


@pytest.mark.usefixtures("little_memory")
@pytest.mark.parametrize("command", [["validate"], ["digest"], ["inspect", "--decode"], ["reconstruct", "out"]])
def test_no_memory_is_no_verdict_and_no_fault(data, tmp_path, monkeypatch, call, command):
    """A section that is there, and larger than what is left."""
    monkeypatch.chdir(tmp_path)
    name, *options = command
    status, out, err = call(name, sparse(Path("large.c3gs"), *lengthened(data, b"PLNS", 2 * MEMORY)), *options)
    assert (status, out) == (71, "")
    assert re.fullmatch(r"large\.c3gs: out of memory; --max-memory BYTES .*; this is not a verdict .*\n", err)
    assert not Path("out").exists()
    with pytest.raises(MemoryError):
        refcodec.open("large.c3gs").decode()
    with pytest.raises(MemoryError):
        next(refcodec.open("large.c3gs").chunks())


@pytest.mark.parametrize(
    "error",
    [
        MemoryError("Allocation failed (probably too large)."),
        OSError(errno.ENOMEM, "Cannot allocate memory"),
        RuntimeError("[enforce fail at alloc_cpu.cpp:127] . DefaultCPUAllocator: can't allocate memory"),
        type("OutOfMemoryError", (RuntimeError,), {})("CUDA out of memory"),
    ],
    ids=["numba", "system", "torch", "cuda"],
)
def test_errors_that_mean_no_memory(file, monkeypatch, call, error):
    def fails(*_, **__):
        raise error

    monkeypatch.setattr(Reader, "open", fails)
    status, _, err = call("validate", file)
    assert status == 71
    assert f"{file}: out of memory" in err


# --- keep going -------------------------------------------------------------------------------------------------------


def flipped(data: bytes, *chunks: int) -> bytes:
    """One bit flipped in the attributes of the first or the last chunk."""
    section = parse_container(data).section(DATA)
    changed = bytearray(data)
    for chunk in chunks:
        changed[section.start + 40 if chunk == 0 else section.end - 40] ^= 1
    return bytes(changed)


@pytest.mark.requirement("D10.2-2")
def test_keep_going(file, data, scene, tmp_path, call):
    file.write_bytes(flipped(data, 0, 2))
    status, _, err = call("decode", file, "-o", tmp_path / "scene", "--keep-going")
    assert status == 1
    lines = err.splitlines()
    assert lines[0].startswith("chunk 0 with 16 anchors is dropped: ")
    assert lines[1].startswith("chunk 2 with 8 anchors is dropped: ")
    assert lines[2] == "2 of 3 chunks and 24 anchors are lost, and 16 are written"
    assert verdict(err) == verdict(call("validate", file)[2])
    spots = [line for line in call("inspect", file, "--hex")[1].splitlines() if "^^ error" in line]
    assert [line.split()[3] for line in spots] == ["441", "441"]
    assert call("encode", tmp_path / "scene", "-o", tmp_path / "out.c3gs")[:2] == (0, "")
    assert (tmp_path / "out.c3gs").read_bytes() == codec.emit(without_chunks(scene, [0, 2]))


def test_keep_going_where_only_a_symbol_is_wrong(file, data, tmp_path, capsys):
    """Every CRC-32 of bytes is right: the chunk's own checks find it, and the verdict is theirs."""
    file.write_bytes(repair(flipped(data, 2)))
    assert main(["decode", str(file), "-o", str(tmp_path / "scene"), "--keep-going"]) == 1
    kept = verdict(capsys.readouterr().err)
    assert kept["path"] == "attributes[chunk 2]"
    assert kept["name"].startswith("substream.")
    assert main(["validate", str(file)]) == 1
    assert verdict(capsys.readouterr().err) == kept


def test_keep_going_without_need(file, tmp_path, capsys):
    assert main(["decode", str(file), "-o", str(tmp_path / "scene"), "--keep-going"]) == 0
    assert capsys.readouterr().err.count("\n") == 1
    assert main(["encode", str(file), "-o", str(tmp_path / "again.c3gs")]) == 64
    assert "is a file: give a scene folder" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("data", "looks"),
    [
        (b"ply\nformat ascii 1.0\nend_header\n", "It looks like a PLY file: refcodec convert"),
        (b"\x1f\x8b" + bytes(30), "It looks like an SPZ file: refcodec convert"),
        (b"PK\3\4" + bytes(30), "It looks like a ZIP archive, such as a SOG file: refcodec convert"),
        (b"glTF" + bytes(30), "It looks like a .glb file: refcodec convert"),
        (b"# 3D point list with one line of data", "It looks like text: refcodec fit"),
        (bytes(40), "To see the spot"),
    ],
)
def test_a_file_of_another_kind(data, looks, tmp_path, capsys):
    """inspect called a PLY file C3GS version 29793.25120. The verdict and its last line stay."""
    (tmp_path / "a").write_bytes(data)
    for command in ("validate", "inspect"):
        assert main([command, str(tmp_path / "a")]) == 1
        out, err = capsys.readouterr()
        assert looks in err
        assert json.loads(err.splitlines()[-1])["code"] == 102
        assert ("not a C3GS file" in out) == (command == "inspect")
        assert len(out.splitlines()) <= 1


def test_each_argument_has_a_help_text():
    def parsers(parser):
        for action in parser._actions:
            if isinstance(action, argparse._SubParsersAction):
                yield from action.choices.items()

    found = [
        f"{name}: {action.dest}"
        for name, parser in parsers(make_parser(list(GROUPS)))
        for action in parser._actions
        if not action.help
    ]
    assert found == []


def test_keep_going_loses_an_ancillary_section(file, data, tmp_path, capsys):
    """All chunks are there, but the file is cut after them: written, and not called accepted."""
    file.write_bytes(data[:-2])
    assert main(["decode", str(file), "-o", str(tmp_path / "scene"), "--keep-going"]) == 1
    err = capsys.readouterr().err
    assert "no chunk is damaged" in err
    assert verdict(err)["name"] == "section.truncated"
    assert (tmp_path / "scene" / "scene.json").exists()


def test_keep_going_without_a_header(file, data, tmp_path, capsys):
    file.write_bytes(data[:100])
    assert main(["decode", str(file), "-o", str(tmp_path / "scene"), "--keep-going"]) == 1
    assert verdict(capsys.readouterr().err)["name"] == "header.truncated"
    assert not (tmp_path / "scene").exists()


# --- wrong usage ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "arguments",
    [
        [],
        ["nonsense"],
        ["decode"],
        ["decode", "scene.c3gs"],
        ["fit", "points3D.txt", "-o", "scene", "--steps", "0"],
        ["fit", "points3D.txt", "-o", "scene", "--steps", "many"],
        ["inspect", "scene.c3gs", "--hex", "--json"],
        ["validate", "nowhere.c3gs"],
        ["validate", "."],
        ["inspect", "nowhere.c3gs", "--trace"],
        ["decode", "scene.c3gs", "-o", "full"],
        ["decode", "scene.c3gs", "-o", "scene.c3gs"],
        ["decode", "scene.c3gs", "-o", "scene.c3gs/x"],
        ["encode", "full", "-o", "out.c3gs"],
        ["encode", "nowhere", "-o", "out.c3gs"],
        ["encode", "scene.c3gs", "-o", "out.c3gs"],
        ["encode", "full", "-o", "full"],
        ["encode", "full", "-o", "nowhere/out.c3gs"],
        ["encode", "full", "-o", "full/thesis.txt"],
        ["fit", "nowhere.txt", "-o", "full"],
    ],
)
def test_wrong_usage(arguments, file, monkeypatch, capsys):
    monkeypatch.chdir(file.parent)
    Path("full").mkdir()
    Path("full", "thesis.txt").write_text("precious")
    before = sorted(Path().rglob("*"))
    assert main(arguments) == 64
    out, err = capsys.readouterr()
    assert out == ""
    no_verdict(err)
    assert sorted(Path().rglob("*")) == before


def test_unreadable_file(file, monkeypatch, capsys):
    """A mode that forbids reading stops nobody who runs as root, so open itself is made to refuse."""

    def refuse(*_):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("builtins.open", refuse)
    assert main(["validate", str(file)]) == 64
    assert "Permission denied" in capsys.readouterr().err


def test_folder_that_cannot_be_encoded(file, tmp_path, capsys):
    folder = tmp_path / "scene"
    assert main(["decode", str(file), "-o", str(folder)]) == 0
    document = json.loads((folder / "scene.json").read_text())
    document["render"]["near_plane"] = 0
    (folder / "scene.json").write_text(json.dumps(document))
    assert main(["encode", str(folder), "-o", str(tmp_path / "out")]) == 64
    err = capsys.readouterr().err
    no_verdict(err)
    assert "near_plane" in err
    (folder / "planes.safetensors").unlink()
    assert main(["encode", str(folder), "-o", str(tmp_path / "out")]) == 64
    no_verdict(capsys.readouterr().err)
    assert not (tmp_path / "out").exists()


def test_failed_write_leaves_the_old_file(file, data, tmp_path, monkeypatch, capsys):
    assert main(["decode", str(file), "-o", str(tmp_path / "scene")]) == 0

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", full)
    assert main(["encode", str(tmp_path / "scene"), "-o", str(file)]) == 64
    assert "No space left" in capsys.readouterr().err
    assert file.read_bytes() == data
    assert sorted(os.listdir(tmp_path)) == ["scene", "scene.c3gs"]


def test_output_that_is_no_plain_file(file, data, tmp_path, capsys):
    assert main(["decode", str(file), "-o", str(tmp_path / "scene")]) == 0
    done = subprocess.run(
        f"{sys.executable} -m refcodec encode {tmp_path / 'scene'} -o /dev/stdout | cat",
        shell=True,
        capture_output=True,
        check=False,
    )
    assert (done.stdout, done.stderr.count(b"\n")) == (data, 1)
    (tmp_path / "link").symlink_to(file)
    assert main(["encode", str(tmp_path / "scene"), "-o", str(tmp_path / "link")]) == 0
    assert (tmp_path / "link").is_symlink()
    (tmp_path / "thesis.txt").write_text("precious")
    assert main(["encode", str(tmp_path / "scene"), "-o", str(tmp_path / "thesis.txt")]) == 64
    assert (tmp_path / "thesis.txt").read_text() == "precious"
    no_verdict(capsys.readouterr().err)


def test_output_has_the_usual_rights(file, tmp_path):
    before = os.umask(0o022)
    try:
        assert main(["decode", str(file), "-o", str(tmp_path / "scene")]) == 0
        assert main(["encode", str(tmp_path / "scene"), "-o", str(tmp_path / "out")]) == 0
    finally:
        os.umask(before)
    files = [tmp_path / "out", *(tmp_path / "scene").iterdir()]
    assert {stat.S_IMODE(f.stat().st_mode) for f in files} == {0o644}


# --- faults, signals, pipes -------------------------------------------------------------------------------------------


def test_fault_of_our_own(file, monkeypatch, capsys):
    def broken(*_, **__):
        raise ZeroDivisionError("a bug\nin two lines")

    monkeypatch.setattr(Reader, "open", broken)
    monkeypatch.delenv("REFCODEC_DEBUG", raising=False)
    assert main(["validate", str(file)]) == 70
    err = capsys.readouterr().err
    no_verdict(err)
    assert err.count("\n") == 1
    assert "report" in err
    monkeypatch.setenv("REFCODEC_DEBUG", "1")
    with pytest.raises(ZeroDivisionError):
        main(["validate", str(file)])


# A shell starts what runs in the background with the signal ignored.
PROGRAM = """
import signal
from refcodec.cli.main import main
signal.signal(signal.SIGINT, signal.default_int_handler)
exit(main())
"""


def test_interrupt(file, tmp_path):
    """Ctrl-C while a named pipe keeps the reader waiting."""
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    process = subprocess.Popen([sys.executable, "-c", PROGRAM, "validate", pipe], stderr=subprocess.PIPE, text=True)
    with pipe.open("wb") as writer:
        writer.write(b"\x89C3G")
        writer.flush()
        time.sleep(0.3)
        process.send_signal(signal.SIGINT)
        err = process.communicate(timeout=20)[1]
    assert process.returncode == 130
    assert err == "refcodec: interrupted\n"


@pytest.mark.parametrize("form", ["--trace", "--hex"])
def test_reader_goes_away(file, form):
    command = f"{sys.executable} -m refcodec inspect {file} {form} | head -n 1"
    done = subprocess.run(command, shell=True, capture_output=True, text=True, check=False, timeout=60)
    assert done.returncode == 0
    assert len(done.stdout.splitlines()) == 1
    assert done.stderr == ""


# --- start-up ---------------------------------------------------------------------------------------------------------


def test_help_and_version(call):
    done = run("--version")
    assert (done.returncode, done.stdout) == (0, f"refcodec {refcodec.__version__}, {describe()}\n")
    for command in ([], ["encode"], ["decode"], ["digest"], ["validate"], ["inspect"], ["fit"]):
        status, out, _ = call(*command, "--help")
        assert status == 0
        assert "examples:" in out
        assert "exit status:" in out


def imported(code: str) -> set[str]:
    """The modules that are loaded after some code."""
    program = f"import sys\n{code}\nprint(*sys.modules, file=sys.stderr)"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True, timeout=60)
    return set(done.stderr.split())


def test_help_imports_nothing_heavy():
    modules = imported("from refcodec.cli import main as cli; cli.main(['--version'])")
    assert not modules & {"numpy", "construct", "plyfile", "safetensors", "tqdm", "torch"}


def test_decoding_never_imports_torch(file, tmp_path):
    words = ["decode", str(file), "-o", str(tmp_path / "s")]
    modules = imported(f"from refcodec.cli import main as cli; cli.main({words})")
    assert "numpy" in modules
    assert not {m for m in modules if m.split(".")[0] in ("torch", "scipy") or m.startswith("refcodec.train")}
    words = ["encode", str(tmp_path / "s"), "-o", str(tmp_path / "f")]
    modules = imported(f"from refcodec.cli import main as cli; cli.main({words})")
    assert not {m for m in modules if m.split(".")[0] in ("torch", "scipy") or m.startswith("refcodec.train")}


def test_the_rooms_of_the_codec_import_nothing_heavy():
    """Bytes to scene and back, and looking into a file, need neither training nor rendering, nor what these need."""
    rooms = ("bitstream", "encoder", "folder", "inspect")
    names = [f"refcodec.{room}.{p.stem}" for room in rooms for p in (ROOT / room).glob("[!_]*.py")]
    assert len(names) > 30
    modules = imported(f"import importlib\nfor name in {names}: importlib.import_module(name)")
    assert set(names) <= modules
    heavy = {"torch", "scipy", "numba", "PIL", "skimage", "jinja2"}
    assert not {m.split(".")[0] for m in modules} & heavy
    loaded = {m.split(".")[1] for m in modules if m.startswith("refcodec.")}
    assert not loaded - {*rooms, "files", "native", "resources", "statuses"}
    assert {m for m in modules if m.startswith("refcodec.rendering.")} <= {"refcodec.rendering.camera"}


# --- fit --------------------------------------------------------------------------------------------------------------


def test_fit_without_torch(tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "torch", None)
    for name in [m for m in sys.modules if m.startswith("refcodec.train")]:
        monkeypatch.delitem(sys.modules, name)
    (tmp_path / "points3D.txt").write_text("1 0 0 0 1 2 3 0\n")
    assert main(["fit", str(tmp_path / "points3D.txt"), "-o", str(tmp_path / "scene")]) == 64
    err = capsys.readouterr().err
    no_verdict(err)
    assert "pip install 'refcodec[fit]'" in err


@pytest.fixture(scope="module")
def points(tmp_path_factory) -> Path:
    pytest.importorskip("torch")
    rng = np.random.default_rng(0)
    lines = [
        "# 3D point list",
        *(f"{i} {x:.4f} {y:.4f} {z:.4f} {i % 256} 90 200 0.5" for i, (x, y, z) in enumerate(rng.normal(size=(60, 3)))),
    ]
    path = tmp_path_factory.mktemp("points") / "points3D.txt"
    path.write_text("\n".join(lines) + "\n")
    return path


def test_fit(points, tmp_path, capsys):
    scene, out = tmp_path / "scene", tmp_path / "scene.c3gs"
    assert main(["fit", str(points), "-o", str(scene), "--steps", "3"]) == 0
    anchors = capsys.readouterr().out.split(" anchors")[0].split()[-1]
    assert 40 < int(anchors) <= 60
    assert os.listdir(tmp_path) == ["scene"]
    assert main(["encode", str(scene), "-o", str(out)]) == 0
    assert main(["validate", str(out)]) == 0
    assert f"profile Main, {anchors} anchors" in capsys.readouterr().out
    # Its point cloud is one that fit takes, too.
    assert (
        main(["fit", str(scene / "point_cloud.ply"), "-o", str(tmp_path / "second"), "--steps", "2", "--voxel", "0.01"])
        == 0
    )


def test_fit_is_interrupted_and_resumed(points, tmp_path, monkeypatch, capsys):
    fitter = pytest.importorskip("refcodec.train.fit")
    scene, real = tmp_path / "scene", fitter.fit

    def stopped(*arguments, progress, **options):
        def stop(stage, step, steps):
            progress(stage, step, steps)
            if step == 2:
                signal.raise_signal(signal.SIGINT)

        return real(*arguments, progress=stop, **options)

    monkeypatch.setattr(fitter, "fit", stopped)
    assert main(["fit", str(points), "-o", str(scene), "--steps", "4"]) == 130
    assert "--resume" in capsys.readouterr().err
    assert (scene / "scene.json").exists()
    monkeypatch.setattr(fitter, "fit", real)
    # Other settings are another fit; the state stays.
    assert main(["fit", str(points), "-o", str(scene), "--steps", "5", "--resume"]) == 64
    assert main(["fit", str(points), "-o", str(scene), "--steps", "4", "--resume"]) == 0
    assert os.listdir(tmp_path) == ["scene"]
    assert main(["fit", str(points), "-o", str(tmp_path / "at once"), "--steps", "4"]) == 0
    assert read_folder(scene).planes.tobytes() == read_folder(tmp_path / "at once").planes.tobytes()
    assert main(["fit", str(points), "-o", str(scene), "--resume"]) == 64
    assert "nothing to resume" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("a.txt", b"not points\n"),
        ("a.txt", b"# none\n"),
        ("a.npz", b"junk"),
        ("a.npz", b""),
        ("a.npz", b"PK\3\4cut"),
        ("a.ply", b"junk"),
    ],
)
@pytest.mark.filterwarnings("ignore:.*no data")
def test_fit_refuses(name, content, tmp_path, capsys):
    pytest.importorskip("torch")
    (tmp_path / name).write_bytes(content)
    assert main(["fit", str(tmp_path / name), "-o", str(tmp_path / "scene")]) == 64
    no_verdict(capsys.readouterr().err)
    assert os.listdir(tmp_path) == [name]


def test_fit_takes_other_shapes_within_main(file, tmp_path, capsys):
    """A scene of 5 features and 2 offsets; 17 offsets are more than Main has."""
    pytest.importorskip("torch")
    assert main(["decode", str(file), "-o", str(tmp_path / "scene")]) == 0
    small = ["--steps", "2", "--set", "entropy.channels=0", "--set", "entropy.slices=[1, 1]", "--meta", "title=Fit"]
    assert main(["fit", str(tmp_path / "scene"), "-o", str(tmp_path / "new"), *small]) == 0
    found = read_folder(tmp_path / "new")
    d = found.dimensions
    assert (d.features, d.offset_count, d.slices, d.plane_channels) == (5, 2, (2, 3), 0)
    assert metadata(found.ancillary) == {"title": "Fit"}
    for option in ("entropy.channels=17", "entropy.slices=[]", "entropy.slices=7", "entropy.none=1"):
        assert main(["fit", str(tmp_path / "scene"), "-o", str(tmp_path / "other"), "--set", option]) == 64
        assert option.partition("=")[0] in capsys.readouterr().err

    def some(*shape: int) -> np.ndarray:
        return np.zeros(shape, np.float32)

    networks = {
        name: [(some(6, 9), some(6)), (some(17 * each, 6), some(17 * each))]
        for name, each in (("opacity", 1), ("covariance", 7), ("colour", 3))
    }
    values = Reconstruction(some(4, 3), some(4, 5), some(4, 6), some(4, 17, 3))
    write_uncompressed(Uncompressed(values, np.ones((4, 17), bool), networks, RenderInfo()), tmp_path / "many")
    assert main(["fit", str(tmp_path / "many"), "-o", str(tmp_path / "other")]) == 64
    assert "offset_count would be 17; allowed: in Main 1 to 16" in capsys.readouterr().err
    assert not (tmp_path / "other").exists()


def test_metadata_is_written_shown_and_checked(file, tmp_path, call):
    assert call("decode", file, "-o", tmp_path / "scene")[0] == 0
    out = tmp_path / "meta.c3gs"
    entries = ["--meta", "title=K\u00fcche", "--meta", "unit=1.0", "--meta", "org.example.note=a\x1b[2Jb"]
    assert call("encode", tmp_path / "scene", "-o", out, *entries)[:2] == (0, "")
    text = call("inspect", out)[1]
    assert "title        K\u00fcche" in text
    assert "\x1b" not in text
    status, _, err = call("validate", out)
    assert (status, err) == (0, "")
    assert call("digest", out)[1] == call("digest", file)[1]
    assert call("encode", tmp_path / "scene", "-o", out, "--meta", "Title=x")[0] == 64
    status, _, err = call("encode", tmp_path / "scene", "-o", out, "--meta", "title")
    assert status == 64
    assert "neither KEY=VALUE nor a file" in err


def test_metadata_of_a_file(file, tmp_path, call):
    """Entries of TOML, of which the last word counts; an empty value removes one."""
    assert call("decode", file, "-o", tmp_path / "scene")[0] == 0
    about, out = tmp_path / "about.toml", tmp_path / "meta.c3gs"
    about.write_text('title = "Hall"\nlicence = "CC0-1.0"\n[org.example]\nnote = "two\\nlines"\n')
    words = ("encode", tmp_path / "scene", "-o", out)
    assert call(*words, "--meta", about, "--meta", "title=Kitchen")[0] == 0
    entries = {"title": "Kitchen", "licence": "CC0-1.0", "org.example.note": "two\nlines"}
    assert metadata(codec.parse(out.read_bytes()).scene.ancillary) == entries
    assert call("decode", out, "-o", tmp_path / "scene")[0] == 0
    assert call(*words, "--meta", "licence=")[0] == 0
    del entries["licence"]
    assert metadata(codec.parse(out.read_bytes()).scene.ancillary) == entries
    for text in ("title = 7", "title = [", "Title = 'x'", "date = 'today'"):
        about.write_text(text)
        status, _, err = call(*words, "--meta", about)
        assert status == 64, text
        assert len(err.splitlines()) == 1


def test_a_broken_ancillary_section_is_a_warning(scene, tmp_path, call):
    broken = (Ancillary(b"mETa", 0, b"\1\0\0\0\xff"), Ancillary(b"cAMs", 0, b""))
    out = tmp_path / "broken.c3gs"
    out.write_bytes(codec.emit(replace(scene, ancillary=broken)))
    status, _, err = call("validate", out)
    assert status == 0
    assert err.splitlines() == [
        "warning: metadata: it ends within an entry",
        "warning: cameras: it ends within camera 0",
    ]


def test_a_folder_in_place_of_a_file(tmp_path, capsys):
    """The message names the command that takes such a folder."""
    (tmp_path / "model" / "point_cloud").mkdir(parents=True)
    for command, advice in (
        ("validate", "refcodec encode"),
        ("eval", "refcodec convert"),
        ("encode", "refcodec convert"),
    ):
        arguments = {"eval": ["photographs"], "encode": ["-o", str(tmp_path / "a.c3gs")]}.get(command, [])
        assert main([command, str(tmp_path / "model"), *arguments]) == 64
        assert advice in capsys.readouterr().err


def test_the_verdict_has_the_likely_cause(tmp_path, capsys):
    """That is the first sentence of what explain prints on how files come to have the error."""
    (tmp_path / "a").write_bytes(b"")
    assert main(["validate", str(tmp_path / "a")]) == 1
    assert "or a download or copy was cut short. To see the spot" in capsys.readouterr().err
