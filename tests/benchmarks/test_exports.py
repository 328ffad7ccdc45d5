"""The table of exports: figures are kept, files match their records, and a server receives pictures."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.exports import bits, browser, making
from benchmarks.exports.__main__ import main
from refcodec.export.formats import FORMATS

ROOT = Path(__file__).resolve().parents[2]
TRAINED = ROOT / "vectors" / "valid" / "trained-caliterra.c3gs"


@pytest.mark.slow
def test_the_command(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(making, "ITERATIONS", 0)
    words = [str(tmp_path / "out"), "--scene", "a", str(TRAINED), str(folder), "--size", "40", "--degrees", "0"]
    assert main(words) == 0
    lines = capsys.readouterr().out.splitlines()
    assert "### a" in lines
    assert [line.split(" | ")[0][2:] for line in lines if line.startswith("| .")] == [".c3gs", *FORMATS]
    monkeypatch.setattr(browser, "find", lambda: None)
    assert main([*words, "--clients"]) == 64
    assert "missing" in (said := capsys.readouterr().err) or "Chromium" in said


@pytest.mark.slow
def test_spz_by_its_bits(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(making, "ITERATIONS", 0)
    assert bits.main([str(tmp_path / "out"), "--scene", "a", str(TRAINED), str(folder), "--size", "40"]) == 0
    rows = [line.strip("| ").split(" | ") for line in capsys.readouterr().out.splitlines() if line.startswith("| a")]
    assert [row[2] for row in rows] == ["", "8", "7", "6", "5", "4", "5 and 4"]
    sizes = [int(row[3].replace(",", "")) for row in rows]
    assert sizes[:-1] == sorted(sizes[:-1], reverse=True)
    assert sizes[5] < sizes[6] < sizes[4]
