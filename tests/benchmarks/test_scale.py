"""`python -m benchmarks scale`: figures, tables and a plot. No time is asserted."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from benchmarks import scale
from benchmarks.contenders import DisagreementError
from benchmarks.large import TRAINED, large
from benchmarks.reading import ARRIVING, BLOCK, WHOLE, Reading, ReadingError, reading
from refcodec.bitstream.codec import parse
from refcodec.bitstream.reconstruction import chunk_digest, digest
from refcodec.bitstream.scene import take_anchors

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


def test_sizes_and_ways_take_turns(figures: dict[str, Any]) -> None:
    assert figures["order"] == [(size, way) for size in SIZES for way in ("whole", "streaming")] * 2


def test_lines_and_plot(figures: dict[str, Any], tmp_path: Path) -> None:
    lines = scale.scale_lines(figures)
    assert sum(line.startswith(("| 300 |", "| 5,000 |")) for line in lines) == 4
    scale.write_plot(figures, tmp_path / "scale.png")
    assert (tmp_path / "scale.png").read_bytes().startswith(b"\x89PNG")


def _found(text: str) -> Reading:
    return Reading(1, 1.0, 1.0, 1, 1, 1, text)


def test_a_way_that_fails(kept: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """It is tried once, and its row says why it has no figures."""
    tried = []

    def read(path: Path, way: str) -> Reading:
        tried.append(way)
        if way == WHOLE:
            raise ReadingError("status -9")
        return _found("aa")

    monkeypatch.setattr(scale, "reading", read)
    found = scale.scale(TRAINED, [300], 2, kept)
    assert tried == [WHOLE, ARRIVING, ARRIVING]
    assert any(line.startswith("| 300 |") and "failed: status -9" in line for line in scale.scale_lines(found))
    scale.write_plot(found, tmp_path / "scale.png")


def test_ways_that_disagree(kept: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scale, "reading", lambda path, way: _found(way))
    with pytest.raises(DisagreementError, match="300 anchors"):
        scale.scale(TRAINED, [300], 1, kept)


def test_ways_of_reading(kept: Path) -> None:
    """All three find what is in the file. The arriving one has read a part of it when its first chunk is there."""
    path = large(TRAINED, 5000, kept).path
    size, scene = path.stat().st_size, parse(path.read_bytes()).scene
    whole, arriving, second = (reading(path, way, traced=True) for way in (WHOLE, ARRIVING, "1"))
    assert whole.digest == arriving.digest == digest(scene)[0]
    own = scene.chunks[1]
    assert second.digest == chunk_digest(take_anchors(scene, slice(own.start, own.stop)))
    assert (whole.read, whole.reads, whole.first) == (size, 1, size)
    assert (arriving.read, arriving.reads) == (size, -(-size // BLOCK))
    assert arriving.first < size
    assert second.read < size
    assert min(whole.peak, arriving.peak, second.peak) > 0


def test_a_file_that_cannot_be_read(tmp_path: Path) -> None:
    (tmp_path / "broken.c3gs").write_bytes(b"no file")
    for way in (WHOLE, ARRIVING):
        with pytest.raises(ReadingError, match="BitstreamError"):
            reading(tmp_path / "broken.c3gs", way)
