"""Tables and curves of an experiment: their figures against figures computed by hand."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest

for package in ("PIL", "scipy", "matplotlib", "bjontegaard"):
    pytest.importorskip(package, reason="tables need the packages of the extras train, render and rd")

from PIL import Image  # noqa: E402

from refcodec.experiments.curves import draw, write_curves  # noqa: E402
from refcodec.experiments.tables import COLUMNS, Row, as_csv, as_markdown, deltas, spread  # noqa: E402

RATES = (0.04, 0.02, 0.01, 0.005)


def one(scene: str, method: str, rate: float, seed: int, size: int, psnr: float) -> Row:
    parts: dict[str, Any] = dict.fromkeys(COLUMNS, 0) | {
        "attributes": size - 100,
        "headers": 100,
        "anchors": size // 10,
    }
    figures = {"bytes": size, "psnr": psnr, "ssim": 0.9, "processor_seconds": 60 + seed}
    return parts | {"scene": scene, "method": method, "rate": rate, "seed": seed} | figures


def curve(scene: str, method: str, seed: int, factor: float, more: float = 0.0) -> list[Row]:
    """A straight line over the logarithm of the size: a fifth less everywhere is a BD-rate of -20 %."""
    return [
        one(scene, method, rate, seed, round(factor * 10000 * 2**i), 20 + 3 * i + more) for i, rate in enumerate(RATES)
    ]


def test_spread() -> None:
    """2, 4 and 9: the mean is 5, squares of differences are 9 + 1 + 16 = 26, over 2 it is 13."""
    found = spread([2, 4, 9])
    assert (found.mean, found.count) == (5, 3)
    assert found.deviation == pytest.approx(math.sqrt(13))
    assert found.text(2) == "5.00 ± 3.61"
    assert math.isnan(spread([2]).deviation)
    assert spread([2000]).text(0) == "2,000"


def cells(text: str, *first: str) -> list[str]:
    """The cells of the one row of Markdown that begins with these."""
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in text.splitlines() if line.startswith("|")]
    (found,) = [row for row in rows if row[: len(first)] == list(first)]
    return found


def test_means_and_spreads() -> None:
    """Sizes 1000, 1200 and 1700: mean 1300, squares 90000 + 10000 + 160000 = 260000, over 2 130000, root 360.6."""
    rows = [one("s", "m", 0.01, seed, size, 20 + size / 100) for seed, size in enumerate((1000, 1200, 1700))]
    rows.append(one("s", "u", 0.0, 0, 9000, 40.125))
    text = as_markdown("x", rows, "1 of 5 cells are missing: s/m.", None, {"s": "s"})
    assert "1 of 5 cells are missing: s/m." in text
    assert "BD-rate" not in text
    found = cells(text, "m")
    assert found[:4] == ["m", "0.01", "3", "33.00 ± 3.61"]
    assert found[5:8] == ["1,300 ± 361", "0 ± 0", "1,200 ± 361"]
    assert found[-2:] == ["130 ± 36", "61 ± 1"]
    found = cells(text, "u")
    assert found[:6] == ["u", "uncompressed", "1", "40.12", "0.9000", "9,000"]


def test_bd_rates_of_each_seed() -> None:
    """A method that saves 20 % with one seed and 10 % with another: -15, with a deviation of 10 / sqrt(2)."""
    rows = [row for seed in (0, 1) for row in curve("s", "base", seed, 1 + seed)]
    rows += curve("s", "less", 0, 0.8) + curve("s", "less", 1, 2 * 0.9)
    rows += [one("s", "u", 0.0, 0, 10**6, 50.0)]
    (found,) = deltas(rows, "base")
    assert (found.scene, found.method, dict(found.reasons)) == ("s", "less", {})
    assert found.rates == {0: pytest.approx(-20, abs=0.01), 1: pytest.approx(-10, abs=0.01)}
    # Three decibels for twice the bytes.
    assert found.psnrs[0] == pytest.approx(3 * math.log2(1 / 0.8), abs=0.01)
    text = as_markdown("x", rows, "", "base", {"s": "s"})
    assert cells(text, "s", "less")[2:6] == ["2", "-15.00 ± 7.07", "0.711 ± 0.360", "0: -20.00, 1: -10.00"]
    assert "group" not in text


def test_bd_rates_that_there_are_not() -> None:
    rows = curve("s", "base", 0, 1) + curve("s", "few", 0, 1)[:3] + curve("s", "other", 3, 1)
    rows += curve("s", "apart", 0, 1, 50.0) + curve("t", "few", 0, 1)
    bent = curve("s", "bent", 0, 1)
    bent[1]["psnr"] = 0.0
    text = as_markdown("x", rows + bent, "", "base", {"s": "s", "t": "t"})
    for scene, method, words in (
        ("s", "few", "not enough points: 3, but 4 are needed"),
        ("s", "other", "not enough points: 0, but 4 are needed"),
        ("t", "few", "not enough points: 0, but 4 are needed"),
        ("s", "apart", "in common"),
        ("s", "bent", "PSNR rises"),
    ):
        found = cells(text, scene, method)
        assert found[2:6] == ["0", "-", "-", ""]
        assert words in found[6]
    assert "No other method" in as_markdown("x", curve("s", "base", 0, 1), "", "base", {"s": "s"})


def test_means_over_a_data_set() -> None:
    """-20 and -10 on two scenes of a group are -15; a group of one scene has no row."""
    rows = [row for scene in "abc" for row in curve(scene, "base", 0, 1)]
    rows += curve("a", "m", 0, 0.8) + curve("b", "m", 0, 0.9) + curve("c", "m", 0, 0.5)
    text = as_markdown("x", rows, "", "base", {"a": "set", "b": "set", "c": "alone"})
    assert cells(text, "set") == ["set", "m", "2", "-15.00"]
    assert "alone" not in text


def test_csv() -> None:
    rows = [one("s", "m", 0.004, 3, 1234567, 33.123456789)]
    head, line, rest = as_csv(rows).split("\n")
    assert head == ",".join(COLUMNS)
    found = dict(zip(COLUMNS, line.split(","), strict=True))
    assert (found["rate"], found["bytes"], found["psnr"], rest) == ("0.004", "1234567", "33.1235", "")


def test_curves(tmp_path: Path) -> None:
    rows = curve("s", "m", 0, 1) + curve("s", "m", 1, 1.2, 1.0) + [one("s", "u", 0.0, 0, 10**6, 50.0)]
    axes = draw("s", rows).axes[0]
    assert axes.get_xscale() == "log"
    line, ring = (container.lines[0] for container in axes.containers)
    # Means of both seeds, in the order of their sizes.
    assert list(line.get_xdata()) == [11000, 22000, 44000, 88000]
    assert list(line.get_ydata()) == [20.5, 23.5, 26.5, 29.5]
    assert (list(ring.get_xdata()), list(ring.get_ydata())) == ([10**6], [50.0])
    # The bars of PSNR are as long as the sample standard deviation, 1 / sqrt(2), on both sides.
    low, high = axes.containers[0].lines[2][1].get_segments()[0]
    assert high[1] - low[1] == pytest.approx(2 / math.sqrt(2))
    write_curves(tmp_path / "curves", rows)
    found = {path.name: path.read_bytes() for path in (tmp_path / "curves").iterdir()}
    assert set(found) == {"s.png", "s.svg"}
    assert Image.open(tmp_path / "curves" / "s.png").size == (960, 660)
    write_curves(tmp_path / "curves", rows)
    assert {path.name: path.read_bytes() for path in (tmp_path / "curves").iterdir()} == found
