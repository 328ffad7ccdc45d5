"""What commands do for users and scripts: exit statuses, output on stdout and stderr, and files on the disk."""

import errno
import json
import os
import re
import resource
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from itertools import count
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from cli_inputs import DECODING, Call, contents, lacking
from random_scenes import flipped, random_scene, without_chunks

import refcodec
from conformance.cases.checksums import Depth, lengthened, repair
from conformance.cases.scenes import MAIN_DIMENSIONS, TINY_DIMENSIONS, with_steps
from refcodec.bitstream import codec, directory
from refcodec.bitstream.codec import parse_container
from refcodec.bitstream.directory import DATA
from refcodec.bitstream.errors import BitstreamError
from refcodec.bitstream.metadata import metadata
from refcodec.bitstream.reader import Reader
from refcodec.bitstream.reconstruction import digest, reconstruct
from refcodec.bitstream.scene import Ancillary, Scene
from refcodec.cli.main import main
from refcodec.folder import places
from refcodec.folder.read import read_folder
from refcodec.folder.uncompressed import Uncompressed, write_uncompressed
from refcodec.folder.write import write_folder
from refcodec.native import library
from refcodec.native.library import describe

ROOT = Path(refcodec.__file__).parent
# More than any command here needs beside what Python and its libraries have taken.
MEMORY = 1 << 30


def run(words: str, **options: Any) -> subprocess.CompletedProcess[str]:
    """A shell's line, in which refcodec is the program in a process of its own, where that is the point."""
    line = words.replace("refcodec", f"{sys.executable} -m refcodec")
    return subprocess.run(line, shell=True, capture_output=True, text=True, check=False, timeout=120, **options)


@pytest.fixture(scope="module")
def scene() -> Scene:
    return replace(random_scene(21, 40, chunk_size=16), ancillary=(Ancillary(b"noTE", 0, b"kept", 5),))


@pytest.fixture(scope="module")
def data(scene: Scene) -> bytes:
    return codec.emit(scene)


@pytest.fixture
def file(data: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A file in the working folder."""
    monkeypatch.chdir(tmp_path)
    Path("scene.c3gs").write_bytes(data)
    return Path("scene.c3gs")


def verdict(err: str) -> dict[str, Any]:
    """The JSON line that ends stderr, after a line for people."""
    *_, spot, last = err.splitlines()
    error = json.loads(last)
    assert list(error) == ["code", "name", "offset", "path", "clause", "requirement", "found", "allowed"]
    assert error["found"]
    assert error["allowed"]
    # A file of another kind has no spot to see.
    assert "It looks like" in spot or ("refcodec inspect" in spot and "--near" in spot)
    assert "Traceback" not in err
    return error


# --- the commands -----------------------------------------------------------------------------------------------------


def test_encode_packs(tmp_path: Path, call: Call) -> None:
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


def test_a_file_comes_back(file: Path, data: bytes, scene: Scene, call: Call) -> None:
    """By decode and encode, and what the other commands say of it."""
    assert call("decode", file, "-o", "scene") == (0, "", "scene: 40 anchors of scene.c3gs\n")
    assert call("encode", "scene", "-o", "again") == (0, "", f"again: {len(data):,} bytes, 40 anchors\n")
    assert Path("again").read_bytes() == data
    assert sorted(os.listdir()) == ["again", "scene", "scene.c3gs"]
    whole, parts = digest(scene)
    assert list(parts) == ["positions", "masks", "planes", "features", "scalings", "offsets", "weights"]
    assert call("digest", file) == (0, whole + "\n", "")
    lines = [line.split() for line in call("digest", file, "--parts")[1].splitlines()]
    assert lines == [[name, value] for name, value in {**parts, "whole": whole}.items()]
    assert "accepted" in call("validate", file)[1]
    for form in ([], ["--hex"], ["--trace"]):
        status, out, err = call("inspect", file, *form)
        assert (status, err) == (0, "")
        assert len(out.splitlines()) > 20
    assert json.loads(call("inspect", file, "--json")[1])["bytes"] == len(data)
    for line in ("refcodec digest /dev/stdin < scene.c3gs", "cat scene.c3gs | refcodec digest /dev/stdin"):
        assert run(line).stdout == whole + "\n"


def test_a_slower_path_is_told(file: Path, call: Call, monkeypatch: pytest.MonkeyPatch) -> None:
    """Once, if the chunks take over a second. The first line that is not the bar's has the reason."""
    monkeypatch.setattr(library, "load", lambda: None)
    monkeypatch.delenv(library.PATH_VARIABLE, raising=False)
    places.note_slower_path.cache_clear()
    assert call("validate", file)[2] == ""
    monkeypatch.setattr(places, "time", SimpleNamespace(monotonic=count(step=2).__next__))
    for times in (1, 0):
        err = call("validate", file)[2]
        assert err.count("\n") == times
        assert err.count("a slower path runs than the processor allows: the native kernel is not there; it is") == times
    places.note_slower_path.cache_clear()
    assert "\rrefcodec: a slower path runs" in call("validate", file, "--progress")[2]
    places.note_slower_path.cache_clear()


def test_progress_only_when_wanted(file: Path, call: Call) -> None:
    assert call("validate", file)[2] == ""
    err = call("validate", file, "--progress")[2]
    assert err.count("chunks:   0%") == 1
    assert err.count("chunks: 100%") >= 1


# --- verdicts ---------------------------------------------------------------------------------------------------------

COMMANDS = [
    *DECODING,
    *(f"inspect FILE {form}" for form in ("--decode", "--hex", "--json --decode", "--html new.html")),
]
SMALL = [["validate"], ["digest"], ["inspect", "--decode"]]


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize("fault", ["flipped", "cut", "empty", "text", "version", "profile"])
def test_every_command_rejects_alike(command: str, fault: str, place: Path, data: bytes, call: Call) -> None:
    if lacking(command):
        pytest.skip("needs the extra render")
    damaged = {
        "flipped": flipped(data, -20),
        "cut": data[:-1],
        "empty": b"",
        "text": b"#!/bin/sh\necho not a scene at all\n",
        "version": repair(data[:8] + b"\1" + data[9:], Depth.HEADER),
        "profile": repair(data[:20] + b"\7" + data[21:], Depth.HEADER),
    }[fault]
    Path("my file.c3gs").write_bytes(damaged)
    with pytest.raises(BitstreamError) as raised:
        codec.parse(damaged)
    before = contents(place)
    status, out, err = call(*("my file.c3gs" if word == "FILE" else word for word in command.split()))
    assert status == raised.value.exit_status == (2 if fault in ("version", "profile") else 1)
    kind = raised.value.kind
    assert verdict(err) == json.loads(raised.value.to_json())
    assert f"SPEC.md {kind.clause} [{kind.requirement}]" in err
    assert ("It looks like text" if fault == "text" else "refcodec inspect 'my file.c3gs' --near") in err
    assert contents(place) == before
    if "--hex" in command:
        assert f"^^ error {kind.code}" in out
    if "--json" in command:
        assert json.loads(out)["error"]["code"] == kind.code


def test_verdict_through_a_shell(file: Path, data: bytes) -> None:
    file.write_bytes(data[:-1])
    done = run("refcodec validate scene.c3gs")
    assert (done.returncode, verdict(done.stderr)["name"]) == (1, "section.truncated")


def test_an_unreadable_file(file: Path, call: Call, monkeypatch: pytest.MonkeyPatch) -> None:
    """A mode that forbids reading stops nobody who runs as root, so open itself is made to refuse."""

    def refuse(name: str, *_: object) -> None:
        raise PermissionError(13, "Permission denied", name)

    monkeypatch.setattr("builtins.open", refuse)
    assert call("validate", file) == (64, "", f"refcodec: {file}: Permission denied\n")


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
    with pytest.raises(MemoryError):
        bytes(2 * MEMORY)
    yield
    resource.setrlimit(resource.RLIMIT_AS, before)


@pytest.mark.usefixtures("little_memory")
def test_too_long_files_are_not_read(data: bytes, tmp_path: Path, call: Call) -> None:
    """Five GiB of nothing, and a scene followed by it: no more is read than the header states, and one byte."""
    for endless in (sparse(tmp_path / "zeros", b"", 5 << 30), "/dev/zero"):
        status, _, err = call("validate", endless)
        assert (status, verdict(err)["name"]) == (1, "prologue.signature")
    for command, *options in SMALL:
        status, _, err = call(command, sparse(tmp_path / "long", data, 5 << 30), *options)
        error = verdict(err)
        assert (status, error["name"], error["offset"]) == (1, "file.trailing", len(data))


@pytest.mark.usefixtures("little_memory")
@pytest.mark.parametrize("command", [*SMALL, ["inspect", "--trace"]])
@pytest.mark.parametrize("length", [2 * MEMORY, 1 << 48])
def test_a_pipe_whose_header_lies(data: bytes, tmp_path: Path, call: Call, command: list[str], length: int) -> None:
    """It is read as far as it goes, and the verdict is that on the file by its name."""
    pipe, (head, _) = tmp_path / "pipe", lengthened(data, b"noTE", length)
    pipe.write_bytes(head)
    wanted = call(command[0], pipe, *command[1:])
    assert (wanted[0], verdict(wanted[2])["name"]) == (1, "section.truncated")
    pipe.unlink()
    os.mkfifo(pipe)
    writer = threading.Thread(target=pipe.write_bytes, args=(head,))
    writer.start()
    assert call(command[0], pipe, *command[1:]) == wanted
    writer.join()


@pytest.mark.usefixtures("little_memory")
@pytest.mark.parametrize("command", [*SMALL, ["reconstruct", "out"]])
def test_no_memory_is_no_verdict_and_no_fault(
    data: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, call: Call, command: list[str]
) -> None:
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
        ZeroDivisionError("a bug\nin two lines"),
    ],
    ids=["numba", "system", "torch", "cuda", "fault"],
)
def test_errors_that_are_no_verdicts(
    file: Path, monkeypatch: pytest.MonkeyPatch, call: Call, error: BaseException
) -> None:
    """No memory, which libraries say in four ways, and a fault of the program's own, in one line."""
    monkeypatch.setattr(Reader, "open", lambda *_, **__: (_ for _ in ()).throw(error))
    monkeypatch.delenv("REFCODEC_DEBUG", raising=False)
    own = isinstance(error, ZeroDivisionError)
    status, out, err = call("validate", file)
    assert (status, out, err.count("\n")) == (70 if own else 71, "", 1)
    assert ("report" if own else f"{file}: out of memory") in err
    assert '"code"' not in err
    monkeypatch.setenv("REFCODEC_DEBUG", "1")
    if own:
        with pytest.raises(ZeroDivisionError):
            call("validate", file)


# --- keep going -------------------------------------------------------------------------------------------------------


def flipped_chunks(data: bytes, *chunks: int) -> bytes:
    """One bit flipped in the attributes of the first or the last chunk."""
    section = parse_container(data).section(DATA)
    return flipped(data, *(section.start + 40 if chunk == 0 else section.end - 40 for chunk in chunks))


KEEP = ("decode", "scene.c3gs", "-o", "scene", "--keep-going")


@pytest.mark.requirement("D10.2-2")
def test_keep_going(file: Path, data: bytes, scene: Scene, call: Call) -> None:
    assert call(*KEEP) == (0, "", "scene: 40 anchors of scene.c3gs\n")
    file.write_bytes(flipped_chunks(data, 0, 2))
    status, _, err = call(*KEEP)
    assert status == 1
    lines = err.splitlines()
    assert lines[0].startswith("chunk 0 with 16 anchors is dropped: ")
    assert lines[1].startswith("chunk 2 with 8 anchors is dropped: ")
    assert lines[2] == "2 of 3 chunks and 24 anchors are lost, and 16 are written"
    assert verdict(err) == verdict(call("validate", file)[2])
    spots = [line for line in call("inspect", file, "--hex")[1].splitlines() if "^^ error" in line]
    assert [line.split()[3] for line in spots] == ["441", "441"]
    assert call("encode", "scene", "-o", "out.c3gs")[:2] == (0, "")
    assert Path("out.c3gs").read_bytes() == codec.emit(without_chunks(scene, [0, 2]))


def test_keep_going_with_other_damages(file: Path, data: bytes, call: Call) -> None:
    # Every CRC-32 of bytes is right: the chunk's own checks find the wrong symbol, and the verdict is theirs.
    file.write_bytes(repair(flipped_chunks(data, 2)))
    error = verdict(call(*KEEP)[2])
    assert error["path"] == "attributes[chunk 2]"
    assert error["name"].startswith("substream.")
    assert verdict(call("validate", file)[2]) == error
    # All chunks are there, but the file is cut after them: written, and not called accepted.
    Path("scene").rename("first")
    file.write_bytes(data[:-2])
    status, _, err = call(*KEEP)
    assert (status, "no chunk is damaged" in err, verdict(err)["name"]) == (1, True, "section.truncated")
    assert Path("scene/scene.json").exists()
    # Without a header there is nothing to keep.
    Path("scene").rename("second")
    file.write_bytes(data[:100])
    status, _, err = call(*KEEP)
    assert (status, verdict(err)["name"], Path("scene").exists()) == (1, "header.truncated", False)


# --- signals and pipes ------------------------------------------------------------------------------------------------


def test_an_interrupt_in_a_compiled_function(file: Path, monkeypatch: pytest.MonkeyPatch, call: Call) -> None:
    """It returns, and Python calls that an error of the system."""
    error = SystemError("CPUDispatcher returned a result with an exception set")
    error.__cause__ = KeyboardInterrupt()
    monkeypatch.setattr(Reader, "open", lambda *_, **__: (_ for _ in ()).throw(error))
    assert call("validate", file) == (130, "", "refcodec: interrupted\n")


def test_interrupt(tmp_path: Path) -> None:
    """Ctrl-C while a named pipe keeps the reader waiting."""
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    process = subprocess.Popen([sys.executable, "-m", "refcodec", "validate", pipe], stderr=subprocess.PIPE, text=True)
    with pipe.open("wb") as writer:
        writer.write(b"\x89C3G")
        writer.flush()
        time.sleep(0.3)
        process.send_signal(signal.SIGINT)
        err = process.communicate(timeout=20)[1]
    assert (process.returncode, err) == (130, "refcodec: interrupted\n")


@pytest.mark.usefixtures("file")
@pytest.mark.parametrize("form", ["--trace", "--hex"])
def test_reader_goes_away(form: str) -> None:
    done = run(f"refcodec inspect scene.c3gs {form} | head -n 1")
    assert (done.returncode, len(done.stdout.splitlines()), done.stderr) == (0, 1, "")


# --- start-up ---------------------------------------------------------------------------------------------------------


def test_help_and_version(call: Call) -> None:
    done = run("refcodec --version")
    assert (done.returncode, done.stdout) == (0, f"refcodec {refcodec.__version__}, {describe()}\n")
    for command in ([], ["encode"], ["fit"]):
        status, out, _ = call(*command, "--help")
        assert status == 0
        assert "examples:" in out
        assert "exit status:" in out


def imported(code: str) -> set[str]:
    """The modules that are loaded after some code."""
    program = f"import sys\n{code}\nprint(*sys.modules, file=sys.stderr)"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True, timeout=60)
    return set(done.stderr.splitlines()[-1].split())


def of_command(*words: object) -> set[str]:
    """The modules that are loaded after a command."""
    return imported(f"from refcodec.cli import main as cli; cli.main({[str(word) for word in words]})")


@pytest.mark.parametrize("words", [(), ("--version",), ("--help",), ("train", "--help"), ("export", "--help")])
def test_help_imports_nothing_heavy(words: tuple[str, ...]) -> None:
    heavy = {"numpy", "construct", "plyfile", "safetensors", "tqdm", "torch", "numba"}
    assert not of_command(*words) & heavy


def test_coding_never_imports_torch(file: Path) -> None:
    for words in (("digest", file), ("decode", file, "-o", "scene"), ("encode", "scene", "-o", "again")):
        modules = of_command(*words)
        assert "numpy" in modules
        assert not {m for m in modules if m.split(".")[0] in ("torch", "scipy") or m.startswith("refcodec.train")}


def test_the_rooms_of_the_codec_import_nothing_heavy() -> None:
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


@pytest.fixture
def points(place: Path) -> str:
    pytest.importorskip("torch")
    drawn = np.random.default_rng(0).normal(size=(60, 3))
    lines = [f"{i} {x:.4f} {y:.4f} {z:.4f} {i % 256} 90 200 0.5" for i, (x, y, z) in enumerate(drawn)]
    (place / "points3D.txt").write_text("\n".join(["# 3D point list", *lines]) + "\n")
    return "points3D.txt"


def test_fit(points: str, call: Call) -> None:
    status, out, _ = call("fit", points, "-o", "new", "--steps", "3")
    anchors = out.split(" anchors")[0].split()[-1]
    assert (status, 40 < int(anchors) <= 60) == (0, True)
    assert call("encode", "new", "-o", "new.c3gs")[0] == 0
    status, out, _ = call("validate", "new.c3gs")
    assert (status, f"profile Main, {anchors} anchors" in out) == (0, True)
    # Its point cloud is one that fit takes, too.
    assert call("fit", "new/point_cloud.ply", "-o", "second", "--steps", "2", "--voxel", "0.01")[0] == 0


def test_fit_is_interrupted_and_resumed(
    points: str, place: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    fitter = pytest.importorskip("refcodec.train.fit")
    before, real = sorted(os.listdir(place)), fitter.fit

    def stopped(*arguments: Any, progress: Any, **options: Any) -> Any:
        def stop(stage: str, step: int, steps: int) -> None:
            progress(stage, step, steps)
            if step == 2:
                signal.raise_signal(signal.SIGINT)

        return real(*arguments, progress=stop, **options)

    monkeypatch.setattr(fitter, "fit", stopped)
    fit = ["fit", points, "-o", "new", "--steps"]
    assert main([*fit, "4"]) == 130
    assert "--resume" in capsys.readouterr().err
    assert Path("new/scene.json").exists()
    monkeypatch.setattr(fitter, "fit", real)
    # Other settings are another fit; the state stays.
    assert main([*fit, "5", "--resume"]) == 64
    assert main([*fit, "4", "--resume"]) == 0
    assert sorted(os.listdir(place)) == sorted([*before, "new"])
    assert main(["fit", points, "-o", "at once", "--steps", "4"]) == 0
    assert read_folder(Path("new")).planes.tobytes() == read_folder(Path("at once")).planes.tobytes()
    assert main([*fit, "4", "--resume"]) == 64
    assert "nothing to resume" in capsys.readouterr().err


def test_fit_takes_other_shapes_within_main(file: Path, call: Call) -> None:
    """A scene of 5 features and 2 offsets; 17 offsets are more than Main has."""
    pytest.importorskip("torch")
    assert call("decode", file, "-o", "scene")[0] == 0
    small = ["--steps", "2", "--set", "entropy.channels=0", "--set", "entropy.slices=[1, 1]", "--meta", "title=Fit"]
    assert call("fit", "scene", "-o", "new", *small)[0] == 0
    made = read_folder(Path("new"))
    d = made.dimensions
    assert (d.features, d.offset_count, d.slices, d.plane_channels) == (5, 2, (2, 3), 0)
    assert metadata(made.ancillary) == {"title": "Fit"}
    for option in ("entropy.channels=17", "entropy.slices=[]", "entropy.slices=7", "entropy.none=1"):
        status, _, err = call("fit", "scene", "-o", "other", "--set", option)
        assert (status, option.partition("=")[0] in err) == (64, True)

    many = random_scene(1, 4, replace(TINY_DIMENSIONS, offset_count=17))
    write_uncompressed(Uncompressed(reconstruct(many), many.masks, many.networks, many.render), Path("many"))
    status, _, err = call("fit", "many", "-o", "other")
    assert (status, "offset_count would be 17; allowed: in Main 1 to 16" in err) == (64, True)
    assert not Path("other").exists()


# --- metadata ---------------------------------------------------------------------------------------------------------


def test_metadata(file: Path, call: Call) -> None:
    """It is written, shown without control characters, and in no digest."""
    assert call("decode", file, "-o", "scene")[0] == 0
    entries = ["--meta", "title=K\u00fcche", "--meta", "unit=1.0", "--meta", "org.example.note=a\x1b[2Jb"]
    encode = ("encode", "scene", "-o", "meta.c3gs")
    assert call(*encode, *entries)[:2] == (0, "")
    text = call("inspect", "meta.c3gs")[1]
    assert "title        K\u00fcche" in text
    assert "\x1b" not in text
    status, _, err = call("validate", "meta.c3gs")
    assert (status, err) == (0, "")
    assert call("digest", "meta.c3gs")[1] == call("digest", file)[1]
    # Entries of TOML, of which the last word counts; an empty value removes one.
    about = Path("about.toml")
    about.write_text('title = "Hall"\nlicence = "CC0-1.0"\n[org.example]\nnote = "two\\nlines"\n')
    assert call(*encode, "--meta", about, "--meta", "title=Kitchen")[0] == 0
    expected = {"title": "Kitchen", "licence": "CC0-1.0", "org.example.note": "two\nlines"}
    assert refcodec.open("meta.c3gs").metadata == expected
    assert call("decode", "meta.c3gs", "-o", "scene")[0] == 0
    assert call(*encode, "--meta", "licence=")[0] == 0
    del expected["licence"]
    assert refcodec.open("meta.c3gs").metadata == expected
    for wrong in ("title = 7", "title = [", "Title = 'x'", "date = 'today'"):
        about.write_text(wrong)
        status, _, err = call(*encode, "--meta", about)
        assert (status, len(err.splitlines())) == (64, 1), wrong


def test_a_broken_ancillary_section_is_a_warning(scene: Scene, file: Path, call: Call) -> None:
    broken = (Ancillary(b"mETa", 0, b"\1\0\0\0\xff"), Ancillary(b"cAMs", 0, b""))
    file.write_bytes(codec.emit(replace(scene, ancillary=broken)))
    status, _, err = call("validate", file)
    warnings = ["warning: metadata: it ends within an entry", "warning: cameras: it ends within camera 0"]
    assert (status, err.splitlines()) == (0, warnings)
