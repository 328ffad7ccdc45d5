"""The rules for outputs (files.outputs), complete or missing files (files.stage), locks and signals."""

import errno
import fcntl
import os
import re
import resource
import signal
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor, wait
from pathlib import Path

import pytest
from tqdm import tqdm

from refcodec.files.interrupts import SIGNALS, on_interrupt
from refcodec.files.lock import BESIDE, hold_file, hold_folder
from refcodec.files.outputs import Kind, check_apart, check_file
from refcodec.files.present import NotAFileError, is_there
from refcodec.files.stage import INCOMING, Stage, exchange, write_file
from refcodec.files.terminal import bar_options
from refcodec.statuses import UsageError

ROOT = Path(__file__).resolve().parents[2]
POEM = Kind("a poem", re.compile(rb"roses"))


# --- the rules --------------------------------------------------------------------------------------------------------


def test_an_existing_file_of_another_kind_stays(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, link, odd = tmp_path / "a", tmp_path / "link", tmp_path / "a\n\x1b[31mb"
    link.symlink_to(path)
    for content in (None, b"", b"roses are red"):
        if content is not None:
            path.write_bytes(content)
        check_file(path, POEM)
        check_file(link, POEM)
    path.write_bytes(b"violets")
    odd.write_bytes(b"violets")
    for wrong, made, words in (
        *((file, False, "exists and is not a poem") for file in (path, link, odd)),
        (tmp_path, False, "is a directory"),
        (tmp_path / "b" / "c", False, "there is no directory"),
        (path / "c", True, "is not a directory"),
    ):
        with pytest.raises(UsageError, match=words) as raised:
            check_file(wrong, POEM, made)
        assert str(raised.value).isprintable()
    check_file(tmp_path / "b" / "c", POEM, made=True)
    monkeypatch.setattr(os, "access", lambda *_: False)
    with pytest.raises(UsageError, match="is read-only; choose another folder"):
        check_file(tmp_path / "new", POEM)
    check_file(Path("/dev/null"), POEM)


def test_outputs_are_apart(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """From inputs, and from each other, whatever their names are."""
    monkeypatch.chdir(tmp_path)
    source, folder = tmp_path / "in", tmp_path / "folder"
    source.write_bytes(b"x")
    (folder / "renders").mkdir(parents=True)
    (folder / "photo").write_bytes(b"y")
    for link, target in {"symbolic": "in", "elsewhere": "folder", "photo": "folder/photo", "other": "new"}.items():
        (tmp_path / link).symlink_to(target)
    for link, target in {"hard": "in", "print": "folder/photo"}.items():
        os.link(target, link)
    for name in ("in", "./in", "folder/../in", "symbolic", "hard", str(source)):
        for output, read in ((Path(name), source), (source, name)):
            with pytest.raises(UsageError, match="is read"):
                check_apart([output], [read])
    for name in ("folder/photo", "folder/new", "elsewhere/photo", "elsewhere/new", "photo", "print"):
        with pytest.raises(UsageError, match="read: choose another output"):
            check_apart([Path(name)], [None, folder])
    for pair in (("in", "./in"), ("in", "hard"), ("new", "other"), ("new", "New"), ("caf\u00e9", "cafe\u0301")):
        with pytest.raises(UsageError, match="are one file"):
            check_apart(map(Path, pair), [])
    apart = ("in", "new", "folder/renders/new", "/dev/null", "/dev/null")
    check_apart(map(Path, apart), ["nowhere", folder])


def test_a_file_is_there_or_not(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"")
    (tmp_path / "folder").mkdir()
    os.mkfifo(tmp_path / "pipe")
    for link, target in {"link": "file", "dangling": "none", "circle": "circle"}.items():
        (tmp_path / link).symlink_to(target)
    assert [is_there(tmp_path / name) for name in ("file", "link", "none", "file/none")] == [True, True, False, False]
    words = {"dangling": "nowhere", "circle": "circle", "folder": "a directory", "pipe": "a pipe"}
    for name, word in words.items():
        with pytest.raises(NotAFileError, match=word):
            is_there(tmp_path / name)


def test_a_log_has_lines_instead_of_a_bar(capsys: pytest.CaptureFixture[str]) -> None:
    """One a minute. Every bar of the suite and of the benchmarks is made so."""
    for at_once in ({}, {"delay": 0, "mininterval": 0}):
        list(tqdm(range(3), "bugs", unit="files", **{**bar_options(), **at_once}))
        assert re.fullmatch(r"(bugs \d of 3 files after 00:00\n)+" if at_once else "", capsys.readouterr().err)
    for file in (path for name in ("conformance", "benchmarks") for path in (ROOT / name).rglob("*.py")):
        assert all("bar_options()" in line for line in file.read_text().splitlines() if " tqdm(" in line), file


# --- whole or missing -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("end", ["whole", "fails", "cancelled"])
def test_outputs_come_together(end: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """More than files may be open. A link stays, a pipe is written to, and a folder that cannot be flushed is fine."""
    first, second, pipe, real = tmp_path / "first", tmp_path / "deep" / "er" / "second", tmp_path / "pipe", os.fsync
    (tmp_path / "link").symlink_to("first")
    first.write_bytes(b"old")
    os.mkfifo(pipe)
    reader = subprocess.Popen(["cat", pipe], stdout=subprocess.PIPE)
    before = sorted(os.listdir(tmp_path))

    def no_folders(descriptor: int) -> None:
        if os.path.isdir(f"/proc/self/fd/{descriptor}"):
            raise OSError(errno.EINVAL, "Invalid argument")
        real(descriptor)

    monkeypatch.setattr(os, "fsync", no_folders)
    limits = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (len(os.listdir("/proc/self/fd")) + 20, limits[1]))
    try:
        with Stage() as outputs:
            outputs.write(tmp_path / "link", b"new")
            outputs.open(second).write(b"new")
            outputs.write(pipe, b"new")
            for number in range(40):
                outputs.write(tmp_path / "many" / str(number), b"new")
            assert first.read_bytes() == b"old"
            if end == "fails":
                raise ZeroDivisionError
            if end == "cancelled":
                outputs.cancel()
    except ZeroDivisionError:
        assert end == "fails"
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, limits)
    if end == "whole":
        assert reader.communicate(timeout=20)[0] == first.read_bytes() == second.read_bytes() == b"new"
        assert len(os.listdir(tmp_path / "many")) == 40
        assert sorted(os.listdir(tmp_path)) == sorted([*before, "deep", "many"])
    else:
        assert sorted(os.listdir(tmp_path)) == before
        assert first.read_bytes() == b"old"
        pipe.write_bytes(b"")
        assert reader.communicate(timeout=20)[0] == b""
    assert (tmp_path / "link").is_symlink()


def test_an_exchange_goes_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Folders move as files do, other entries stay, and what a killed run left is no hindrance."""
    folder, real = tmp_path / "folder", os.rename
    for name in ("part/a", "whole", "letter", f"{INCOMING}/new/x", f"{BESIDE}lock"):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(b"old")

    def write(new: Path) -> None:
        (new / "part").mkdir()
        (new / "whole").write_bytes(b"new")

    def replaced() -> list[Path]:
        return [folder / "part", folder / "whole", folder / "none"]

    def tried(failing: int) -> list[tuple[str, str]]:
        calls: list[tuple[str, str]] = []

        def rename(source: Path, target: Path) -> None:
            calls.append((source.name, target.parent.name))
            if len(calls) == failing + 1:
                raise OSError(errno.EACCES, "Permission denied")
            real(source, target)

        monkeypatch.setattr(os, "rename", rename)
        try:
            exchange(folder, write, replaced, "whole")
        finally:
            assert sorted(os.listdir(folder)) == ["letter", "part", "whole"]
            assert (folder / "letter").read_bytes() == b"old"
        return calls

    for failing in range(4):
        with pytest.raises(OSError, match="denied"):
            tried(failing)
        assert (folder / "whole").read_bytes() == (folder / "part" / "a").read_bytes() == b"old"
    # The name without which the folder is not whole goes first, and comes last.
    assert tried(-1) == [("whole", "old"), ("part", "old"), ("part", "folder"), ("whole", "folder")]
    assert (folder / "whole").read_bytes() == b"new"
    assert os.listdir(folder / "part") == []


# --- locks ------------------------------------------------------------------------------------------------------------

HOLDER = """
import sys
from pathlib import Path
from refcodec.files.lock import hold_file, hold_folder
from refcodec.files.stage import Stage
place = Path(sys.argv[1])
with hold_file(place / "deep" / "lock"), hold_folder(place / "folder"), Stage() as stage:
    stage.write(place / "file", b"theirs")
    print("held", flush=True)
    sys.stdin.readline()
"""


@pytest.mark.parametrize("killed", [False, True])
def test_another_run(killed: bool, tmp_path: Path) -> None:
    """Its locks hold, and its temporary files stay as long as it lives. A killed one leaves nothing after the next."""
    others = {f"{BESIDE}notes", f"{BESIDE}0123456789abcdef.txt"}
    for name in others:
        (tmp_path / name).mkdir()
    (tmp_path / "file").write_bytes(b"old")
    streams = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    with subprocess.Popen([sys.executable, "-c", HOLDER, tmp_path], **streams) as run:  # type: ignore[call-overload]
        assert run.stdout.readline() == b"held\n"
        write_file(tmp_path / "ours", b"ours")
        assert (tmp_path / "file").read_bytes() == b"old"
        for hold, place in ((hold_file, "deep/lock"), (hold_folder, "folder")):
            with pytest.raises(UsageError, match=rf"another run writes to .*{place}:"), hold(tmp_path / place):
                pass
        if killed:
            run.send_signal(signal.SIGKILL)
        else:
            run.communicate(b"\n", timeout=20)
    left = ["deep", "folder"] if killed else []
    assert (tmp_path / "file").read_bytes() == (b"old" if killed else b"theirs")
    for hold, place in ((hold_file, "deep/lock"), (hold_folder, "folder")):
        with hold(tmp_path / place):
            pass
        assert not (tmp_path / "deep" / "lock").exists()
    write_file(tmp_path / "ours", b"ours")
    assert sorted(os.listdir(tmp_path)) == sorted([*others, "file", "ours", *left])
    assert not any(os.listdir(tmp_path / name) for name in left)


def test_runs_take_turns(tmp_path: Path) -> None:
    """A run that waits makes the folder that the run before has removed."""
    folder = tmp_path / "folder"
    written: list[bool] = []

    def staged() -> None:
        with Stage(turns=folder) as outputs:
            outputs.write(tmp_path / "image", b"x")

    with ThreadPoolExecutor() as pool:
        with hold_folder(folder):
            waiting = pool.submit(exchange, folder, lambda new: written.append(new.is_dir()), list, "none")
            staging = pool.submit(staged)
            assert not wait([waiting, staging], 0.3).done
            assert not written
            assert not (tmp_path / "image").exists()
        waiting.result(20)
        staging.result(20)
    assert written == [True]
    assert os.listdir(tmp_path) == ["image"]


def test_systems_without_locks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Runs go on, and nobody knows which temporary folders are of killed ones: all of them stay."""

    def unknown(*_: object) -> None:
        raise OSError(errno.ENOLCK, "No locks available")

    dead = tmp_path / f"{BESIDE}{'0' * 16}"
    dead.mkdir()
    with monkeypatch.context() as patch:
        patch.setattr(fcntl, "flock", unknown)
        with hold_folder(tmp_path / "a"), hold_folder(tmp_path / "a"):
            write_file(tmp_path / "b", b"x")
        assert dead.exists()
    write_file(tmp_path / "b", b"x")
    assert os.listdir(tmp_path) == ["b"]


@pytest.mark.parametrize("ignored", [False, True])
def test_signals_that_interrupt(ignored: bool) -> None:
    """Each of them once, except a SIGHUP that nohup has ignored."""
    assert SIGNALS == (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    caught: list[int] = []
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN if ignored else signal.SIG_DFL)
    try:
        with on_interrupt(lambda number, frame: caught.append(number)):
            for number in SIGNALS:
                os.kill(os.getpid(), number)
        assert caught == [number for number in SIGNALS if not ignored or number != signal.SIGHUP]
        assert signal.getsignal(signal.SIGHUP) == (signal.SIG_IGN if ignored else signal.SIG_DFL)
    finally:
        signal.signal(signal.SIGHUP, before)
