"""Splat files compared with C3GS: all are compared with renderings of the file itself."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
import torch

from benchmarks import converted
from benchmarks.converted import OWN, Source, coded_record, fast_record, main, packed_record
from benchmarks.peers.splats import write_ply

MakeSplats = Callable[[int, int], dict[str, torch.Tensor]]


@pytest.fixture
def source(make_splats: MakeSplats, tmp_path: Path) -> Source:
    write_ply(make_splats(150, 1), tmp_path / "ball.compressed.ply")
    return Source(tmp_path / "ball.compressed.ply", "-y", 16, 32)


def test_spz_and_sog(source: Source, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert source.name == "ball"
    found = {suffix: packed_record(source, suffix, OWN, tmp_path) for suffix in converted.FORMATS}
    for suffix, record in found.items():
        (file,) = tmp_path.glob(f"*{suffix}")
        assert record["bytes"] == file.stat().st_size
        assert 30 < record["psnr"] < 70
    monkeypatch.setattr(converted, "write_splats", None)
    assert packed_record(source, ".spz", OWN, tmp_path) == found[".spz"]


@pytest.mark.slow
def test_a_scene_of_a_splat(source: Source, tmp_path: Path) -> None:
    """The splat is trained as anchors, and compared from cameras that no training had."""
    record = coded_record(source, 0.004, 20, tmp_path)
    assert record["anchors"] > 0
    assert record["seconds"] > 0
    assert 5 < record["psnr"] < 40
    assert len(source.cameras) == len(source.truth) == 2


@pytest.mark.slow
def test_the_splat_itself(source: Source, tmp_path: Path) -> None:
    record = fast_record(source, 40, tmp_path)
    assert 100 < record["anchors"] <= 150
    assert record["psnr"] > 30


def test_splat_transform_is_missing(
    source: Source, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(converted, "tool", lambda: None)
    assert main([str(tmp_path / "out"), str(source.file)]) == 64
    assert "npm install" in capsys.readouterr().err
