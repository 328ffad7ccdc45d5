"""Decoders that fail or attack, each on its own file in one run: each has its verdict, and nothing is left behind."""

import contextlib
import hashlib
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import uuid
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import psutil
import pytest
from small_suite import FAKE, ROOT, Suite, build, modes

from conformance import cli
from refcodec import statuses

NO_OUTPUT = "crash: exit status 0 without an output file"
NO_JSON = "crash: exit status 1, whose last line of stderr is not JSON"
LATE = "crash: took too long"
MEMORY = "crash: took too much memory"
MUCH = "crash: wrote too much"
UNREADABLE = "crash: gave an answer that cannot be read"
WRONG = "the output is not the canonical reconstruction"

# The mode of a decoder for a valid file, and the text of its vector. An empty text is a pass. test_grading.py has the
# other answers.
MODES = {
    "right": "",
    "nothing": NO_OUTPUT,
    "raises": NO_JSON,
    "rejects": "refused with 103 prologue.crc, malformed; the file is valid",
    "text-that-steers": NO_JSON,
    **dict.fromkeys(("last-bit", "first-bit", "digest-bit", "short", "long", "accepts"), WRONG),
    **dict.fromkeys(("hang", "hang-in-child", "spins"), LATE),
    "segfault": "crash: ended by SIGSEGV",
    "memory": MEMORY,
    **dict.fromkeys(("left-children", "deep-folders"), ""),
    "much-on-stderr": MUCH,
    "output-is-giant": MUCH,
    "output-is-a-link": "crash: its output is not a regular file",
}
# The mode of a server for a valid file, and the text of its vector.
SERVERS = {
    **dict.fromkeys(("right", "left-children", "deep-folders"), ""),
    "much-on-stderr": MUCH,
    "dies": "crash: ended by SIGABRT",
    "eats": MEMORY,
    "late": LATE,
    "signal": "crash: ended by SIGSEGV",
    **dict.fromkeys(("both", "garbage", "endless", "twice", "of-another"), UNREADABLE),
}
# Those that wait until their time is up, which is ten times their budget, and those with less memory.
BUDGETS = {mode: {"seconds": 100} for mode in (*MODES, *SERVERS)}
BUDGETS |= {mode: {"seconds": 1} for mode in ("hang", "hang-in-child", "late")}
BUDGETS |= {mode: {"seconds": 100, "bytes": 64 << 20} for mode in ("memory", "eats")}
BUDGETS["spins"] = {"seconds": 10}


def snapshot(folder: Path) -> dict[str, str]:
    """All that is in a folder, with the digests of files."""
    return {
        str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else "-"
        for path in sorted(folder.rglob("*"))
    }


def processes(mark: str) -> list[int]:
    """The other processes with a mark in their environment."""
    running = []
    for process in psutil.process_iter():
        with contextlib.suppress(psutil.Error):
            if process.environ().get("C3GS_TEST_MARK") == mark and process.pid != os.getpid():
                running.append(process.pid)
    return running


def printable(text: str) -> bool:
    return all(c.isprintable() or c in "\n\t" for c in text)


@dataclass
class Ran:
    """A run of all modes. entries: of the record, by identifier. left: what it left behind."""

    status: int
    folder: Path
    entries: dict[str, dict[str, Any]]
    left: list[object]


def run_modes(folder: Path, files: dict[str, bytes], *serve: str) -> Ran:
    names = ("suite", "answers", "temporary", "cwd")
    for name in names:
        (folder / name).mkdir()
    suite = build(folder / "suite", folder / "answers", files, BUDGETS)
    before, mark = [snapshot(folder / name) for name in names], str(uuid.uuid4().int)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(tempfile, "tempdir", str(folder / "temporary"))
        patch.setenv("C3GS_TEST_MARK", mark)
        patch.chdir(folder / "cwd")
        command = [sys.executable, "-S", "-E", str(FAKE), "listed", str(suite.answers)]
        command += [] if serve else ["{input}", "{output}"]
        options = ["--vectors", str(suite.folder), "--jobs", "4", "--slow", "0.1", "--report", str(folder / "report")]
        status = cli.main(["run", *options, *serve, "--", *command])
        left = [processes(mark), [snapshot(folder / name) for name in names] == before]
    record = json.loads((folder / "report" / "report.json").read_text())
    return Ran(status, folder / "report", {v["id"]: v for v in record["vectors"]}, left)


@pytest.fixture(scope="module")
def ran(tmp_path_factory: pytest.TempPathFactory) -> Ran:
    return run_modes(tmp_path_factory.mktemp("modes"), modes(MODES, ["right"]))


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory) -> Ran:
    return run_modes(tmp_path_factory.mktemp("served"), modes(SERVERS, ["right"]), "--serve")


@pytest.mark.parametrize(
    ("run", "mode"), [*(("ran", mode) for mode in MODES), *(("served", mode) for mode in SERVERS)], ids=str
)
def test_each_has_its_verdict(run: str, mode: str, request: pytest.FixtureRequest) -> None:
    ran: Ran = request.getfixturevalue(run)
    entry, text = ran.entries[f"valid-{mode}"], (MODES if run == "ran" else SERVERS)[mode]
    status = "passed" if not text else "crashed" if text.startswith("crash") else "failed"
    assert (entry["text"], entry["status"], entry["grade"]) == (text, status, 0 if text else 3)
    assert ran.entries["invalid-right"]["grade"] == 3


def test_nothing_is_left_and_nothing_steers(ran: Ran, served: Ran) -> None:
    """No process, file or folder is left, and the reports are text of bounded length."""
    for run in (ran, served):
        assert (run.status, run.left) == (statuses.REJECTED, [[], True])
        assert "</pre><script>" not in (run.folder / "report.html").read_text()
        assert all(printable(path.read_text()) for path in run.folder.iterdir())
        assert max(len(v["stderr"]) for v in run.entries.values()) < 4100
    # Idle decoders have ten times the budget.
    assert 1 <= ran.entries["valid-hang"]["seconds"] < 20
    assert 1 <= ran.entries["valid-spins"]["seconds"] < 9


def test_the_divergence_of_a_wrong_output(ran: Ran) -> None:
    starts = {
        # The last value of the reconstruction is the colour network's last bias.
        "last-bit": "weights: colour, layer 1, bias ",
        "first-bit": "head: the eight bytes is 42 33",
        "digest-bit": "digests: that of the weights is ",
        "short": "weights: the part is",
        "long": "end: the output is",
        "accepts": "head: the part is 8 bytes, 60 bytes expected",
    }
    for mode, start in starts.items():
        (line,) = ran.entries[f"valid-{mode}"]["divergence"]
        assert line.startswith(start)


# The parent may ignore signals: a shell does so for background processes.
PROGRAM = """
import signal
from conformance.cli import main
signal.signal(signal.SIGINT, signal.default_int_handler)
signal.signal(signal.SIGHUP, signal.SIG_DFL)
exit(main())
"""


@pytest.mark.parametrize(("number", "serve"), [(signal.SIGINT, []), (signal.SIGTERM, ["--serve"]), (signal.SIGHUP, [])])
def test_an_interrupted_run(tmp_path: Path, number: signal.Signals, serve: list[str]) -> None:
    """It leaves a report of the vectors so far, but no process and no folder."""
    for name in ("suite", "answers", "temporary"):
        (tmp_path / name).mkdir()
    # The vector with the smallest budget comes last. Its decoder waits for a child.
    last = "late" if serve else "hang-in-child"
    suite = build(tmp_path / "suite", tmp_path / "answers", modes([last, "right"], ["right"]), {last: {"seconds": 9}})
    decoder = [sys.executable, "-S", "-E", str(FAKE), "listed", str(suite.answers)]
    decoder += [] if serve else ["{input}", "{output}"]
    words = ["run", "--vectors", str(suite.folder), "--jobs", "1", "--slow", "100", "--report", str(tmp_path)]
    mark = str(uuid.uuid4().int)
    command = [sys.executable, "-c", PROGRAM, *words, *serve, "--", *decoder]
    variables = {**os.environ, "C3GS_TEST_MARK": mark, "TMPDIR": str(tmp_path / "temporary")}
    program = subprocess.Popen(command, cwd=ROOT, env=variables, stdout=subprocess.PIPE, text=True)
    end = time.monotonic() + 60
    while len(processes(mark)) < 3:
        assert time.monotonic() < end
        time.sleep(0.1)
    program.send_signal(number)
    out, _ = program.communicate(timeout=20)
    assert program.returncode == statuses.INTERRUPTED
    assert "interrupted" in out
    record = json.loads((tmp_path / "report.json").read_text())
    assert (record["runner"]["interrupted"], record["verdict"]["conforms"]) == (True, False)
    assert {v["id"] for v in record["vectors"]} == {"valid-right", "invalid-right"}
    assert processes(mark) == []
    assert list((tmp_path / "temporary").iterdir()) == []


# --- documents of others ----------------------------------------------------------------------------------------------

# tests/files/test_documents.py has the other ways in which a document can be wrong.
DOCUMENTS: dict[str, bytes] = {
    "deep": b"[" * 100_000,
    "not-utf-8": b'{"name": "caf\xe9"}',
    "half-of-a-pair": b'{"name": "\\ud800", "\\u001b]0;x\\u0007": 1}',
    "another-kind": b'{"name": ["' + b"x" * 100_000 + b'"]}',
    "empty": b"",
}


@pytest.mark.parametrize("kind", DOCUMENTS)
def test_documents_of_others(suite: Suite, tmp_path: Path, capsys: pytest.CaptureFixture[str], kind: str) -> None:
    """A document of another kind is not a fault of the program: one line, and the status of its kind."""
    path, other = tmp_path / "document.json", tmp_path / "suite"
    path.write_bytes(DOCUMENTS[kind])
    other.mkdir()
    shutil.copy(path, other / "manifest.json")
    vectors, decoder = ["--vectors", str(suite.folder)], ["--", "true", "{input}", "{output}"]
    commands = [
        (["verify-report", *vectors, str(path), *decoder], statuses.USAGE),
        (["run", *vectors, "--describe", str(path), *decoder], statuses.USAGE),
        (["run", "--vectors", str(other), *decoder], statuses.DAMAGED_SUITE),
        (["selftest", "--manifest", str(other / "manifest.json")], statuses.DAMAGED_SUITE),
        (["run", *vectors, "--known-failures", str(path), *decoder], statuses.USAGE),
    ]
    for words, status in commands[: 4 if kind == "empty" else 5]:
        assert cli.main(words) == status, words[0]
        out, err = capsys.readouterr()
        assert (out, err.count("\n")) == ("", 1), words[0]
        assert len(err) < 1000
        assert printable(err)


def test_a_report_that_steers(suite: Suite, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    _, record = suite.report("right", tmp_path, "--select", "class:valid")
    steers = "\x1b[31m" * 1000
    changes: list[tuple[Callable[[dict[str, Any]], object], int]] = [
        (lambda r: r["suite"].update(version=steers, manifest_sha256="0" * 64), statuses.DAMAGED_SUITE),
        (lambda r: r["vectors"][0].update(id="\x1b[31m"), statuses.USAGE),
        (lambda r: r["vectors"][0]["found"].update(text=steers), statuses.REJECTED),
        (lambda r: r.update({steers: 1}), statuses.USAGE),
    ]
    for change, status in changes:
        other = json.loads(json.dumps(record))
        change(other)
        (tmp_path / "other.json").write_text(json.dumps(other))
        capsys.readouterr()
        words = ["verify-report", "--vectors", str(suite.folder), str(tmp_path / "other.json"), "--"]
        assert cli.main([*words, *suite.command("right")]) == status
        text = "".join(capsys.readouterr())
        assert 0 < len(text) < 2000
        assert printable(text)
