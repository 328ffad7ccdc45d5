"""What a command may write to, and how it does: the rule of refcodec.files, and locks between processes."""

from __future__ import annotations

import errno
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from refcodec.files import held, lock, stage
from refcodec.files.exchange import INCOMING, exchange
from refcodec.files.interrupts import SIGNALS, on_interrupt
from refcodec.files.lock import hold_file, hold_folder
from refcodec.files.outputs import Kind, check_apart, check_file
from refcodec.files.present import NotAFileError, is_there
from refcodec.files.stage import Stage, write_file
from refcodec.statuses import UsageError

POEM = Kind("a poem", re.compile(rb"roses"))


# --- the rule ---------------------------------------------------------------------------------------------------------


def test_an_existing_file_of_another_kind_stays(tmp_path: Path) -> None:
    path = tmp_path / "a"
    for content in (None, b"", b"roses are red"):
        if content is not None:
            path.write_bytes(content)
        check_file(path, POEM)
    path.write_bytes(b"violets")
    with pytest.raises(UsageError, match="is not a poem"):
        check_file(path, POEM)
    with pytest.raises(UsageError, match="is a directory"):
        check_file(tmp_path, POEM)
    with pytest.raises(UsageError, match="there is no directory"):
        check_file(tmp_path / "b" / "c", POEM)
    check_file(tmp_path / "b" / "c", POEM, made=True)
    with pytest.raises(UsageError, match="is not a directory"):
        check_file(path / "c", POEM, made=True)
    check_file(Path("/dev/null"), POEM)
    # A link is what it leads to.
    (tmp_path / "link").symlink_to(path)
    with pytest.raises(UsageError, match="is not a poem"):
        check_file(tmp_path / "link", POEM)


def test_messages_are_one_line(tmp_path: Path) -> None:
    path = tmp_path / "a\n\x1b[31mb"
    path.write_bytes(b"violets")
    with pytest.raises(UsageError) as raised:
        check_file(path, POEM)
    assert str(raised.value).isprintable()


def test_an_output_is_no_input(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever either of them is called."""
    monkeypatch.chdir(tmp_path)
    source, folder = tmp_path / "in", tmp_path / "folder"
    source.write_bytes(b"x")
    folder.mkdir()
    (folder / "photo").write_bytes(b"y")
    (tmp_path / "symbolic").symlink_to("in")
    os.link(source, tmp_path / "hard")
    (tmp_path / "elsewhere").symlink_to("folder")
    (tmp_path / "photo").symlink_to("folder/photo")
    os.link(folder / "photo", tmp_path / "print")
    for name in ("in", "./in", "folder/../in", "symbolic", "hard", str(source)):
        with pytest.raises(UsageError, match="is read"):
            check_apart([Path(name)], [source])
        with pytest.raises(UsageError, match="is read"):
            check_apart([source], [name])
    for name in ("folder/photo", "folder/new", "elsewhere/photo", "elsewhere/new", "photo", "print"):
        with pytest.raises(UsageError, match="read: choose another output"):
            check_apart([Path(name)], [None, folder])
    # What is not there is told by who reads it. Folders of their own do not get in the way.
    check_apart([Path("new"), Path("folder/renders/new"), Path("/dev/null"), Path("/dev/null")], ["nowhere", folder])


def test_two_outputs_are_two_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a").write_bytes(b"")
    os.link(tmp_path / "a", tmp_path / "b")
    (tmp_path / "c").symlink_to("new")
    for pair in (("a", "./a"), ("a", "b"), ("new", "c"), ("new", "New"), ("caf\u00e9", "cafe\u0301")):
        with pytest.raises(UsageError, match="are one file"):
            check_apart(map(Path, pair), [])
    check_apart([Path("a"), Path("d"), Path("e")], [])


def test_what_may_be_missing(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"")
    (tmp_path / "link").symlink_to("file")
    assert is_there(tmp_path / "file")
    assert is_there(tmp_path / "link")
    assert not is_there(tmp_path / "none")
    assert not is_there(tmp_path / "file" / "none")
    (tmp_path / "dangling").symlink_to("none")
    (tmp_path / "circle").symlink_to("circle")
    (tmp_path / "folder").mkdir()
    os.mkfifo(tmp_path / "pipe")
    words = {"dangling": "nowhere", "circle": "circle", "folder": "a directory", "pipe": "a pipe"}
    for name, word in words.items():
        with pytest.raises(NotAFileError, match=word):
            is_there(tmp_path / name)


# --- whole or not there -----------------------------------------------------------------------------------------------


def test_outputs_come_together(tmp_path: Path) -> None:
    first, second = tmp_path / "first", tmp_path / "deep" / "er" / "second"
    first.write_bytes(b"old")

    def fail() -> None:
        with Stage() as outputs:
            outputs.write(first, b"new")
            outputs.open(second).write(b"new")
            assert first.read_bytes() == b"old"
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fail()
    assert os.listdir(tmp_path) == ["first"]
    with Stage() as outputs:
        outputs.write(first, b"new")
        outputs.cancel()
    assert first.read_bytes() == b"old"
    with Stage() as outputs:
        outputs.write(first, b"new")
        outputs.open(second).write(b"new")
    assert first.read_bytes() == second.read_bytes() == b"new"
    assert sorted(os.listdir(tmp_path)) == ["deep", "first"]


def test_a_link_stays_and_a_pipe_gets_all_at_the_end(tmp_path: Path) -> None:
    (tmp_path / "place").mkdir()
    (tmp_path / "link").symlink_to("place/file")
    write_file(tmp_path / "link", b"new")
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "place" / "file").read_bytes() == b"new"
    os.mkfifo(tmp_path / "pipe")
    reader = subprocess.Popen(["cat", tmp_path / "pipe"], stdout=subprocess.PIPE)
    write_file(tmp_path / "pipe", b"through")
    assert reader.communicate(timeout=20)[0] == b"through"


def test_more_outputs_than_open_files(tmp_path: Path) -> None:
    code = f"""
import resource
from pathlib import Path
from refcodec.files.stage import Stage
resource.setrlimit(resource.RLIMIT_NOFILE, (40, 40))
with Stage() as stage:
    for number in range(100):
        stage.write(Path({str(tmp_path)!r}) / str(number), b"x")
"""
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)
    assert len(os.listdir(tmp_path)) == 100


def test_an_exchange_goes_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Folders move as files do, what else is there stays, and a leftover of a killed run is no hindrance."""
    folder = tmp_path / "folder"
    (folder / "part").mkdir(parents=True)
    (folder / "part" / "a").write_bytes(b"old")
    (folder / "whole").write_bytes(b"old")
    (folder / "letter").write_bytes(b"precious")
    (folder / INCOMING / "new").mkdir(parents=True)

    def write(new: Path) -> None:
        (new / "part").mkdir()
        (new / "whole").write_bytes(b"new")

    def replaced() -> list[Path]:
        return [folder / "part", folder / "whole", folder / "none"]

    real = os.rename
    for failing in range(4):
        calls: list[Path] = []

        def rename(source: Path, target: Path, failing: int = failing, calls: list[Path] = calls) -> None:
            calls.append(source)
            if len(calls) == failing + 1:
                raise OSError(errno.EACCES, "Permission denied")
            real(source, target)

        monkeypatch.setattr(os, "rename", rename)
        with pytest.raises(OSError, match="denied"):
            exchange(folder, write, replaced, "whole")
        monkeypatch.setattr(os, "rename", real)
        assert sorted(os.listdir(folder)) == ["letter", "part", "whole"]
        assert (folder / "whole").read_bytes() == (folder / "part" / "a").read_bytes() == b"old"
    exchange(folder, write, replaced, "whole")
    assert (folder / "whole").read_bytes() == b"new"
    assert os.listdir(folder / "part") == []
    assert (folder / "letter").read_bytes() == b"precious"
    assert sorted(os.listdir(folder)) == ["letter", "part", "whole"]


# --- locks ------------------------------------------------------------------------------------------------------------

HOLDER = """
import sys, time
from pathlib import Path
from refcodec.files.lock import hold_file, hold_folder
with {"file": hold_file, "folder": hold_folder}[sys.argv[1]](Path(sys.argv[2])):
    print("held", flush=True)
    time.sleep(600)
"""


@pytest.mark.parametrize("kind", ["file", "folder"])
def test_a_lock_ends_with_its_holder(kind: str, tmp_path: Path) -> None:
    path = tmp_path / "deep" / "lock"
    hold = {"file": hold_file, "folder": hold_folder}[kind]
    process = subprocess.Popen([sys.executable, "-c", HOLDER, kind, path], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    assert process.stdout.readline() == "held\n"
    with pytest.raises(UsageError, match="another run"), hold(path):
        pass
    process.send_signal(signal.SIGKILL)
    process.wait(timeout=20)
    # What a killed run left is there, and no hindrance.
    assert path.exists()
    with hold(path):
        pass
    assert path.exists() == (kind == "folder")


def test_a_lock_leaves_nothing(tmp_path: Path) -> None:
    for hold in (hold_file, hold_folder):
        with hold(tmp_path / "deep" / "lock"):
            assert os.listdir(tmp_path) == ["deep"]
        assert os.listdir(tmp_path) == []


def test_a_folder_that_goes_away_is_made_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The run before removes its empty folder between this one's two looks at it."""
    folder, real, calls = tmp_path / "folder", os.fstat, []

    def fstat(descriptor: int) -> os.stat_result:
        if not calls:
            folder.rmdir()
        calls.append(descriptor)
        return real(descriptor)

    monkeypatch.setattr(lock.os, "fstat", fstat)
    with hold_folder(folder):
        assert folder.is_dir()
    assert len(calls) == 2


def test_systems_without_locks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def unknown(*_: object) -> None:
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr(held.fcntl, "flock", unknown)
    with hold_folder(tmp_path / "a"), hold_folder(tmp_path / "a"):
        pass
    monkeypatch.setattr(held, "fcntl", None)
    with hold_folder(tmp_path / "a"):
        pass


def test_folders_that_cannot_be_flushed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise OSError(errno.EINVAL, "Invalid argument")

    monkeypatch.setattr(os, "fsync", refuse)
    stage.settle_folder(tmp_path)
    monkeypatch.setattr(os, "fsync", lambda _: (_ for _ in ()).throw(OSError(errno.EIO, "Input/output error")))
    with pytest.raises(OSError, match="Input"):
        stage.settle_folder(tmp_path)


def test_a_run_that_is_killed_leaves_old_or_new(tmp_path: Path) -> None:
    """Two contents take turns in one file, and the process is killed at some moment."""
    path = tmp_path / "file"
    code = """
import itertools, sys
from pathlib import Path
from refcodec.files.stage import write_file
for content in itertools.cycle((b"a" * 99999, b"b" * 99999)):
    write_file(Path(sys.argv[1]), content)
"""
    write_file(path, b"a" * 99999)
    process = subprocess.Popen([sys.executable, "-c", code, path])
    time.sleep(0.5)
    process.kill()
    process.wait(timeout=20)
    found = path.read_bytes()
    assert len(found) == 99999
    assert len(set(found)) == 1


STAGES = """
import sys
from pathlib import Path
from refcodec.files.stage import Stage
with Stage() as stage:
    stage.write(Path(sys.argv[1]) / "theirs", b"x")
    print("staged", flush=True)
    sys.stdin.readline()
"""


def test_what_a_killed_run_leaves_is_removed_by_a_later_one(tmp_path: Path) -> None:
    """What a live one has there stays."""
    runs = [
        subprocess.Popen([sys.executable, "-c", STAGES, tmp_path], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        for _ in range(2)
    ]
    for run in runs:
        assert run.stdout is not None
        assert run.stdout.readline() == b"staged\n"
    lived = set(os.listdir(tmp_path))
    assert len(lived) == 2
    other = {f"{stage.BESIDE}notes", f"{stage.BESIDE}0123456789abcdef.txt"}
    for name in other:
        (tmp_path / name).mkdir()
    write_file(tmp_path / "ours", b"y")
    assert set(os.listdir(tmp_path)) == {"ours", *other, *lived}
    runs[0].kill()
    runs[0].wait(timeout=20)
    write_file(tmp_path / "ours", b"y")
    left = set(os.listdir(tmp_path))
    assert len(left & lived) == 1
    assert left >= {"ours", *other}
    runs[1].communicate(b"\n", timeout=20)
    assert runs[1].returncode == 0
    assert set(os.listdir(tmp_path)) == {"ours", "theirs", *other}
    for run in runs:
        for pipe in (run.stdin, run.stdout):
            assert pipe is not None
            pipe.close()


def test_a_place_that_another_run_takes_for_a_dead_ones_is_made_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Between the making of the folder and its lock."""
    real, taken = stage.locked, []

    def late(path: Path, *words: object) -> int | None:
        if not taken:
            taken.append(path)
            stage._remove_dead(tmp_path)
            assert not path.exists()
        return real(path, *words)

    monkeypatch.setattr(stage, "locked", late)
    write_file(tmp_path / "a", b"x")
    assert os.listdir(tmp_path) == ["a"]
    assert taken


def test_where_no_locks_are_nothing_is_removed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def unknown(descriptor: int, operation: int) -> None:
        raise OSError(errno.ENOLCK, "No locks available")

    dead = tmp_path / f"{stage.BESIDE}{'0' * 16}"
    dead.mkdir()
    with monkeypatch.context() as patch:
        patch.setattr(held.fcntl, "flock", unknown)
        write_file(tmp_path / "a", b"x")
        assert sorted(os.listdir(tmp_path)) == [dead.name, "a"]
    write_file(tmp_path / "a", b"x")
    assert os.listdir(tmp_path) == ["a"]


@pytest.mark.parametrize("ignored", [False, True])
def test_signals_that_interrupt(ignored: bool) -> None:
    """Each of them once; one that nohup has ignored is none."""
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
