"""The runner with decoders that go wrong in known ways: it must find each, and nothing else."""

from __future__ import annotations

import json
import os
import shlex
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import jsonschema
import pytest
from small_suite import Suite

from conformance import cli
from conformance.cli import running
from conformance.manifest import MANIFEST, load
from conformance.report import summary
from conformance.runner import fluster, process
from conformance.runner import run as runner
from refcodec import statuses
from refcodec.bitstream import codec
from refcodec.bitstream.errors import REGISTRY

ROOT = Path(__file__).resolve().parents[2]


def by_vector(record: dict[str, Any]) -> dict[str, str]:
    return {v["id"]: v["status"] for v in record["vectors"]}


GOOD, BAD = (
    ("valid-plain", "valid-extended"),
    ("malformed-crc", "invalid-up-axis", "unsupported-profile", "resource-anchors"),
)


def test_the_files_are_what_they_are_called(suite: Suite) -> None:
    classes = {v.id: v.expectation for v in load(suite.folder / MANIFEST).vectors}
    assert {name: REGISTRY[classes[name].name].klass for name in BAD} == {  # type: ignore[union-attr]
        "malformed-crc": "malformed",
        "invalid-up-axis": "invalid",
        "unsupported-profile": "unsupported",
        "resource-anchors": "invalid",
    }


def test_a_right_decoder(suite: Suite, tmp_path: Path) -> None:
    for mode in ("right", "talks-much", "leaves-child"):
        status, record = suite.report(mode, tmp_path)
        assert status == statuses.DONE
        assert set(by_vector(record).values()) == {"passed"}
        assert record["verdict"] == {
            "conforms": True, "grade": 3, "not_run": 0,
            "counts": {"failed": 0, "crashed": 0, "unexpected": 0, "known": 0, "passed": 6, "skipped": 0},
        }  # fmt: skip
        assert [row["verdict"] for row in record["profiles"]] == ["conforms"]
        assert record["requirements"] == {"R6.2-1": {"vectors": 6, "run": 6, "right": 6}}


# A mode, and what it is to the good and to the bad files: status and grade.
WRONG = [
    ("raises", ("crashed", 0), ("crashed", 0)),
    ("nothing", ("crashed", 0), ("crashed", 0)),
    ("accepts", ("failed", 0), ("failed", 0)),
    ("segfault", ("crashed", 0), ("crashed", 0)),
    ("segfault-after-json", ("crashed", 0), ("crashed", 0)),
    ("json-exit-0", ("passed", 3), ("crashed", 0)),
    ("right-exit-1", ("crashed", 0), ("passed", 3)),
    ("json-and-output", ("failed", 0), ("passed", 3)),
    ("exit-3", ("passed", 3), ("crashed", 0)),
    ("giant", ("crashed", 0), ("crashed", 0)),
    ("giant-sparse", ("crashed", 0), ("crashed", 0)),
    ("unregistered", ("passed", 3), ("crashed", 0)),
    ("code-as-text", ("passed", 3), ("crashed", 0)),
    ("code-true", ("passed", 3), ("crashed", 0)),
    ("json-then-text", ("passed", 3), ("crashed", 0)),
    ("json-list", ("passed", 3), ("crashed", 0)),
    ("json-deep", ("passed", 3), ("crashed", 0)),
    ("no-offset", ("passed", 3), ("failed", 2)),
    ("offset-1", ("passed", 3), ("failed", 2)),
    ("last-bit", ("failed", 0), ("passed", 3)),
    ("first-bit", ("failed", 0), ("passed", 3)),
    ("digest-bit", ("failed", 0), ("passed", 3)),
    ("short", ("failed", 0), ("passed", 3)),
    ("long", ("failed", 0), ("passed", 3)),
]


@pytest.mark.parametrize(("mode", "good", "bad"), WRONG, ids=[row[0] for row in WRONG])
def test_a_wrong_decoder(suite: Suite, tmp_path: Path, mode: str, good: tuple[str, int], bad: tuple[str, int]) -> None:
    status, record = suite.report(mode, tmp_path)
    assert status == statuses.REJECTED
    found = {v["id"]: (v["status"], v["grade"]) for v in record["vectors"]}
    assert found == dict.fromkeys(GOOD, good) | dict.fromkeys(BAD, bad)
    assert not record["verdict"]["conforms"]
    assert record["verdict"]["grade"] == min(good[1], bad[1])
    assert record["profiles"][0]["verdict"] == "fails"
    assert all(v["text"] for v in record["vectors"] if v["status"] != "passed")


def test_one_code_for_everything(suite: Suite, tmp_path: Path) -> None:
    """Its only right answer is the file of that code; others are refused, which is grade 1."""
    status, record = suite.report("rejects", tmp_path)
    assert status == statuses.REJECTED
    grades = dict.fromkeys(GOOD, 0) | dict.fromkeys(BAD, 1) | {"malformed-crc": 3}
    assert {v["id"]: v["grade"] for v in record["vectors"]} == grades


def test_ancillary_sections(suite: Suite, tmp_path: Path) -> None:
    status, record = suite.report("no-ancillary", tmp_path)
    assert status == statuses.REJECTED
    assert by_vector(record) == {**dict.fromkeys((*GOOD, *BAD), "passed"), "valid-extended": "failed"}
    (failed,) = [v for v in record["vectors"] if v["status"] == "failed"]
    assert "302" in failed["text"]
    # The bytes at which the decoder says the fault is.
    assert [line.startswith("> 000000d8 ") for line in failed["hex"] if line.startswith(">")] == [True]


@pytest.mark.parametrize(
    ("mode", "grades"),
    [
        ("other-code", {1: 0, 2: 1, 3: 1}),
        ("always-exit-1", {1: 0, 2: 1, 3: 1}),
        ("offset-1", {1: 0, 2: 0, 3: 1}),
        ("no-offset", {1: 0, 2: 0, 3: 1}),
    ],
)
def test_grades(suite: Suite, mode: str, grades: dict[int, int]) -> None:
    for grade, status in grades.items():
        assert suite.run(mode, "--grade", str(grade)) == status


def _shrunk(suite: Suite, folder: Path, seconds: int, memory: int) -> Suite:
    """The suite's first vector alone, with another budget."""
    shutil.copytree(suite.folder, folder)
    manifest = json.loads((folder / MANIFEST).read_text())
    manifest["vectors"] = [{**manifest["vectors"][0], "budget": {"seconds": seconds, "bytes": memory}}]
    (folder / MANIFEST).write_text(json.dumps(manifest))
    return Suite(folder, suite.answers)


@pytest.mark.parametrize("mode", ["hang", "hang-in-child", "spins"])
def test_time_is_bounded(suite: Suite, tmp_path: Path, mode: str) -> None:
    small = _shrunk(suite, tmp_path / "suite", 1, 256 << 20)
    began = time.monotonic()
    # One that waits is given ten times its budget.
    status, record = small.report(mode, tmp_path, "--slow", "1" if mode == "spins" else "0.1")
    assert status == statuses.REJECTED
    (vector,) = record["vectors"]
    assert (vector["status"], vector["text"]) == ("crashed", "crash: took too long")
    assert 1 <= vector["seconds"] <= time.monotonic() - began < 60
    # --slow gives a slow machine more time.
    assert small.run("right", "--slow", "30") == statuses.DONE


@pytest.mark.parametrize("mode", ["memory", "memory-in-child"])
def test_memory_is_bounded(suite: Suite, tmp_path: Path, mode: str) -> None:
    status, record = _shrunk(suite, tmp_path / "suite", 30, 64 << 20).report(mode, tmp_path)
    assert status == statuses.REJECTED
    assert record["vectors"][0]["text"] == "crash: took too much memory"


def test_stderr_is_bounded(suite: Suite, tmp_path: Path) -> None:
    status, record = _shrunk(suite, tmp_path / "suite", 30, 256 << 20).report("floods-stderr", tmp_path)
    assert (status, record["vectors"][0]["status"]) == (statuses.REJECTED, "crashed")
    assert len(record["vectors"][0]["stderr"]) < 5000


def test_children_do_not_outlive_the_decoder(tmp_path: Path) -> None:
    mark = tmp_path / "mark"
    command = ["/bin/sh", "-c", f"(sleep 0.5; touch {mark}) & exit 0"]
    with closing(process.Watcher()) as watcher:
        watcher.run(command, 10, 1 << 30, threading.Event())
    time.sleep(1)
    assert not mark.exists()


def test_what_diverges(suite: Suite, tmp_path: Path) -> None:
    _, record = suite.report("last-bit", tmp_path)
    vector = record["vectors"][0]
    # The last value of the reconstruction is the colour network's last bias.
    assert vector["divergence"] == [
        line for line in vector["divergence"] if line.startswith("weights: colour, layer 1, bias ")
    ]
    assert len(vector["divergence"]) == 1
    assert "1 of" in vector["divergence"][0]
    lines = {
        mode: suite.report(mode, tmp_path)[1]["vectors"][0]["divergence"]
        for mode in ("first-bit", "digest-bit", "short", "long", "accepts")
    }
    assert lines["first-bit"][0].startswith("head: the eight bytes is 42 33")
    assert lines["digest-bit"][0].startswith("digests: that of the weights is ")
    assert "weights: the part is" in lines["short"][0]
    assert lines["long"][0].startswith("end: the output is")
    assert lines["accepts"][0].startswith("head: the part is 8 bytes, 28 bytes expected")


def test_traces(suite: Suite, tmp_path: Path) -> None:
    assert suite.run("right", "--trace", trace=True) == statuses.DONE
    # Without --trace a trace explains and does not decide.
    assert suite.run("wrong-trace", trace=True) == statuses.DONE
    status, record = suite.report("wrong-trace", tmp_path, "--trace", trace=True)
    assert status == statuses.REJECTED
    vector = record["vectors"][0]
    (line,) = vector["divergence"]
    assert line.startswith("trace: planes.r1[0,0,0] is ")
    assert "rightly of the model laplace, mean " in line
    assert line.endswith("read 7.3, 7.2")
    assert [line.split()[6] for line in vector["hex"] if line.startswith("> ")] == ["planes.r1.symbol_crc"]
    status, record = suite.report("no-trace", tmp_path, "--trace", trace=True)
    assert [v["status"] for v in record["vectors"][:2]] == ["failed", "failed"]
    assert suite.run("right", "--trace") == statuses.USAGE


def test_known_failures(suite: Suite, tmp_path: Path) -> None:
    known = tmp_path / "known"
    known.write_text("# those two\nvalid-plain   # a comment\n\nvalid-extended\n")
    status, record = suite.report("last-bit", tmp_path, "--known-failures", str(known))
    assert status == statuses.DONE
    assert record["verdict"]["counts"]["known"] == 2
    assert not record["verdict"]["conforms"]
    status, record = suite.report("no-ancillary", tmp_path, "--known-failures", str(known))
    assert status == statuses.REJECTED
    assert by_vector(record)["valid-plain"] == "unexpected"
    assert by_vector(record)["valid-extended"] == "known"
    known.write_text("valid-plian\n")
    assert suite.run("right", "--known-failures", str(known)) == statuses.USAGE


def test_a_damaged_suite(suite: Suite, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    def damaged(name: str, change: Callable[[Path], object]) -> int:
        folder = tmp_path / name
        shutil.copytree(suite.folder, folder)
        change(folder)
        return Suite(folder, suite.answers).run("right", "--select", "valid-plain")

    plain = Path("valid") / "plain.c3gs"
    assert damaged("same", lambda folder: None) == statuses.DONE
    assert damaged("byte", lambda folder: (folder / plain).write_bytes(b"other")) == statuses.DAMAGED_SUITE
    assert "valid/plain.c3gs" in capfd.readouterr().err
    assert damaged("missing", lambda folder: (folder / plain).unlink()) == statuses.DAMAGED_SUITE
    assert damaged("manifest", lambda folder: (folder / MANIFEST).write_text("{}")) == statuses.DAMAGED_SUITE
    assert damaged("none", lambda folder: (folder / MANIFEST).unlink()) == statuses.DAMAGED_SUITE


def test_a_decoder_that_changes_the_suite(suite: Suite, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What it is given is a copy; the suite itself is looked at again at the end."""
    shutil.copytree(suite.folder, tmp_path / "suite")
    other = Suite(tmp_path / "suite", suite.answers)
    status, record = other.report("changes-input", tmp_path)
    assert status == statuses.REJECTED
    assert {v["text"] for v in record["vectors"]} == {"crash: changed its input"}
    monkeypatch.setenv("FAKE_DECODER_CHANGES", str(tmp_path / "suite" / "valid" / "plain.c3gs"))
    assert other.run("changes-suite") == statuses.DAMAGED_SUITE


def test_nothing_selected_is_a_failure(suite: Suite) -> None:
    assert suite.run("right", "--select", "class:none-such") == statuses.NOTHING
    assert suite.run("right", "--select", "clas:valid") == statuses.USAGE


@pytest.mark.parametrize(
    ("expressions", "expected"),
    [
        (["class:valid"], GOOD),
        (["*-plain"], ("valid-plain",)),
        (["class:valid,malformed !id:*plain"], ("valid-extended", "malformed-crc")),
        (["code:1*,205"], ("malformed-crc", "unsupported-profile")),
        (["profile:none", "class:resource"], ("malformed-crc", "resource-anchors")),
        (["profile:tiny level:0 !class:valid"], ("invalid-up-axis", "unsupported-profile", "resource-anchors")),
        (["feature:head* requirement:R6.2-? !flag:*"], (*GOOD, *BAD)),
    ],
)
def test_selection(suite: Suite, tmp_path: Path, expressions: list[str], expected: tuple[str, ...]) -> None:
    options = [word for expression in expressions for word in ("--select", expression)]
    status, record = suite.report("right", tmp_path, *options)
    assert status == statuses.DONE
    assert tuple(by_vector(record)) == expected
    assert record["verdict"]["not_run"] == 6 - len(expected)
    assert record["profiles"][0]["verdict"] == ("conforms" if len(expected) == 6 else "incomplete")


def test_usage(suite: Suite) -> None:
    def run(*words: str) -> int:
        return cli.main(["run", "--vectors", str(suite.folder), *words])

    assert run("--", "no-such-program", "{input}", "{output}") == statuses.USAGE
    assert run("--", "true", "{input}") == statuses.USAGE
    assert run("--gaussians", "true {input} {output}", "--", "true", "{input}", "{output}") == statuses.USAGE
    assert run("--describe", "no-such-file", "--", "true", "{input}", "{output}") == statuses.USAGE
    assert run("--jobs", "0", "--", "true", "{input}", "{output}") == statuses.USAGE
    assert run("--help") == statuses.DONE


def test_description(suite: Suite, tmp_path: Path) -> None:
    about = tmp_path / "about.json"
    about.write_text('{"name": "mydecoder", "version": "1.2", "language": "C++"}')
    _, record = suite.report("right", tmp_path, "--describe", str(about))
    assert record["decoder"]["description"] == {"name": "mydecoder", "version": "1.2", "language": "C++"}
    for text in ('{"name": "mydecoder"}', '{"name": "a", "version": "1", "colour": "red"}', "nothing"):
        about.write_text(text)
        assert suite.run("right", "--describe", str(about)) == statuses.USAGE


# A server of the suite's files by mode: the right answers, with one fault.
SERVER = """
import hashlib, json, os, sys, time
mode, answers = sys.argv[1], json.load(open(sys.argv[2]))
for line in sys.stdin:
    q = json.loads(line)
    a = answers[hashlib.sha256(open(q["input"], "rb").read()).hexdigest()]
    if a["exit"]:
        said = {"status": a["exit"], "stderr": json.dumps({"code": a["code"], "offset": a["offset"]})}
    else:
        open(q["output"], "wb").write(open(a["output"], "rb").read())
        said = {"status": 0}
        if mode == "dies": os.abort()
        if mode == "sleeps": time.sleep(600)
        if mode == "leaves": sys.exit(0)
        if mode == "eats": held = [bytes(8 << 20) + b"x" for _ in range(100)]
        if mode == "signal": said = {"signal": 11}
        if mode == "both": said = {"signal": 11, "status": 0}
        if mode == "text": said = {"status": "0"}
        if mode == "nothing": os.unlink(q["output"])
    text = json.dumps(said)
    if not a["exit"]:
        if mode == "garbage": text = "accepted"
        if mode == "list": text = "[0]"
        if mode == "endless": text = " " * (1 << 22) + text
        if mode == "wrong": open(q["output"], "ab").write(b"x")
    print(text, flush=True)
"""


@pytest.mark.parametrize(
    ("mode", "text"),
    [
        ("right", ""),
        ("dies", "crash: ended by SIGABRT"),
        pytest.param("sleeps", "crash: took too long", marks=pytest.mark.slow),
        ("leaves", "crash: gave an answer that cannot be read"),
        ("eats", "crash: took too much memory"),
        ("signal", "crash: ended by SIGSEGV"),
        ("nothing", "crash: exit status 0 without an output file"),
        ("wrong", "the output is not the canonical reconstruction"),
        *(
            (mode, "crash: gave an answer that cannot be read")
            for mode in ("both", "text", "garbage", "list", "endless")
        ),
    ],
)
def test_a_decoder_that_serves(suite: Suite, tmp_path: Path, mode: str, text: str) -> None:
    """One that does not survive a file is started again for the next."""
    script = tmp_path / "server.py"
    script.write_text(SERVER)
    command = [sys.executable, "-S", "-E", str(script), mode, str(suite.answers)]
    slow = "0.1" if mode == "sleeps" else "20"
    options = ["--vectors", str(suite.folder), "--jobs", "2", "--slow", slow, "--report", str(tmp_path), "--serve"]
    assert cli.main(["run", *options, "--", *command]) == (statuses.REJECTED if text else statuses.DONE)
    record = json.loads((tmp_path / "report.json").read_text())
    assert {v["id"]: v["text"] for v in record["vectors"]} == dict.fromkeys(GOOD, text) | dict.fromkeys(BAD, "")


@pytest.mark.parametrize("name", ["refcodec", "spec_decoder"])
def test_the_decoders_serve(suite: Suite, name: str) -> None:
    options = ["--vectors", str(suite.folder), "--jobs", "1", "--slow", "20", "--serve"]
    assert (
        cli.main(["run", *options, "--trace", "--", sys.executable, "-m", "conformance.runner.serve", name])
        == statuses.DONE
    )


# --- reports ----------------------------------------------------------------------------------------------------------


def test_junit(suite: Suite, tmp_path: Path) -> None:
    suite.report("no-ancillary", tmp_path)
    root = ElementTree.parse(tmp_path / "report.xml").getroot()
    assert [(s.get("name"), s.get("tests"), s.get("failures"), s.get("errors")) for s in root] == [
        ("valid", "2", "1", "0"),
        ("malformed", "1", "0", "0"),
        ("invalid", "1", "0", "0"),
        ("unsupported", "1", "0", "0"),
        ("resource", "1", "0", "0"),
    ]
    suite.report("segfault", tmp_path)
    root = ElementTree.parse(tmp_path / "report.xml").getroot()
    assert sum(int(s.get("errors", 0)) for s in root) == 6
    assert [e.get("message") for e in root.iter("error")] == ["crash: ended by SIGSEGV"] * 6


def test_the_page(suite: Suite, tmp_path: Path) -> None:
    suite.report("last-bit", tmp_path)
    page = (tmp_path / "report.html").read_text()
    assert "colour, layer 1, bias" in page
    # What failed comes first, and nothing is loaded from anywhere.
    assert page.index('data-status="failed"') < page.index('data-status="passed"')
    assert not any(word in page for word in ("http:", "https:", "src=", "<link", "@import", "url("))


def test_text_of_a_decoder_is_shown_as_text(suite: Suite, tmp_path: Path) -> None:
    about = tmp_path / "about.json"
    about.write_text(json.dumps({"name": "<script>alert(1)</script>", "version": "\x01\x1b[31m & <b>"}))
    suite.report("raises", tmp_path, "--describe", str(about))
    assert "<script>alert" not in (tmp_path / "report.html").read_text()
    ElementTree.parse(tmp_path / "report.xml")


def test_the_record_has_a_strict_schema(suite: Suite, tmp_path: Path) -> None:
    from conformance.report.schema import RECORD  # noqa: PLC0415

    _, record = suite.report("no-ancillary", tmp_path)
    schema = json.loads(json.dumps(RECORD))
    jsonschema.Draft202012Validator.check_schema(schema)

    def objects(value: Any) -> Iterator[dict[str, Any]]:
        for inner in value.values() if isinstance(value, dict) else value if isinstance(value, list) else ():
            yield from objects(inner)
        if isinstance(value, dict) and value.get("type") == "object":
            yield value

    assert all("additionalProperties" in o for o in objects(schema))
    for broken in ({**record, "more": 1}, {k: v for k, v in record.items() if k != "verdict"}):
        with pytest.raises(jsonschema.ValidationError):
            jsonschema.validate(broken, schema)


def test_verify_report(suite: Suite, tmp_path: Path) -> None:
    def verify(mode: str, change: Callable[[dict[str, Any]], object] = lambda record: None) -> int:
        record = json.loads((tmp_path / "report.json").read_text())
        change(record)
        (tmp_path / "other.json").write_text(json.dumps(record))
        return cli.main(
            ["verify-report", "--vectors", str(suite.folder), str(tmp_path / "other.json"), "--", *suite.command(mode)]
        )

    suite.report("no-ancillary", tmp_path, "--select", "class:valid,malformed")
    assert verify("no-ancillary") == statuses.DONE
    assert verify("right") == statuses.REJECTED
    # A record that was embellished: its verdict, one of its vectors, or both.
    better = {"conforms": True, "grade": 3}
    assert verify("no-ancillary", lambda r: r["verdict"].update(better)) == statuses.REJECTED
    assert verify("no-ancillary", lambda r: r["vectors"][1].update(status="passed", grade=3)) == statuses.REJECTED
    assert verify("no-ancillary", lambda r: r["vectors"].pop()) == statuses.REJECTED
    assert verify("no-ancillary", lambda r: r["vectors"].append(r["vectors"][0])) == statuses.USAGE
    assert verify("no-ancillary", lambda r: r.update(more=1)) == statuses.USAGE
    assert verify("no-ancillary", lambda r: r["suite"].update(manifest_sha256="0" * 64)) == statuses.DAMAGED_SUITE
    assert verify("no-ancillary", lambda r: r["vectors"].clear()) == statuses.NOTHING


# A shell starts what runs in the background with the signal ignored.
PROGRAM = """
import signal
from conformance.cli import main
signal.signal(signal.SIGINT, signal.default_int_handler)
exit(main())
"""


def test_an_interrupted_run_leaves_a_report(suite: Suite, tmp_path: Path) -> None:
    shutil.copytree(suite.folder, tmp_path / "suite")
    manifest = json.loads((tmp_path / "suite" / MANIFEST).read_text())
    # The one that hangs comes last.
    manifest["vectors"][0]["budget"]["seconds"] = 5
    (tmp_path / "suite" / MANIFEST).write_text(json.dumps(manifest))
    script = tmp_path / "decoder.sh"
    quick = " ".join(Suite(tmp_path / "suite", suite.answers).command("right")[:-2])
    others = f'{quick} "$1" "$2"; s=$?; touch {tmp_path}/one; exit $s'
    slow = suite.folder / "valid" / "plain.c3gs"
    script.write_text(f'if cmp -s "$1" {slow}; then sleep 60; else {others}; fi\n')
    command = [sys.executable, "-c", PROGRAM, "run", "--vectors", str(tmp_path / "suite"), "--jobs", "2"]
    command += ["--slow", "100", "--report", str(tmp_path / "report")]
    command += ["--", "sh", str(script), "{input}", "{output}"]
    running = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True, start_new_session=True)
    end = time.monotonic() + 60
    while not (tmp_path / "one").exists() and time.monotonic() < end:
        time.sleep(0.05)
    # Until the runner has seen its end.
    time.sleep(1)
    os.kill(running.pid, signal.SIGINT)
    out, _ = running.communicate(timeout=20)
    assert running.returncode == statuses.INTERRUPTED
    record = json.loads((tmp_path / "report" / "report.json").read_text())
    assert record["runner"]["interrupted"]
    assert "valid-plain" not in by_vector(record)
    assert len(record["vectors"]) >= 1
    assert not record["verdict"]["conforms"]
    assert "interrupted" in out


def test_the_anchor_of_a_divergence_is_named(suite: Suite, tmp_path: Path) -> None:
    """Also where the output differs as well."""
    _, record = suite.report("accepts", tmp_path)
    vector = next(v for v in record["vectors"] if v["status"] == "failed")
    for lines, form in (
        (
            ["features: anchor 3 (chunk 0) is 1, 2 expected", "trace: attributes.features[7,2] is 3, 6 expected"],
            "--anchor 7",
        ),
        (["trace: planes.r1[0,0,0] is 1, 0 expected"], "--hex"),
        ([], "--hex"),
    ):
        record["vectors"] = [{**vector, "divergence": lines}]
        path = os.path.relpath(suite.folder / vector["input"])
        wanted = f"refcodec inspect {shlex.join([path])} {form}"
        assert [line for line in summary.lines(record, suite.folder) if line.endswith(wanted)]


def test_a_missing_package_is_told(suite: Suite) -> None:
    program = "import sys; sys.modules['jsonschema'] = None; from conformance.cli import main; sys.exit(main())"
    done = subprocess.run([sys.executable, "-c", program, "run"], capture_output=True, text=True, cwd=ROOT, check=False)
    assert done.returncode == statuses.USAGE
    assert done.stderr.startswith("conformance: jsonschema is not installed: pip install")
    assert done.stderr.count("\n") == 1


def test_a_fault_of_our_own(suite: Suite, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    def broken(*_: object) -> None:
        raise ZeroDivisionError("a bug\nin two lines")

    monkeypatch.setattr(running, "select", broken)
    monkeypatch.delenv("REFCODEC_DEBUG", raising=False)
    assert suite.run("right") == statuses.FAULT
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert "please report it" in err
    assert "(ZeroDivisionError: a bug in two lines)" in err
    monkeypatch.setenv("REFCODEC_DEBUG", "1")
    with pytest.raises(ZeroDivisionError):
        suite.run("right")


def test_a_reader_that_goes_away(suite: Suite, tmp_path: Path) -> None:
    command = shlex.join(
        [sys.executable, "-m", "conformance", "check-encoder", *[str(suite.folder / "valid" / "plain.c3gs")] * 40]
    )
    done = subprocess.run(
        f"{{ {command}; echo $? >{tmp_path / 'status'}; }} | :",
        shell=True,
        check=False,
        cwd=ROOT,
        capture_output=True,
        text=True,
    )
    assert done.stderr == ""
    assert int((tmp_path / "status").read_text()) == statuses.BROKEN_PIPE


def test_peaks_are_not_the_runners_own() -> None:
    """The memory of whoever starts a process is not taken for its own."""
    ballast = bytearray(os.urandom(1 << 20)) * 300
    with closing(process.Watcher()) as watcher:
        ended = watcher.run(["true"], 10, 100 << 20, threading.Event())
    assert len(ballast) > 100 << 20
    assert (ended.over, ended.peak) == (None, None)


# --- other runners, other encoders ------------------------------------------------------------------------------------


@pytest.mark.parametrize(("kind", "right"), [("right", 2), ("accepts", 0)])
def test_fluster(suite: Suite, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str, right: int) -> None:
    """Fluster itself runs what is exported."""
    assert cli.main(["export", "--vectors", str(suite.folder), "--fluster", str(tmp_path / "suite")]) == 0
    monkeypatch.setenv("C3GS_DECODER", " ".join(suite.command(kind)))
    options = ["--output", str(tmp_path / "out"), "run", "-ts", fluster.SUITE, "-d", "C3GS"]
    command = [sys.executable, str(tmp_path / "suite" / "run.py"), *options]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert f"Ran {right}/2 tests successfully" in done.stdout, done.stdout + done.stderr


def test_check_encoder(
    suite: Suite, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    good, bad = (
        [str(suite.folder / "valid" / f"{n}.c3gs") for n in ("plain", "extended")],
        str(suite.folder / "invalid" / "up-axis.c3gs"),
    )
    assert cli.main(["check-encoder", *good]) == statuses.DONE
    assert cli.main(["check-encoder", *good, bad]) == statuses.REJECTED
    assert "214 header.render_info" in capsys.readouterr().out
    assert cli.main(["check-encoder", str(tmp_path / "none")]) == statuses.USAGE
    emit = codec.emit
    monkeypatch.setattr(codec, "emit", lambda scene: emit(scene)[:-1])
    assert cli.main(["check-encoder", good[0]]) == statuses.REJECTED
    assert "not canonical" in capsys.readouterr().out


def test_hashes_are_of_each_file(suite: Suite) -> None:
    manifest = load(suite.folder / MANIFEST)
    assert runner.wrong_hashes(manifest) == []
    moved = replace(manifest, folder=suite.folder / "valid")
    assert len(runner.wrong_hashes(moved)) == 6
