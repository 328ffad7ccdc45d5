"""Hostile decoders under the runner: each is a crash of its vector alone, and nothing of it is left."""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
import tempfile
import time
import uuid
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import hostile_decoder
import pytest
from small_suite import Suite

from conformance import cli
from conformance.report import record as records
from refcodec import statuses

VICTIM, HONEST = "valid-extended", "valid-plain"

NO_OUTPUT = "crash: exit status 0 without an output file"
NO_JSON = "crash: exit status 1, whose last line of stderr is not JSON"
CLOSED = "crash: changed the permissions of its folder"
REPLACED = "crash: replaced its folder"
REMOVED = "crash: removed files that are not its own"
LATE = "crash: took too long"
MANY = "crash: left too many files, or too large ones"
WATCHER = "crash: ended or stopped the process that watches it"

# An attack, and what is said of its vector.
ATTACKS: dict[str, str | tuple[str, ...]] = {
    "output-is-a-folder": "crash: its output is a folder",
    "output-is-a-link": "crash: its output is a link",
    "output-is-a-link-to-the-answer": "crash: its output is a link",
    "output-is-a-link-to-a-device": "crash: its output is a link",
    "output-is-a-fifo": "crash: its output is a FIFO",
    "output-is-a-socket": "crash: its output is a socket",
    # A privileged process may raise its limits, and is found out afterwards.
    "output-has-a-hole": ("crash: wrote too much", "crash: ended by SIGXFSZ"),
    "output-grows": "the output is not the canonical reconstruction",
    "folder-is-gone": REMOVED,
    "folder-is-closed": CLOSED,
    "part-is-closed": CLOSED,
    "folder-is-moved": REMOVED,
    "folder-is-a-link": REPLACED,
    "folder-is-another": REPLACED,
    "input-is-gone": REMOVED,
    "input-is-another": "crash: changed its input",
    "input-is-a-link": "crash: left a file that is a link",
    "many-files": MANY,
    "deep-folders": NO_OUTPUT,
    "much-on-the-disk": MANY,
    "odd-names": "crash: left files beside its output: ",
    "closed-folders": "",
    "cwd-is-gone": NO_OUTPUT,
    "many-children": "crash: started too many processes",
    "daemons-hold-stderr": NO_OUTPUT,
    "daemon": NO_OUTPUT,
    "daemon-of-a-right-decoder": "",
    "daemon-that-hops": NO_OUTPUT,
    "daemon-that-eats": "crash: took too much memory",
    "daemon-of-another-program": NO_OUTPUT,
    "stops-itself": LATE,
    "kills-its-group": "crash: ended by SIGKILL",
    "kills-its-parents-group": WATCHER,
    "stops-its-parent": WATCHER,
    "much-on-stderr": "crash: wrote too much",
    "much-on-stdout": LATE,
    "closes-everything": NO_OUTPUT,
    "is-another-program": NO_OUTPUT,
    "limits-and-is-nice": NO_JSON,
    "dumps-core": "crash: ended by SIGABRT",
    "deep-json": NO_JSON,
    "deep-json-with-an-end": NO_JSON,
    "long-code": NO_JSON,
    "long-offset": NO_JSON,
    "large-offset": "refused with 103 prologue.crc, malformed; the file is valid",
    "a-code-twice": NO_JSON,
    "the-end-of-a-long-line": NO_JSON,
    "text-that-steers": NO_JSON,
    "looks-for-the-manifest": "crash: exit status 71",
    "exit-64": "crash: exit status 64",
    "exit-70": "crash: exit status 70",
    "exit-255": "crash: exit status 255",
    "exit-0": NO_OUTPUT,
}
# They wait until their time is up, which is ten times their budget of ten seconds: it is made shorter.
WAITING = {"stops-itself": "0.02", "much-on-stdout": "0.02"}


def snapshot(folder: Path) -> dict[str, str]:
    """All that is in a folder, with the bytes of files."""
    return {
        str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else "-"
        for path in sorted(folder.rglob("*"))
    }


def processes(mark: str) -> list[int]:
    """Those that have a word in their environment or in their command."""
    found = []
    for path in Path("/proc").iterdir():
        if path.name.isdigit() and int(path.name) != os.getpid():
            for name in ("environ", "cmdline"):
                try:
                    text = (path / name).read_bytes()
                except OSError:
                    continue
                if mark.encode() in text and int(path.name) not in found:
                    found.append(int(path.name))
    return found


class Ground:
    """Where decoders attack: what is there before, and what must be there afterwards."""

    def __init__(self, suite: Suite, folder: Path) -> None:
        self.suite, self.report, self.temporary = suite, folder / "report", folder / "temporary"
        self.cwd, self.mark = folder / "cwd", uuid.uuid4().hex
        for path in (self.temporary, self.cwd):
            path.mkdir()
        (self.cwd / "a-file-of-the-user").write_text("dear")
        self._watched = (suite.folder, suite.answers.parent, self.temporary)
        self._before = [snapshot(path) for path in self._watched]

    def run(self, slow: str, *words: str, jobs: str = "2") -> tuple[int, dict[str, Any]]:
        """The status and the record of a run on both vectors; nothing is left of it."""
        options = ["--vectors", str(self.suite.folder), "--jobs", jobs, "--slow", slow, "--report", str(self.report)]
        status = cli.main(["run", *options, "--select", f"id:{VICTIM},{HONEST}", *words])
        assert processes(self.mark) == []
        assert [snapshot(path) for path in self._watched] == self._before
        record = records.load(self.report / "report.json")
        return status, record


@pytest.fixture
def ground(suite: Suite, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Ground:
    made = Ground(suite, tmp_path)
    monkeypatch.setattr(tempfile, "tempdir", str(made.temporary))
    monkeypatch.setenv("C3GS_TEST_MARK", made.mark)
    monkeypatch.chdir(made.cwd)
    return made


def victim(suite: Suite) -> str:
    return hashlib.sha256((suite.folder / "valid" / "extended.c3gs").read_bytes()).hexdigest()


def command(suite: Suite, attack: str) -> list[str]:
    words = [attack, victim(suite), str(suite.answers), "{input}", "{output}"]
    return ["--", sys.executable, "-S", "-E", hostile_decoder.__file__, *words]


def texts(record: dict[str, Any]) -> dict[str, str]:
    return {v["id"]: v["text"] for v in record["vectors"]}


linux = pytest.mark.skipif(sys.platform != "linux", reason="the runner finds what leaves its group on Linux alone")


@linux
@pytest.mark.slow
@pytest.mark.parametrize("attack", ATTACKS)
def test_an_attack_is_a_crash_of_its_vector(ground: Ground, attack: str, capsys: pytest.CaptureFixture[str]) -> None:
    status, record = ground.run(WAITING.get(attack, "1"), *command(ground.suite, attack))
    found = texts(record)
    wanted = ATTACKS[attack]
    text = wanted if isinstance(wanted, str) else next((text for text in wanted if text == found[VICTIM]), wanted[0])
    assert status == (statuses.REJECTED if text else statuses.DONE)
    assert found[HONEST] == ""
    assert found[VICTIM].startswith(text)
    assert found[VICTIM] == text or text.endswith(": ")
    states = {v["id"]: v["status"] for v in record["vectors"]}
    assert states[HONEST] == "passed"
    assert states[VICTIM] == ("passed" if not text else "crashed" if text.startswith("crash") else "failed")
    if attack != "cwd-is-gone":
        assert snapshot(ground.cwd) == {"a-file-of-the-user": hashlib.sha256(b"dear").hexdigest()}
    # Whatever it said or named steers neither a terminal nor a reader of the reports.
    ElementTree.parse(ground.report / "report.xml")
    assert "</pre><script>" not in (ground.report / "report.html").read_text()
    said = capsys.readouterr()
    for shown in (*((ground.report / f"report.{kind}").read_text() for kind in ("json", "html", "xml")), *said):
        assert all(c.isprintable() or c in "\n\t" for c in shown)
    assert len(record["vectors"][0]["stderr"]) < 4100


@linux
def test_what_is_not_prevented(ground: Ground) -> None:
    """A decoder runs as its user: what it writes to places that it knows of stays there (README.md)."""
    place = Path("/dev/shm") / ground.mark
    shell = f"echo x >{place}; exit 64"
    status, record = ground.run("1", "--", "/bin/sh", "-c", shell, "{input}", "{output}")
    assert status == statuses.REJECTED
    assert set(texts(record).values()) == {"crash: exit status 64"}
    assert place.read_text() == "x\n"
    place.unlink()


@linux
@pytest.mark.slow
def test_a_runner_that_is_killed_leaves_no_process(ground: Ground) -> None:
    """The watchers notice that it is gone."""
    shell = "setsid sleep 30 & sleep 30"
    words = [
        "run",
        "--vectors",
        str(ground.suite.folder),
        "--jobs",
        "2",
        "--",
        "/bin/sh",
        "-c",
        shell,
        "{input}{output}",
    ]
    environment = {**os.environ, "TMPDIR": str(ground.temporary)}
    command = [sys.executable, "-m", "conformance", *words]
    runner = subprocess.Popen(command, env=environment, stderr=subprocess.DEVNULL)
    wait(lambda: len(processes(ground.mark)) >= 1 + 2 + 2 * 3)
    runner.kill()
    runner.wait()
    wait(lambda: processes(ground.mark) == [])
    # Nobody is left who could remove the folders (README.md).
    assert {path.name[:5] for path in ground.temporary.iterdir()} == {"c3gs-"}


def wait(until: Callable[[], bool]) -> None:
    """Waits at most a minute."""
    end = time.monotonic() + 60
    while not until():
        assert time.monotonic() < end
        time.sleep(0.05)


# A server by attack, which is on one file. The line is what is written at last.
SERVER = """
import hashlib, json, os, signal, subprocess, sys, time
attack, victim, answers = sys.argv[1], sys.argv[2], json.load(open(sys.argv[3]))
for line in sys.stdin:
    q = json.loads(line)
    digest = hashlib.sha256(open(q["input"], "rb").read()).hexdigest()
    said = {"id": q["id"], "status": 0}
    open(q["output"], "wb").write(open(answers[digest]["output"], "rb").read())
    text = json.dumps(said)
    if digest == victim:
        if attack == "deep": text = "[" * 100000
        if attack == "deep-with-an-end": text = '{"status": 0, "more": ' + "[" * 5000 + "]" * 5000 + "}"
        if attack == "digits": text = '{"status": ' + "9" * 100000 + "}"
        if attack == "not-utf-8": sys.stdout.buffer.write(b'\\xff\\xfe{"status": 0}\\n'); sys.stdout.flush(); continue
        if attack == "twice": text += "\\n" + text
        if attack == "of-another": text = json.dumps({**said, "id": q["id"] + 1})
        if attack == "later-again":
            print(text, flush=True)
            if not os.fork(): time.sleep(0.2); print(text, flush=True); os._exit(0)
            continue
        if attack == "late": time.sleep(30)
        if attack == "never-reads": print(text[:3], end="", flush=True); time.sleep(30)
        if attack == "closes-stdout": os.close(1); time.sleep(30)
        if attack == "floods-stdout":
            while True: os.write(1, b" " * 65536)
        if attack == "floods-stderr":
            while True: os.write(2, b" " * 65536)
        if attack == "children": [subprocess.Popen(["sleep", "30"]) for _ in range(3)]
        if attack == "many-children": [subprocess.Popen(["sleep", "30"]) for _ in range(200)]; time.sleep(30)
        if attack == "daemons":
            for _ in range(3):
                if not os.fork(): subprocess.Popen(["sleep", "30"], start_new_session=True); os._exit(0)
        if attack == "kills-its-parent": os.kill(os.getppid(), signal.SIGKILL); time.sleep(30)
        if attack == "folder": os.unlink(q["output"]); os.mkdir(q["output"])
        if attack == "steers": text = json.dumps({"status": 1, "stderr": "\\x1b]0;x\\x07\\ud800\\u202e"})
    print(text, flush=True)
"""
UNREADABLE = "crash: gave an answer that cannot be read"
SERVERS = {
    "deep": UNREADABLE,
    "deep-with-an-end": UNREADABLE,
    "digits": UNREADABLE,
    "not-utf-8": UNREADABLE,
    "twice": "crash: answered more than once",
    "of-another": "crash: answered another request",
    "later-again": "",
    "late": LATE,
    "never-reads": LATE,
    "closes-stdout": UNREADABLE,
    "floods-stdout": UNREADABLE,
    "floods-stderr": "crash: wrote too much",
    "children": "",
    "many-children": "crash: started too many processes",
    "daemons": "",
    "kills-its-parent": WATCHER,
    "folder": "crash: its output is a folder",
    "steers": NO_JSON,
}


@linux
@pytest.mark.slow
@pytest.mark.parametrize("attack", SERVERS)
def test_an_attack_of_a_decoder_that_serves(ground: Ground, attack: str, tmp_path: Path) -> None:
    script = tmp_path / "server.py"
    script.write_text(SERVER)
    words = [sys.executable, "-S", "-E", str(script), attack, victim(ground.suite), str(ground.suite.answers)]
    slow = "0.02" if SERVERS[attack] == LATE else "1"
    # With one process, the victim comes first, and the honest vector finds what it left behind.
    status, record = ground.run(slow, "--serve", "--", *words, jobs="1")
    text = SERVERS[attack]
    assert status == (statuses.REJECTED if text else statuses.DONE)
    assert texts(record) == {VICTIM: text, HONEST: ""}
    assert all(c.isprintable() or c == "\n" for v in record["vectors"] for c in v["stderr"])


# --- documents of others ----------------------------------------------------------------------------------------------

DOCUMENTS: dict[str, bytes] = {
    "deep": b"[" * 100_000,
    "deep-with-an-end": b"[" * 100_000 + b"]" * 100_000,
    "long-number": b"9" * 1_000_000,
    "not-utf-8": b'{"name": "caf\xe9"}',
    "utf-16": '{"name": "x"}'.encode("utf-16"),
    "nul": b"\0" * 100,
    "infinity": b'{"name": Infinity}',
    "name-twice": b'{"name": 1, "name": 2}',
    "half-of-a-pair": b'{"name": "\\ud800", "\\u001b]0;x\\u0007": 1}',
    "another-kind": b'{"name": ["' + b"x" * 100_000 + b'"]}',
    "empty": b"",
}


@pytest.mark.parametrize("kind", DOCUMENTS)
def test_documents_of_others(suite: Suite, tmp_path: Path, capsys: pytest.CaptureFixture[str], kind: str) -> None:
    """Nothing that is no document is a fault of the program: one line, and the status of its kind."""
    path = tmp_path / "document.json"
    path.write_bytes(DOCUMENTS[kind])
    other = tmp_path / "suite"
    other.mkdir()
    (other / "manifest.json").write_bytes(DOCUMENTS[kind])
    vectors, decoder = ["--vectors", str(suite.folder)], ["--", "true", "{input}", "{output}"]
    commands: list[tuple[list[str], int]] = [
        (["verify-report", *vectors, str(path), *decoder], statuses.USAGE),
        (["run", *vectors, "--describe", str(path), *decoder], statuses.USAGE),
        (["run", "--vectors", str(other), *decoder], statuses.DAMAGED_SUITE),
        (["export", "--vectors", str(other), "--fluster", str(tmp_path / "out")], statuses.DAMAGED_SUITE),
        (["selftest", "--manifest", str(other / "manifest.json")], statuses.DAMAGED_SUITE),
        (["fuzz", "-n", "1", "--state", str(path)], statuses.USAGE),
    ]
    if kind not in ("empty",):
        commands.append((["run", *vectors, "--known-failures", str(path), *decoder], statuses.USAGE))
    for words, status in commands:
        assert cli.main(words) == status, words[0]
        out, err = capsys.readouterr()
        assert out == ""
        assert err.count("\n") == 1, words[0]
        assert len(err) < 1000
        assert all(c.isprintable() or c == "\n" for c in err)


def test_the_record_of_planted_bugs(suite: Suite, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It is read as others' documents are. A record of another suite is told."""
    from conformance.manifest import ManifestError  # noqa: PLC0415
    from conformance.mutants import record  # noqa: PLC0415

    path = tmp_path / "caught.json"
    for data in (*DOCUMENTS.values(), b'{"bug": ["a-vector"]}', b'{"bug": 1}'):
        path.write_bytes(data)
        with pytest.raises(ManifestError):
            record.read(path)
    assert cli.main(["selftest", "--recorded", "--manifest", str(suite.folder / "manifest.json")]) == 3


@pytest.mark.parametrize(
    "change",
    [
        lambda r: r["suite"].update(version="\x1b]0;x\x07" * 1000, manifest_sha256="0" * 64),
        lambda r: r["vectors"][0].update(id="\x1b[31m"),
        lambda r: r["vectors"][0]["found"].update(text="\x1b[31m" * 1000),
        lambda r: r.update({"\x1b[31m" * 1000: 1}),
    ],
    ids=["suite", "vector", "found", "name"],
)
def test_a_report_that_steers(
    suite: Suite, tmp_path: Path, capsys: pytest.CaptureFixture[str], change: Callable[[dict[str, Any]], object]
) -> None:
    _, record = suite.report("right", tmp_path)
    change(record)
    (tmp_path / "other.json").write_text(json.dumps(record))
    capsys.readouterr()
    words = ["verify-report", "--vectors", str(suite.folder), str(tmp_path / "other.json"), "--"]
    assert cli.main([*words, *suite.command("right")]) in (
        statuses.REJECTED,
        statuses.DAMAGED_SUITE,
        statuses.USAGE,
    )
    out, err = capsys.readouterr()
    assert len(out + err) < 2000
    assert all(c.isprintable() or c == "\n" for c in out + err)
