"""The commands of the suite on a small suite: selections, grades, traces, known failures, reports and other runners.

test_hostile_decoders.py has the verdicts on decoders that fail.
"""

import json
import os
import resource
import shlex
import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import psutil
import pytest
from small_suite import Suite

from conformance import cli
from conformance.cli import running
from conformance.manifest import MANIFEST, load
from conformance.report import summary
from conformance.report.record import RecordError, check
from conformance.runner import process
from conformance.runner import run as runner
from conformance.runner.folder import Folder
from refcodec import statuses
from refcodec.bitstream import codec
from refcodec.bitstream.errors import REGISTRY

ROOT = Path(__file__).resolve().parents[2]


def by_vector(record: dict[str, Any]) -> dict[str, str]:
    return {v["id"]: v["status"] for v in record["vectors"]}


GOOD = "valid-plain", "valid-extended"
BAD = "malformed-crc", "invalid-up-axis", "unsupported-profile", "resource-anchors"


def test_the_files_are_what_they_are_called(suite: Suite) -> None:
    classes = {v.id: v.expectation for v in load(suite.folder / MANIFEST).vectors}
    assert [REGISTRY[classes[name].name].klass for name in BAD] == ["malformed", "invalid", "unsupported", "invalid"]


def test_a_right_decoder(suite: Suite, tmp_path: Path) -> None:
    status, record = suite.report("right", tmp_path)
    assert status == statuses.DONE
    assert set(by_vector(record).values()) == {"passed"}
    counts = {"failed": 0, "crashed": 0, "unexpected": 0, "known": 0, "passed": 6, "skipped": 0}
    assert record["verdict"] == {"conforms": True, "grade": 3, "not_run": 0, "counts": counts}
    assert [row["verdict"] for row in record["profiles"]] == ["conforms"]
    assert record["requirements"] == {"R6.2-1": {"vectors": 6, "run": 6, "right": 6}}


def test_ancillary_sections(suite: Suite, tmp_path: Path) -> None:
    status, record = suite.report("no-ancillary", tmp_path)
    assert status == statuses.REJECTED
    assert by_vector(record) == {**dict.fromkeys((*GOOD, *BAD), "passed"), "valid-extended": "failed"}
    (failed,) = [v for v in record["vectors"] if v["status"] == "failed"]
    assert "302" in failed["text"]
    # The bytes at the offset that the decoder reported.
    assert [line.startswith("> 000000d8 ") for line in failed["hex"] if line.startswith(">")] == [True]
    assert record["diagnosis"]["text"] == ["the decoder refuses 1 valid files, in their header (1)"]


@pytest.mark.parametrize(("mode", "statuses_"), [("other-code", (0, 1)), ("exit-1", (0, 1)), ("offset-1", (0, 0, 1))])
def test_grades(suite: Suite, mode: str, statuses_: tuple[int, ...]) -> None:
    for grade, status in enumerate(statuses_, 1):
        assert suite.run(mode, "--grade", str(grade), "--select", "!class:valid") == status


def test_traces(suite: Suite, tmp_path: Path) -> None:
    assert suite.run("right", "--trace", trace=True) == statuses.DONE
    # Without --trace a trace explains and does not decide.
    assert suite.run("wrong-trace", trace=True) == statuses.DONE
    status, record = suite.report("wrong-trace", tmp_path, "--trace", trace=True)
    assert status == statuses.REJECTED
    vector = record["vectors"][0]
    (line,) = vector["divergence"]
    assert line.startswith("trace: planes.r1[0,0,0] is ")
    assert "the right model is laplace, mean " in line
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
    """Its input is a copy. The suite itself is verified again at the end."""
    shutil.copytree(suite.folder, tmp_path / "suite")
    other = Suite(tmp_path / "suite", suite.answers)
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
        (["code:1*,205 !minor_at_most:*"], ("malformed-crc", "unsupported-profile")),
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
    text = "\n".join(summary.lines(check(record), suite.folder))
    said = [words in text for words in (f"; {len(expected)} of 6 vectors run", "no output was tested")]
    assert said == [len(expected) < 6, not set(expected) & set(GOOD)]
    assert "1 of 1 tested are right in every vector run" in text


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


@pytest.mark.parametrize("name", ["refcodec", "spec_decoder"])
def test_the_decoders_serve(suite: Suite, name: str) -> None:
    options = ["--vectors", str(suite.folder), "--jobs", "1", "--slow", "20", "--serve", "--trace"]
    decoder = [sys.executable, "-m", "conformance.runner.serve", name]
    assert cli.main(["run", *options, "--", *decoder]) == statuses.DONE


# --- reports ----------------------------------------------------------------------------------------------------------


def test_the_page(suite: Suite, tmp_path: Path) -> None:
    """Texts of a decoder are shown as text. What failed comes first, and nothing is loaded from anywhere."""
    about = tmp_path / "about.json"
    about.write_text(json.dumps({"name": "<script>alert(1)</script>", "version": "\x01\x1b[31m & <b>"}))
    suite.report("last-bit", tmp_path, "--describe", str(about))
    page = (tmp_path / "report.html").read_text()
    assert "colour, layer 1, bias" in page
    assert "<script>alert" not in page
    assert page.index('data-status="failed"') < page.index('data-status="passed"')
    assert not any(word in page for word in ("http:", "https:", "src=", "<link", "@import", "url("))


def test_a_record_has_all_its_members_and_no_other(suite: Suite, tmp_path: Path) -> None:
    _, record = suite.report("no-ancillary", tmp_path)
    for broken in ({**record, "more": 1}, {k: v for k, v in record.items() if k != "verdict"}):
        with pytest.raises(RecordError):
            check(broken)


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


def test_the_anchor_of_a_divergence_is_named(suite: Suite, tmp_path: Path) -> None:
    """Also where the output differs as well."""
    _, record = suite.report("accepts", tmp_path)
    vector = next(v for v in record["vectors"] if v["status"] == "failed")
    both = ["features: anchor 3 (chunk 0) is 1, 2 expected", "trace: attributes.features[7,2] is 3, 6 expected"]
    for lines, form in ((both, "--anchor 7"), (["trace: planes.r1[0,0,0] is 1, 0 expected"], "--hex"), ([], "--hex")):
        record["vectors"] = [{**vector, "divergence": lines}]
        checked = check(record)
        path = os.path.relpath(suite.folder / vector["input"])
        wanted = f"refcodec inspect {shlex.join([path])} {form}"
        assert [line for line in summary.lines(checked, suite.folder) if line.endswith(wanted)]


def test_failures_are_before_crashes_and_equal_crashes_are_one(suite: Suite, tmp_path: Path) -> None:
    _, record = suite.report("right", tmp_path)
    states = [("crashed", "exit status 70")] * 3 + [("crashed", "SIGSEGV"), ("failed", "wrong"), ("passed", "")]
    for v, (status, text) in zip(record["vectors"], states, strict=True):
        v.update(status=status, text=text, stderr="")
    lines = list(summary.lines(check(record), suite.folder))
    assert [line.split()[0] for line in lines if line[:6].isupper()] == ["FAILED", "CRASHED", "CRASHED"]
    assert "    2 more crashed alike" in lines


def test_a_missing_package_is_told(suite: Suite) -> None:
    program = "import sys; sys.modules['psutil'] = None; from conformance.cli import main; sys.exit(main())"
    done = subprocess.run([sys.executable, "-c", program, "run"], capture_output=True, text=True, cwd=ROOT, check=False)
    assert done.returncode == statuses.USAGE
    assert done.stderr.startswith("conformance: psutil is not installed: pip install")
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
    files = [str(suite.folder / "valid" / "plain.c3gs")] * 40
    command = shlex.join([sys.executable, "-m", "conformance", "check-encoder", *files])
    piped = f"{{ {command}; echo $? >{tmp_path / 'status'}; }} | :"
    done = subprocess.run(["sh", "-c", piped], check=False, cwd=ROOT, capture_output=True, text=True)
    assert done.stderr == ""
    assert int((tmp_path / "status").read_text()) == statuses.BROKEN_PIPE


def test_the_peak_of_the_runner_is_not_that_of_a_decoder() -> None:
    ballast = bytearray(os.urandom(1 << 20)) * 100
    floor = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss << 10
    peaks = []
    for size in (0, floor + (100 << 20)):
        with closing(Folder()) as folder:
            command = [sys.executable, "-S", "-c", f"bytearray({size}).count(1)"]
            ended = process.Watcher().run(command, process.Bounds(60, 4 << 30, folder, threading.Event()))
        assert (ended.over, ended.status) == (None, 0)
        peaks.append(ended.peak)
    assert len(ballast) == 100 << 20
    assert peaks[0] is None
    assert floor + (100 << 20) < peaks[1] < floor + (200 << 20)


# One that ends between requests, and one that answers late, whose answer is not taken for that to the next request.
SERVERS = [
    "import json; print(json.dumps({'id': json.loads(input())['id'], 'status': 0}))",
    """
import json, sys
last = None
for line in sys.stdin:
    if last:
        print(last, flush=True)
    else:
        last = json.dumps({"id": json.loads(line)["id"], "status": 0})
        print(last, flush=True)
""",
]


@pytest.mark.parametrize("code", SERVERS)
def test_servers(code: str) -> None:
    with closing(Folder()) as folder, closing(process.Watcher()) as watcher:
        for _ in range(3):
            bounds = process.Bounds(60, 1 << 30, folder, threading.Event())
            ended = watcher.ask([sys.executable, "-S", "-c", code], {}, bounds)
            assert (ended.status, ended.over) == (0, None)
            time.sleep(0.5)


def test_a_decoder_that_cannot_be_killed_is_left(monkeypatch: pytest.MonkeyPatch) -> None:
    """As one of another user."""

    def refused(*_: object) -> None:
        raise PermissionError

    def denied(self: psutil.Process) -> None:
        raise psutil.AccessDenied

    monkeypatch.setattr(process, "_GONE", 0.2)
    monkeypatch.setattr(process.os, "killpg", refused)
    monkeypatch.setattr(psutil.Process, "kill", denied)
    command = [sys.executable, "-S", "-c", "import time; time.sleep(2)"]
    with closing(Folder()) as folder:
        for seconds, over in ((0.02, "time"), (60, None)):
            ended = process.Watcher().run(command, process.Bounds(seconds, 1 << 30, folder, threading.Event()))
            assert ended.over == over
            assert (ended.seconds < 2) == (over is not None)


# --- other encoders --------------------------------------------------------------------------------------------------


def test_check_encoder(
    suite: Suite, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    good = [str(suite.folder / "valid" / f"{n}.c3gs") for n in ("plain", "extended")]
    bad = str(suite.folder / "invalid" / "up-axis.c3gs")
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
