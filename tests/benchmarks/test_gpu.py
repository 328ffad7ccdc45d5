"""The comparison of a GPU with the CPU, with a second CPU in place of the GPU."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from benchmarks.gpu.__main__ import UNAVAILABLE, main
from benchmarks.gpu.compare import (
    LateError,
    Outcome,
    Row,
    Size,
    holds,
    networks_agree,
    steps_agree,
    trained,
    trainings_agree,
)

SMALL = Size((60, 60), (12, 12), 300)


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU")
def test_no_gpu(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([]) == UNAVAILABLE
    assert "no GPU" in capsys.readouterr().err


def test_a_row() -> None:
    row = Row("PSNR", "1", "2", 0.2, 0.3)
    assert row.cells == ["PSNR", "1", "2", "0.2", "0.3", "yes"]
    assert replace(row, difference=0.4).cells[-1] == "**no**"
    # What is not a number agrees with nothing.
    assert not replace(row, difference=float("nan")).holds
    assert Row("anchors", "1", "2").cells == ["anchors", "1", "2", "", "", ""]
    assert not holds([row, replace(row, difference=0.4)])


def test_two_outcomes() -> None:
    one = Outcome(25.0, 1000, 60.0, 500, "a", "a")
    assert holds(trainings_agree(one, replace(one, psnr=24.8, size=1020, digest="b", again="b")))
    for other in (replace(one, psnr=24.5), replace(one, size=1100), replace(one, again="b")):
        assert not holds(trainings_agree(one, other))


def test_networks() -> None:
    assert networks_agree("cpu").holds


@pytest.mark.slow
def test_a_cpu_agrees_with_itself(tmp_path: Path) -> None:
    rows = steps_agree("cpu", tmp_path, SMALL)
    assert all(row.difference == 0 for row in rows)
    told = {row.what for row in rows}
    assert {"image before the first step, mean difference", "gradient of features, the last step"} <= told
    # Every row compares something.
    assert all(float(row.cpu) != 0 for row in rows)


@pytest.mark.slow
def test_the_file_of_a_training(tmp_path: Path) -> None:
    found = trained("cpu", tmp_path, SMALL, time.monotonic() + 600)
    assert found.digest == found.again
    assert found.psnr > 10
    assert found.size == (tmp_path / "cpu.c3gs").stat().st_size
    with pytest.raises(LateError):
        trained("cpu", tmp_path / "late", SMALL, time.monotonic() - 1)
