"""The tables of an experiment in RESULTS.md."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks import experiment, results


def test_section(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It has the experiment's name and tables, is replaced when it is written again, and all other text stays."""
    place = tmp_path / "RESULTS.md"
    place.write_text("# Measured results\n\nother\n")
    monkeypatch.setattr(results, "RESULTS", place)
    for figure in ("31.00", "32.00"):
        (tmp_path / "tables.md").write_text(f"# small\n\nMeans.\n\n## caliterra\n\n| pro | {figure} |\n")
        assert experiment.main([str(tmp_path)]) == 0
    text = place.read_text()
    assert text.startswith("# Measured results\n\nother\n")
    assert "\n## Experiment: small\n" in text
    assert "\n### caliterra\n\n| pro | 32.00 |\n" in text
    assert "31.00" not in text
    assert "benchmarks/experiments/small.toml" in text


def test_no_tables(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert experiment.main([str(tmp_path)]) == 64
    assert "tables.md" in capsys.readouterr().err
