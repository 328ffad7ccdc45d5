"""The registry: its committed files are current, edited reports are refused, and a new TOML file gets a badge."""

from __future__ import annotations

import gzip
import json
import re
import shlex
import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from xml.etree import ElementTree

import pytest
from small_suite import Suite

from conformance import cli
from conformance.manifest import MANIFEST
from conformance.registry import certificates, implementations, matrix, pages
from conformance.report.record import read, seal
from refcodec import statuses

ROOT = Path(__file__).resolve().parents[2]
TOML = """\
name = "Mine"
version = "1.0"
author = "Jane Doe"
licence = "MIT"
language = "Rust"
source = "https://example.org/mine"
"""

Record = dict[str, Any]


def test_the_committed_files_are_current(monkeypatch: pytest.MonkeyPatch) -> None:
    """The page, badges and history are those of the committed reports, which the registry accepts."""
    monkeypatch.chdir(ROOT)
    assert cli.main(["registry", "--check"]) == statuses.DONE


def test_the_house_is_registered() -> None:
    """Every decoder and encoder of the project has a current certificate."""
    history = certificates.read_history(ROOT / "implementations")
    found = matrix.load(ROOT / "implementations")
    known = implementations.load(ROOT / "implementations")
    assert {"refcodec", "refcodec-numpy", "spec-decoder", "decoder-c", "web"} <= {i.key for i in known if i.decoder}
    assert {entry["implementation"] for entry in history} >= {i.key for i in known if i.decoder}
    assert set(found["decoders"]) == {i.key for i in known if i.decoder}
    assert {row["encoder"] for row in found["files"]} == {i.key for i in known if i.encoder}
    for row in found["files"]:
        assert matrix.is_right(row), row
        assert set(row["found"]) == set(found["decoders"])


def toml(suite: Suite, mode: str) -> str:
    command = shlex.join(suite.command(mode))
    return f"{TOML}[decoder]\nrun = {json.dumps(command)}\nreport = 'reports/mine.json.gz'\n"


class Registry:
    """A registry with one decoder, that of the small suite. mode: of fake_decoder.py."""

    def __init__(self, suite: Suite, folder: Path, mode: str) -> None:
        self.suite, self.folder = suite, folder
        self.report = folder / "reports" / "mine.json.gz"
        (folder / "mine.toml").write_text(toml(suite, mode))

    def call(self, *options: str) -> int:
        vectors = str(self.suite.folder)
        return cli.main(["registry", "--vectors", vectors, "--folder", str(self.folder), "--slow", "20", *options])

    def badge(self) -> str:
        text = (self.folder / "badges" / "mine.svg").read_text()
        assert ElementTree.fromstring(text).tag == "{http://www.w3.org/2000/svg}svg"
        assert not re.search(r"(?:href|src)=|url\(", text)
        return text

    def write(self, record: Record) -> None:
        self.report.write_bytes(gzip.compress(json.dumps(record).encode()))

    def history(self) -> list[Record]:
        return json.loads((self.folder / "history.json").read_text())


@pytest.fixture(scope="module")
def failing(suite: Suite, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a registry whose decoder fails one vector, valid-extended."""
    found = Registry(suite, tmp_path_factory.mktemp("failing"), "no-ancillary")
    assert found.call("--run", "mine") == statuses.DONE
    return found.folder


@pytest.fixture
def registry(suite: Suite, failing: Path, tmp_path: Path) -> Registry:
    """A copy of the registry with one failure."""
    shutil.copytree(failing, tmp_path, dirs_exist_ok=True)
    return Registry(suite, tmp_path, "no-ancillary")


def test_from_a_toml_file_to_a_badge(suite: Suite, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    new = Registry(suite, tmp_path, "right")
    assert new.call("--write") == statuses.DONE
    assert "no report" in new.badge()
    assert new.call("--run", "mine") == statuses.DONE
    assert "suite 0.0.1: tiny 0" in new.badge()
    assert new.call("--check") == statuses.DONE
    (entry,) = new.history()
    page = (tmp_path / "README.md").read_text()
    for text in (entry["manifest_sha256"], entry["report_sha256"], "![tiny 0](badges/mine.svg)", "[Mine](https://"):
        assert text in page
    # A badge of a removed file goes, and a changed page is named.
    (tmp_path / "badges" / "other.svg").write_text("")
    (tmp_path / "README.md").write_text("")
    assert new.call("--check") == statuses.REJECTED
    assert re.findall(r"(\S+) is not current", capsys.readouterr().err)[-1].endswith("other.svg")
    assert new.call("--write") == statuses.DONE
    assert new.call("--check") == statuses.DONE
    assert new.call("--run", "other") == statuses.USAGE


def _vector(record: Record, name: str) -> Record:
    return next(v for v in record["vectors"] if v["id"] == name)


def _pass(record: Record) -> None:
    """Edits the failure, and all conclusions from it."""
    failed, other = _vector(record, "valid-extended"), _vector(record, "valid-plain")
    failed.update({name: other[name] for name in ("status", "grade", "text", "divergence", "hex", "stderr")})
    record["verdict"].update(conforms=True, grade=3, counts={**record["verdict"]["counts"], "failed": 0, "passed": 6})
    record["profiles"][0].update(verdict="conforms", right=6)
    for name in ("requirements", "features"):
        for row in record[name].values():
            row["right"] = 6
    record["diagnosis"] = None


EDITS: dict[str, Callable[[Record], object]] = {
    "a verdict": lambda r: r["profiles"][0].update(verdict="conforms"),
    "a status": lambda r: _vector(r, "valid-extended").update(status="passed", grade=3, text=""),
    "all verdicts": _pass,
    "a count": lambda r: r["verdict"]["counts"].update(failed=0, passed=6),
    "the suite's version": lambda r: r["suite"].update(version="0.0.2"),
    "the manifest": lambda r: r["suite"].update(manifest_sha256="0" * 64),
    "a digest": lambda r: _vector(r, "valid-plain")["found"].update(digest="0" * 64),
    "an expectation": lambda r: _vector(r, "valid-plain")["expected"].update(digest="0" * 64),
    "a code": lambda r: _vector(r, "malformed-crc")["found"].update(code=101),
    "an unknown code": lambda r: _vector(r, "malformed-crc")["found"].update(code=999),
    "no answer": lambda r: _vector(r, "valid-extended").update(found=None, status="skipped"),
    "a removed vector": lambda r: r["vectors"].remove(_vector(r, "valid-extended")),
    "a vector twice": lambda r: r["vectors"].append(r["vectors"][0]),
    "a known failure": lambda r: _vector(r, "valid-extended").update(status="known"),
    "a requirement": lambda r: r["requirements"]["R6.2-1"].update(right=6),
    "a selection": lambda r: r["runner"].update(select=["class:valid"]),
    "the grade": lambda r: r["runner"].update(grade=1),
    "the name": lambda r: r["decoder"]["description"].update(name="Other"),
    "the version": lambda r: r["decoder"]["description"].update(version="2.0"),
    "the command": lambda r: r["decoder"].update(command=["other", "{input}", "{output}"]),
    "no command": lambda r: r["decoder"].update(command=[]),
    "a field": lambda r: r.update(more=1),
}


@pytest.mark.parametrize("what", EDITS)
def test_an_edited_report_is_refused(registry: Registry, what: str, capsys: pytest.CaptureFixture[str]) -> None:
    """With the record's own SHA-256 made again, the rest of the content must contradict the edit."""
    record = read(registry.report)
    EDITS[what](record)
    for sealed in (False, True):
        if sealed and what == "the grade":
            # No vector has grade 1 or 2, thus the same verdicts follow.
            continue
        registry.write(record | ({"sha256": seal(record)} if sealed else {}))
        for option in ("--check", "--write"):
            assert registry.call(option) == statuses.USAGE
        assert "mine.json" in capsys.readouterr().err


def test_numbers_without_a_second_source(registry: Registry, capsys: pytest.CaptureFixture[str]) -> None:
    """Only the record's SHA-256 covers them."""
    record = read(registry.report)
    # Another form of the same JSON is the same record.
    registry.report.write_bytes(gzip.compress(json.dumps(record, separators=(",", ":")).encode()))
    assert registry.call("--check") == statuses.DONE
    record["vectors"][0]["seconds"] = 0
    registry.write(record)
    assert registry.call("--check") == statuses.USAGE
    assert "its SHA-256" in capsys.readouterr().err


def test_a_report_that_is_not_one(registry: Registry, capsys: pytest.CaptureFixture[str]) -> None:
    for data in (b"", b"{}", registry.report.read_bytes()[:-9], gzip.compress(b"{")):
        registry.report.write_bytes(data)
        assert registry.call("--check") == statuses.USAGE
        assert "mine.json.gz" in capsys.readouterr().err


def test_another_program(registry: Registry, suite: Suite, capsys: pytest.CaptureFixture[str]) -> None:
    """A report stays with the command and the version that it was made with."""
    for text in (toml(suite, "right"), toml(suite, "no-ancillary").replace("1.0", "1.1")):
        (registry.folder / "mine.toml").write_text(text)
        assert registry.call("--check") == statuses.USAGE
        assert "conformance registry --run mine" in capsys.readouterr().err


def test_a_failing_decoder(registry: Registry) -> None:
    assert "fails 1" in registry.badge()
    assert "#b71c1c" in registry.badge()


def test_an_earlier_suite(registry: Registry, tmp_path_factory: pytest.TempPathFactory) -> None:
    """Its report stays as it is, with a grey badge. An edited one is refused."""
    changed = tmp_path_factory.mktemp("changed")
    shutil.copytree(registry.suite.folder, changed, dirs_exist_ok=True)
    manifest = json.loads((changed / MANIFEST).read_text())
    (changed / MANIFEST).write_text(json.dumps({**manifest, "suite_version": "0.0.2"}))
    registry.suite = Suite(changed, registry.suite.answers)
    assert registry.call("--check") == statuses.REJECTED
    assert registry.call("--write") == statuses.DONE
    assert "suite 0.0.1: fails 1 (earlier)" in registry.badge()
    record = read(registry.report)
    EDITS["a count"](record)
    registry.write(record | {"sha256": seal(record)})
    assert registry.call("--check") == statuses.USAGE
    assert registry.call("--run", "mine") == statuses.DONE
    assert [entry["suite_version"] for entry in registry.history()] == ["0.0.1", "0.0.2"]


@pytest.mark.parametrize(
    "text",
    [
        "",
        TOML,
        f"{TOML}[decoder]\nrun = 'x'\n",
        f"{TOML}[decoder]\nrun = 'x'\nreport = '../mine.json.gz'\n",
        f"{TOML}[encoder]\n",
        f"{TOML}more = 1\n[encoder]\nply = 'x'\n",
        TOML.replace("Mine", "a | b") + "[encoder]\nply = 'x'\n",
        TOML.replace("https:", "javascript:") + "[encoder]\nply = 'x'\n",
        f'{TOML}[encoder]\nply = "x \'y"\n',
        "name = ",
        TOML.replace("Mine", "Mi\u202ene") + "[encoder]\nply = 'x'\n",
    ],
)
def test_wrong_toml(suite: Suite, tmp_path: Path, text: str) -> None:
    new = Registry(suite, tmp_path, "right")
    (tmp_path / "mine.toml").write_text(text)
    assert new.call("--check") == statuses.USAGE
    (tmp_path / "mine.toml").rename(tmp_path / "mi|ne.toml")
    assert new.call("--check") == statuses.USAGE
    (tmp_path / "mi|ne.toml").unlink()
    assert new.call("--check") == statuses.USAGE


SOURCE = "vectors/tiny-example.c3gs"
SECOND = f"{sys.executable} -m conformance.spec_decoder decode {{input}} {{output}}"


def implementation(key: str, **sides: dict[str, str]) -> implementations.Implementation:
    texts = ("name", "version", "author", "licence", "language", "source")
    return implementations.Implementation(key, *texts, **{"decoder": {}, "encoder": {}, **sides})


def test_the_matrix(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An encoder that copies a file is right, one that writes another scene is wrong, and so is a wrong decoder."""
    monkeypatch.chdir(ROOT)
    known = [
        implementation("absent", decoder={"run": "not-installed {input} {output}"}),
        implementation("crashes", decoder={"run": "false {input} {output}"}),
        implementation("fails", encoder={"json": "false {input} {output}"}),
        implementation("other", encoder={"json": "cp vectors/tiny-packed.c3gs {output}"}),
        implementation("right", encoder={"build": "true", "json": f"cp {SOURCE} {{output}}"}),
        implementation("second", decoder={"run": SECOND}),
        implementation("unbuilt", encoder={"build": "false", "json": "true"}),
    ]
    told: list[str] = []
    old = {"decoders": {"absent": "version: not-installed {input} {output}"}, "files": []}
    found = matrix.run(known, old, tmp_path / "state", told.append, {"json": (SOURCE,)})
    assert [line.split(" is left out")[0] for line in told] == ["the encoder unbuilt", "the decoder absent"]
    rows = {row["encoder"]: row for row in found["files"]}
    assert [(row["canonical"], row["fault"]) for row in rows.values()] == [
        (False, "exit status 1"),
        (True, ""),
        (True, ""),
    ]
    assert rows["right"]["found"]["second"] == rows["right"]["expected"]
    assert rows["other"]["found"]["second"] not in (rows["other"]["expected"], None)
    assert rows["right"]["found"]["crashes"].startswith("crashed: exit status 1")
    assert not any(map(matrix.is_right, rows.values()))
    page = pages.matrix_page(found)
    assert "3 files, 3 decoders: 3 files are wrong" in page
    assert page.count("| same |") == 1
    for row in rows.values():
        row["found"].pop("crashes", None)
    assert matrix.is_right(rows["right"])
    assert not matrix.is_right(rows["other"])
    texts = {i.key: certificates.of_encoder(i, found).text for i in known if i.encoder}
    assert texts == {
        "fails": "1 of 1 files wrong",
        "other": "1 of 1 files wrong",
        "right": "1 files, 1 decoders agree",
        "unbuilt": "not in the matrix",
    }
    # A digest that was edited is not that of the given scene.
    matrix.check(found)
    rows["right"]["expected"] = rows["other"]["found"]["second"]
    with pytest.raises(statuses.UsageError, match="was edited"):
        matrix.check(found)


def test_an_interrupted_matrix_continues(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    encoder = implementation("right", encoder={"json": f"cp {SOURCE} {{output}}"})
    known = [encoder, *(implementation(f"d{n}", decoder={"run": SECOND}) for n in range(3))]
    asked: list[Path] = []

    def interrupted(command: str, file: Path) -> str:
        if len(asked) == 2:
            raise KeyboardInterrupt
        asked.append(file)
        return "0" * 64

    nothing = {"decoders": {}, "files": []}
    with pytest.raises(statuses.UsageError, match=r"none\.c3gs is not here"):
        matrix.run(known, nothing, tmp_path / "state", print, {"json": ("none.c3gs",)})
    monkeypatch.setattr(matrix, "_decoded", interrupted)
    with pytest.raises(KeyboardInterrupt):
        matrix.run(known, nothing, tmp_path / "state", print, {"json": (SOURCE,)})
    monkeypatch.setattr(matrix, "_decoded", lambda command, file: asked.append(file) or "0" * 64)
    monkeypatch.setattr(matrix, "_encoded", lambda *words: pytest.fail("it was encoded again"))
    (row,) = matrix.run(known, nothing, tmp_path / "state", print, {"json": (SOURCE,)})["files"]
    assert len(asked) == 3
    assert set(row["found"]) == {"d0", "d1", "d2"}
    assert not (tmp_path / "state").exists()


def test_a_program_that_is_not_here_keeps_its_answers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    run = "not-installed {input} {output}"
    known = [
        implementation("far", decoder={"run": run}, encoder={"json": run}),
        implementation("right", encoder={"json": f"cp {SOURCE} {{output}}"}),
    ]
    monkeypatch.setattr(matrix, "_decoded", lambda command, file: "0" * 64)
    scenes = {"json": (SOURCE,)}
    here = matrix.run([known[1]], {"decoders": {}, "files": []}, tmp_path / "state", print, scenes)["files"][0]
    before = {
        "decoders": {"far": f"version: {run}"},
        "files": [{**here, "found": {"far": "1" * 64}}, {**here, "encoder": "far", "found": {"far": "1" * 64}}],
    }
    found = matrix.run(known, before, tmp_path / "state", print, scenes)
    assert [(row["encoder"], row["found"]) for row in found["files"]] == [
        ("right", {"far": "1" * 64}),
        ("far", {"far": "1" * 64}),
    ]
    assert found["decoders"] == before["decoders"]


def test_words() -> None:
    rows = [
        ("tiny", 0, "conforms"),
        ("main", 1, "conforms"),
        ("main", 2, "conforms"),
        ("main", 3, "fails"),
        ("rendering", None, "conforms"),
    ]
    record: Any = SimpleNamespace(
        profiles=[SimpleNamespace(profile=p, level=level, verdict=v) for p, level, v in rows],
        verdict=SimpleNamespace(grade=0),
        vectors=[SimpleNamespace(grade=g, found=found) for g, found in ((2, {}), (0, {}), (0, None))],
    )
    assert certificates.words(record) == "tiny 0, main 1-2, drawing"
    record.profiles = []
    assert certificates.words(record) == "fails 2"
    record.verdict.grade = 2
    assert certificates.words(record) == "grade 2"
