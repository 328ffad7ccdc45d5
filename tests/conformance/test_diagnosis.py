"""The diagnosis of a run: the requirements that tell failing vectors from passing ones."""

from __future__ import annotations

import json
import sys
from math import sqrt
from pathlib import Path

import pytest

from conformance.cli.main import main
from conformance.manifest import load
from conformance.report import diagnosis
from refcodec import statuses

VECTORS = Path(__file__).resolve().parents[2] / "vectors"


def test_ochiai() -> None:
    """By hand: of two failing vectors one requirement has both and a passing one, the other has one."""
    purposes = {"a": ["R1", "R2"], "b": ["R1"], "c": ["R1"], "d": []}
    ranked = diagnosis.suspects(purposes, {"a": True, "b": True, "c": False, "d": False})
    assert [(s.requirement, s.failing, s.passing) for s in ranked] == [("R1", 2, 1), ("R2", 1, 0)]
    assert [s.score for s in ranked] == pytest.approx([2 / sqrt(2 * 3), 1 / sqrt(2 * 1)])


def test_the_requirement_whose_vectors_fail_is_first() -> None:
    vectors = load(VECTORS / "manifest.json").vectors
    failing = {v.id: "R6.10-5" in v.requirements for v in vectors}
    best = diagnosis.suspects({v.id: v.requirements for v in vectors}, failing)[0]
    assert (best.requirement, best.score, best.failing, best.passing) == ("R6.10-5", 1.0, sum(failing.values()), 0)


def test_a_run_ends_with_the_requirements(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A decoder that accepts everything fails where a file is refused. One that is right has no diagnosis."""
    options = ["--select", "valid-worked-example", "--select", "code-101*", "--report", str(tmp_path)]
    assert main(["run", *options, "--", sys.executable, "-c", "", "{input}", "{output}"]) == statuses.REJECTED
    record = json.loads((tmp_path / "report.json").read_text())["diagnosis"]
    assert (record["failing"] > 0, record["probes"]) == (True, [])
    assert record["requirements"][0]["text"]
    shown = capsys.readouterr().out
    assert all(line in shown for line in record["text"])
    assert record["requirements"][0]["requirement"] in (tmp_path / "report.html").read_text()
    decoder = [sys.executable, "-m", "conformance.spec_decoder", "decode", "{input}", "{output}"]
    assert main(["run", *options, "--", *decoder]) == 0
    assert json.loads((tmp_path / "report.json").read_text())["diagnosis"] is None
