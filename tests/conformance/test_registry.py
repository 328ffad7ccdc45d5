"""The registry: its committed files are current, edited reports are refused, and a new TOML file gets a badge."""

from __future__ import annotations

import gzip
import json
import re
import shlex
import shutil
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from xml.etree import ElementTree

import pytest
from msgspec.structs import replace
from small_suite import Suite

from conformance import cli
from conformance.manifest import MANIFEST
from conformance.registry import certificates, implementations, matrix, pages
from conformance.report.record import read
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


def test_the_committed_files_are_current(monkeypatch: pytest.MonkeyPatch) -> None:
    """The page and badges are those of the committed reports, which the registry accepts."""
    monkeypatch.chdir(ROOT)
    assert cli.main(["registry", "--check"]) == statuses.DONE


def test_the_house_is_registered() -> None:
    """Every decoder and encoder of the project has a report or files, and all are right."""
    known, rows = implementations.load(ROOT / "implementations"), matrix.load(ROOT / "implementations")
    decoders = {i.key for i in known if i.decoder}
    assert {"refcodec", "refcodec-numpy", "spec-decoder", "decoder-c", "web"} <= decoders
    assert {row.encoder for row in rows} == {i.key for i in known if i.encoder}
    for row in rows:
        assert row.right, row
        assert set(row.digests) == decoders


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


@pytest.fixture(scope="module")
def failing(suite: Suite, tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = Registry(suite, tmp_path_factory.mktemp("failing"), "no-ancillary")
    assert made.call("--run", "mine") == statuses.DONE
    return made.folder


@pytest.fixture
def registry(suite: Suite, failing: Path, tmp_path: Path) -> Registry:
    """A registry whose decoder fails one vector, valid-extended."""
    shutil.copytree(failing, tmp_path, dirs_exist_ok=True)
    return Registry(suite, tmp_path, "no-ancillary")


def test_from_a_toml_file_to_a_badge(suite: Suite, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    new = Registry(suite, tmp_path, "right")
    assert new.call("--write") == statuses.DONE
    assert "no report" in new.badge()
    assert new.call("--run", "mine") == statuses.DONE
    assert "suite 0.0.1: tiny 0" in new.badge()
    assert new.call("--check") == statuses.DONE
    page = (tmp_path / "README.md").read_text()
    for text in (read(new.report)["sha256"], "![tiny 0](badges/mine.svg)", "[Mine](https://"):
        assert text in page
    # A badge of a removed file goes, and a changed page is named.
    (tmp_path / "badges" / "other.svg").write_text("")
    (tmp_path / "README.md").write_text("")
    assert new.call("--check") == statuses.REJECTED
    assert re.findall(r"(\S+) is not current", capsys.readouterr().err)[-1].endswith("other.svg")
    assert new.call("--write") == statuses.DONE
    assert new.call("--check") == statuses.DONE
    assert new.call("--run", "other") == statuses.USAGE


def test_a_report_that_is_not_one(registry: Registry, capsys: pytest.CaptureFixture[str]) -> None:
    """Or an edited one (test_audit.py)."""
    edited = json.dumps(read(registry.report)).replace('"fails"', '"conforms"').encode()
    for data in (b"", b"{}", gzip.compress(b"{"), registry.report.read_bytes()[:-9], gzip.compress(edited)):
        registry.report.write_bytes(data)
        assert registry.call("--check") == statuses.USAGE
        assert "mine.json.gz" in capsys.readouterr().err


def test_another_program(registry: Registry, suite: Suite, capsys: pytest.CaptureFixture[str]) -> None:
    """A report stays with the command and the version that it was made with, and is not edited."""
    for text in (toml(suite, "right"), toml(suite, "no-ancillary").replace("1.0", "1.1")):
        (registry.folder / "mine.toml").write_text(text)
        assert registry.call("--check") == statuses.USAGE
        assert "conformance registry --run mine" in capsys.readouterr().err


def test_badges(registry: Registry, tmp_path_factory: pytest.TempPathFactory) -> None:
    """A decoder that fails has a red one, and a report of another suite a grey one."""
    assert "fails 1" in registry.badge()
    assert "#b71c1c" in registry.badge()
    changed = tmp_path_factory.mktemp("changed")
    shutil.copytree(registry.suite.folder, changed, dirs_exist_ok=True)
    manifest = json.loads((changed / MANIFEST).read_text())
    (changed / MANIFEST).write_text(json.dumps({**manifest, "suite_version": "0.0.2"}))
    registry.suite = Suite(changed, registry.suite.answers)
    assert registry.call("--check") == statuses.REJECTED
    assert registry.call("--write") == statuses.DONE
    assert "only suite 0.0.1" in registry.badge()
    assert "#616161" in registry.badge()


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("name", "more"),
        ('name = "Mine"', "name = "),
        ("Mine", "a | b"),
        ("Mine", "Mi\u202ene"),
        ("https:", "javascript:"),
        ("[decoder]", "more = 1\n[decoder]"),
        ("[decoder]", "[encoder]"),
        ("reports/", "../reports/"),
        ("{output}", "'{output}"),
        ("report = 'reports/mine.json.gz'", ""),
        ("", None),
        ("mine.toml", "mi|ne.toml"),
    ],
)
def test_wrong_files(registry: Registry, suite: Suite, old: str, new: str | None) -> None:
    """Without a file, and with another name or other values."""
    text = toml(suite, "right")
    (registry.folder / "mine.toml").unlink()
    if new is not None:
        (registry.folder / "mine.toml".replace(old, new)).write_text(text.replace(old, new))
    assert registry.call("--check") == statuses.USAGE


def test_an_implementation_of_nothing(registry: Registry) -> None:
    (registry.folder / "mine.toml").write_text(TOML)
    assert registry.call("--check") == statuses.USAGE


SOURCE = "vectors/tiny-example.c3gs"
SECOND = f"{sys.executable} -m conformance.spec_decoder decode {{input}} {{output}}"


def implementation(key: str, run: str = "", **encoder: str) -> implementations.Implementation:
    texts = ("name", "version", "author", "licence", "language", "source")
    decoder = implementations.Decoder(run, "report.json.gz") if run else None
    return implementations.Implementation(key, *texts, decoder, encoder)  # type: ignore[arg-type]


def test_a_file_that_every_decoder_refuses_is_not_right() -> None:
    """If no digest was meant, they must give one."""
    row = matrix.Row(
        "e", "ply", "s.c3gs", 9, True, None, "", {"a": "crashed: took too long", "b": "crashed: took too long"}
    )
    assert (row.right, row.digest) == (False, "")
    digests = {"a": "0" * 64, "b": "0" * 64, "c": "1" * 64}
    assert (replace(row, digests=digests).right, replace(row, digests=digests).digest) == (False, "0" * 64)
    assert replace(row, digests={"a": "0" * 64}).right


def test_the_matrix(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An encoder that copies a file is right, one that writes another scene is wrong, and so is a wrong decoder."""
    monkeypatch.chdir(ROOT)
    known = [
        implementation("absent", "not-installed {input} {output}", json="not-installed"),
        implementation("crashes", "false {input} {output}"),
        implementation("fails", json="false {input} {output}"),
        implementation("other", json="cp vectors/tiny-packed.c3gs {output}"),
        implementation("right", json=f"cp {SOURCE} {{output}}"),
        implementation("second", SECOND),
    ]
    notes: list[str] = []
    files = matrix.run(known, notes.append, {"json": (SOURCE,)})
    assert [line.split(" is left out")[0] for line in notes] == ["absent", "absent"]
    rows = {row.encoder: row for row in files}
    assert {row.encoder: row.fault for row in files if not row.canonical} == {"fails": "CalledProcessError"}
    assert rows["right"].digests["second"] == rows["right"].expected
    assert rows["other"].digests["second"] not in (rows["other"].expected, None)
    assert rows["right"].digests["crashes"].startswith("crashed: exit status 1")
    assert not any(row.right for row in files)
    for row in files:
        row.digests.pop("crashes", None)
    texts = {i.key: certificates.of_encoder(i, files).text for i in known if i.encoder}
    wrong, right = "1 of 1 files wrong", "1 files, 1 decoders agree"
    assert texts == {"absent": "not in the matrix", "fails": wrong, "other": wrong, "right": right}
    page = pages.files(tmp_path, [], files, cli.shared.suite(ROOT / "vectors"))[tmp_path / pages.PAGE]
    assert "3 files, 1 decoders: 2 files are wrong" in page
    assert page.count("| same |") == 1
    # A digest that was edited is not that of the given scene.
    (tmp_path / matrix.NAME).write_text(matrix.text(files))
    assert matrix.load(tmp_path) == files
    edited = replace(rows["right"], expected=rows["other"].digests["second"])
    wrong = {matrix.text([edited]): "was edited", "[{}]": "is missing", "3": "3: a list is required"}
    for text, problem in wrong.items():
        (tmp_path / matrix.NAME).write_text(text)
        with pytest.raises(statuses.UsageError, match=problem):
            matrix.load(tmp_path)
    with pytest.raises(statuses.UsageError, match=r"none\.c3gs is not here"):
        matrix.run(known, print, {"json": ("none.c3gs",)})


def test_words() -> None:
    rows = (("tiny", 0), ("main", 1), ("main", 2), ("main", 3), ("rendering", None))
    record: Any = SimpleNamespace(
        profiles=[SimpleNamespace(profile=p, level=n, verdict="fails" if n == 3 else "conforms") for p, n in rows],
        verdict=SimpleNamespace(grade=0),
        vectors=[SimpleNamespace(grade=g, found=found) for g, found in ((2, {}), (0, {}), (0, None))],
    )
    assert certificates.words(record) == "tiny 0, main 1-2, drawing"
    record.profiles = []
    assert certificates.words(record) == "fails 2"
    record.verdict.grade = 2
    assert certificates.words(record) == "grade 2"
