"""`python -m benchmarks scale`: figures, tables and a plot. No time is asserted."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from benchmarks import scale
from benchmarks.contenders import DisagreementError
from benchmarks.large import TRAINED
from benchmarks.reading import Reading

SIZES = (300, 5000)


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("kept")


@pytest.fixture(scope="module")
def figures(kept: Path) -> dict[str, Any]:
    return scale.scale(TRAINED, SIZES, 2, kept)


def test_figures(figures: dict[str, Any]) -> None:
    """There is a row for each size and way, with the same digest for both ways of a size."""
    assert [(row["anchors"], row["way"]) for row in figures["rows"]] == [
        (size, way) for size in SIZES for way in ("whole", "streaming")
    ]
    for row in figures["rows"]:
        assert len(row["runs"]) == 2
        assert row["seconds"] > 0
        assert row["peak"] > 0
    assert len({run["digest"] for row in figures["rows"] for run in row["runs"]}) == len(SIZES)
    json.dumps(figures)


def test_lines_and_plot(figures: dict[str, Any], tmp_path: Path) -> None:
    lines = scale.scale_lines(figures)
    assert sum(line.startswith(("| 300 |", "| 5,000 |")) for line in lines) == 4
    scale.write_plot(figures, tmp_path / "scale.png")
    assert (tmp_path / "scale.png").read_bytes().startswith(b"\x89PNG")


def _found(text: str) -> Reading:
    return Reading(1, 1.0, 1.0, text)


def test_ways_that_disagree(kept: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scale, "reading", lambda path, way: _found(way))
    with pytest.raises(DisagreementError, match="300 anchors"):
        scale.scale(TRAINED, [300], 1, kept)
