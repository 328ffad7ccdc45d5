"""What departures are worth: differences by seed, at equal bytes, and what may be said of them."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from benchmarks import departures, results, statements
from benchmarks.peers.runs import Run
from refcodec.train.settings import TrainSettings

HEAD = "scene,method,rate,seed,bytes,psnr\n"


def csv(folder: Path, rows: dict[tuple[str, float, int], tuple[int, float]]) -> Path:
    folder.mkdir()
    lines = [f"s,{method},{rate},{seed},{size},{psnr}\n" for (method, rate, seed), (size, psnr) in rows.items()]
    (folder / "results.csv").write_text(HEAD + "".join(lines))
    return folder


def test_a_curve_goes_through_its_points_and_on_from_them() -> None:
    curve = [(1000.0, 30.0), (2000.0, 31.0), (4000.0, 31.5)]
    assert [departures.at_bytes(curve, size) for size in (500, 1000, 2000, 2000 * 2**0.5, 4000, 8000)] == pytest.approx(
        [29.0, 30.0, 31.0, 31.25, 31.5, 32.0]
    )


def test_verdicts() -> None:
    """A difference must be twice its spread, and 0.05 dB."""
    assert departures.verdict(np.array([-0.3, -0.2, -0.25])) == "the departure is better"
    assert departures.verdict(np.array([0.3, 0.2, 0.25])) == "the departure is worse"
    assert departures.verdict(np.array([-0.3, 0.2, 0.25])) == "cannot be told"
    assert departures.verdict(np.array([-0.04, -0.04, -0.04])) == "cannot be told"
    assert departures.verdict(np.array([-0.5])) == departures.verdict(np.array([-0.5, -0.5])) == "cannot be told"


def test_section(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A seed is compared with itself: what seeds differ by alone is no difference of methods."""
    monkeypatch.setattr(results, "RESULTS", tmp_path / "RESULTS.md")
    base = {("pro", 0.002, seed): (1000 * (seed + 1), 30.0 + seed) for seed in range(3)}
    others = {("other", 0.002, seed): (2000 * (seed + 1), 30.5 + seed) for seed in range(3)}
    rates = base | {("pro", 0.001, seed): (2000 * (seed + 1), 31.0 + seed) for seed in range(3)}
    one, two = csv(tmp_path / "one", base | others), csv(tmp_path / "two", rates)
    assert departures.main([str(one), str(two)]) == 0
    text = results.RESULTS.read_text()
    assert "| other | 3 | +0.50 ± 0.00 | +100.0 ± 0.0 % | -0.50 ± 0.00 | the departure is better |" in text


def test_one_rate_makes_no_curve(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rows = {(method, 0.002, 0): (1000, 30.0) for method in ("pro", "other")}
    one, two = csv(tmp_path / "one", rows), csv(tmp_path / "two", rows)
    assert departures.main([str(one), str(two)]) == 64
    assert "one rate makes no curve" in capsys.readouterr().err


def test_one_seed_has_no_spread(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(results, "RESULTS", tmp_path / "RESULTS.md")
    base = {("pro", 0.002, 0): (1000, 30.0), ("pro", 0.001, 0): (2000, 31.0)}
    one = csv(tmp_path / "one", {("pro", 0.002, 0): (1000, 30.0), ("other", 0.002, 0): (2000, 30.5)})
    assert departures.main([str(one), str(csv(tmp_path / "two", base))]) == 0
    assert "| other | 1 | +0.50 | +100.0 % | -0.50 | cannot be told |" in results.RESULTS.read_text()


def test_no_results(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert departures.main([str(tmp_path), str(tmp_path)]) == 64
    assert "results.csv" in capsys.readouterr().err


# --- entropy models of others ----------------------------------------------------------------------------------------


def test_models_are_compared_by_seed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(results, "RESULTS", tmp_path / "RESULTS.md")
    for method in ("c3gs", *statements.OTHERS):
        planes, loss = 1100 if method == "triplane" else 100, 0.5 if method == "plane" else 0.0
        for seed in range(3):
            lengths = {"attributes": 900 + 1000 * seed, "planes": planes}
            size = lengths["attributes"] + planes
            files = {"C3GS": {"psnr": 0.0}, f"{method}, code lengths": {"psnr": 30 + seed - loss, "bytes": size}}
            run = Run(tmp_path, method, 0, seed, 200, 1)
            result = run.record(1, TrainSettings(), files, lengths=lengths)
            (tmp_path / f"{method}-{seed}.json").write_text(json.dumps(result))
    # A doubling of bytes is worth 0.8 dB.
    rates = {("pro", rate, seed): (1000 * 8**rate, 30 + 2.4 * rate) for rate in (0, 1) for seed in range(3)}
    assert statements.main([str(tmp_path), str(csv(tmp_path / "rates", rates))]) == 0
    text = results.RESULTS.read_text()
    told = "+1,000 ± 0 | +0 ± 0 | +61.1 ± 34.7 % | +0.00 ± 0.00 | -0.53 ± 0.24 | the format is better"
    assert f"| 3 | {told} |" in text
    assert "| 3 | +0 ± 0 | +0 ± 0 | +0.0 ± 0.0 % | -0.50 ± 0.00 | -0.50 ± 0.00 | the format is better |" in text


def test_a_model_is_missing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rates = csv(tmp_path / "rates", {("pro", 0, 0): (1000, 30)})
    assert statements.main([str(tmp_path), str(rates)]) == 64
    assert "triplane" in capsys.readouterr().err
