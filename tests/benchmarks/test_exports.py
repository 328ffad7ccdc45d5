"""The table of exports: figures are kept, files match their records, and a server receives pictures."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.exports import browser, making
from benchmarks.exports.__main__ import main

ROOT = Path(__file__).resolve().parents[2]
TRAINED = ROOT / "vectors" / "valid" / "trained-caliterra.c3gs"


@pytest.mark.slow
def test_the_command(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(making, "ITERATIONS", 0)
    words = [str(tmp_path / "out"), "--scene", "a", str(TRAINED), str(folder), "--size", "40", "--degrees", "0"]
    static = ["--scene", "b", str(TRAINED.with_name("static-degree-2.c3gs")), str(folder)]
    assert main([*words, *static]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert "### a" in lines
    rows = [line.strip("| ").split(" | ") for line in lines if line.startswith("| .")]
    assert {row[0].split(",")[0] for row in rows} == {".c3gs", *making.MEASURED}
    assert [row[0] for row in rows if ".spz" in row[0]] == 2 * [".spz, 7 bits", ".spz, 8 bits"]
    # A static scene has its own degree, and no fit.
    assert [row[1] for row in rows] == ["", *5 * ["0"], "", *5 * ["2"]]
    assert any("no fit" in line for line in lines)
    monkeypatch.setattr(browser, "find", lambda: None)
    assert main([*words, "--clients"]) == 64
    assert "missing" in (said := capsys.readouterr().err) or "Chromium" in said
