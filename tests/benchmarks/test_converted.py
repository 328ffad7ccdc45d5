"""Files of splats beside C3GS: all are compared with drawings of the file itself."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch

from benchmarks import converted
from benchmarks.converted import OWN, Source, coded_record, main, packed_record
from benchmarks.peers.splats import write_ply
from refcodec.cli.main import main as refcodec
from refcodec.photographs.photographs import read_photographs

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
    monkeypatch.setattr(converted, "splat_file", None)
    assert packed_record(source, ".spz", OWN, tmp_path) == found[".spz"]


@pytest.mark.slow
def test_a_scene_of_a_splat(source: Source, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The cameras that compare are those that the command keeps for tests, and its background is theirs."""
    record = coded_record(source, 0.004, 20, tmp_path)
    assert record["anchors"] > 0
    assert record["seconds"] > 0
    assert 5 < record["psnr"] < 40
    words = ["convert", str(source.file), "-o", str(tmp_path / "again"), "--pictures", str(tmp_path / "pictures")]
    assert refcodec([*words, "--views", "16", "--size", "32", "--steps", "1", "--up=-y"]) == 0
    tests = read_photographs(tmp_path / "pictures", 32, (0, 0, 0)).test
    assert len(tests) == len(source.cameras) == 2
    for photograph, right in zip(tests, source.truth, strict=True):
        assert np.array_equal(photograph.image, right)


def test_splat_transform_is_missing(
    source: Source, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(converted, "tool", lambda: None)
    assert main([str(tmp_path / "out"), str(source.file)]) == 64
    assert "npm install" in capsys.readouterr().err
