"""Tables and curves of an experiment: their figures against figures computed by hand."""

import math
from pathlib import Path
from typing import Any

import pytest
from PIL import Image

from refcodec.experiments.jobs import RunError
from refcodec.experiments.tables import COLUMNS, Row, as_csv, as_markdown, compare, draw, spread, write_curves

LAMBDAS = (0.04, 0.02, 0.01, 0.005)


def one(scene: str, method: str, lambda_r: float, seed: int, size: int, psnr: float) -> Row:
    figures: dict[str, Any] = {"bytes": size, "psnr": psnr, "ssim": 0.9, "processor_seconds": 60 + seed}
    figures |= {"attributes": size - 100, "headers": 100, "anchors": size // 10}
    name = {"scene": scene, "method": method, "lambda_r": lambda_r, "seed": seed}
    return dict.fromkeys(COLUMNS, 0) | name | figures


def curve(scene: str, method: str, seed: int, factor: float, more: float = 0.0) -> list[Row]:
    """A straight line over the logarithm of the size: a fifth less everywhere is a BD-rate of -20 %."""
    sizes = enumerate(LAMBDAS)
    return [one(scene, method, value, seed, round(factor * 10000 * 2**i), 20 + 3 * i + more) for i, value in sizes]


def cells(text: str, *first: str) -> list[str]:
    """The cells of the one row of Markdown that begins with these."""
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in text.splitlines() if line.startswith("|")]
    (row,) = [row for row in rows if row[: len(first)] == list(first)]
    return row


def test_means_and_spreads() -> None:
    """Sizes 1000, 1200 and 1700: mean 1300, squares 90000 + 10000 + 160000 = 260000, over 2 130000, root 360.6."""
    rows = [one("s", "m", 0.01, seed, size, 20 + size / 100) for seed, size in enumerate((1000, 1200, 1700))]
    rows.append(one("s", "u", 0.0, 0, 9000, 40.125))
    text = as_markdown("x", rows, "1 of 5 cells are missing: s/m", None)
    assert "1 of 5 cells are missing: s/m" in text
    assert "BD-rate" not in text
    row = cells(text, "m")
    assert row[:4] == ["m", "0.01", "3", "33.00 ± 3.61"]
    assert row[5:8] == ["1,300 ± 361", "0 ± 0", "1,200 ± 361"]
    assert row[-2:] == ["130 ± 36", "61 ± 1"]
    assert cells(text, "u")[:6] == ["u", "uncompressed", "1", "40.12", "0.9000", "9,000"]
    assert spread([2, 4, 9]) == (5, pytest.approx(math.sqrt(13)))
    head, line, *_ = as_csv([one("s", "m", 0.004, 3, 1234567, 33.123456789)]).split("\n")
    assert head == ",".join(COLUMNS)
    row_of = dict(zip(COLUMNS, line.split(","), strict=True))
    assert (row_of["lambda_r"], row_of["bytes"], row_of["psnr"]) == ("0.004", "1234567", "33.1235")


def test_bd_rates() -> None:
    """A method that saves 20 % with one seed and 10 % with another: -15, with a deviation of 10 / sqrt(2)."""
    rows = [row for seed in (0, 1) for row in curve("s", "base", seed, 1 + seed)]
    rows += curve("s", "less", 0, 0.8) + curve("s", "less", 1, 2 * 0.9)
    rows += [one("s", "u", 0.0, 0, 10**6, 50.0)]
    # Three decibels for twice the bytes.
    psnr = compare(curve("s", "a", 0, 1), curve("s", "b", 0, 0.8)).psnr
    assert psnr == pytest.approx(3 * math.log2(1 / 0.8), abs=0.01)
    text = as_markdown("x", rows, "", "base")
    assert cells(text, "s", "less", "2")[2:6] == ["2", "-15.00 ± 7.07", "0.711 ± 0.360", "0: -20.00, 1: -10.00"]
    assert "| scenes |" not in text
    # -15 and -30 on two scenes.
    more = [row for factor, method in ((1, "base"), (0.7, "less")) for row in curve("t", method, 0, factor)]
    assert cells(as_markdown("x", rows + more, "", "base"), "less", "2") == ["less", "2", "-22.50"]
    assert "No other method" in as_markdown("x", curve("s", "base", 0, 1), "", "base")


@pytest.mark.parametrize(
    ("test", "words"),
    [
        (curve("s", "few", 0, 1)[:3], "not enough points: 3, but 4 are needed"),
        (curve("s", "apart", 0, 1, 50.0), "in common"),
        ([*curve("s", "bent", 0, 1)[:3], one("s", "bent", 0.001, 0, 10**6, 0.0)], "PSNR rises"),
    ],
)
def test_curves_without_a_bd_rate(test: list[Row], words: str) -> None:
    with pytest.raises(RunError, match=words):
        compare(curve("s", "base", 0, 1), test)
    row = cells(as_markdown("x", curve("s", "base", 0, 1) + test, "", "base"), "s", test[0]["method"], "0")
    assert row[2:6] == ["0", "-", "-", ""]
    assert words in row[6]


def test_curves(tmp_path: Path) -> None:
    rows = curve("s", "m", 0, 1) + curve("s", "m", 1, 1.2, 1.0) + [one("s", "u", 0.0, 0, 10**6, 50.0)]
    axes = draw("s", rows).axes[0]
    line, ring = (container.lines[0] for container in axes.containers)
    # Means of both seeds, in the order of their sizes.
    assert list(line.get_xdata()) == [11000, 22000, 44000, 88000]
    assert list(line.get_ydata()) == [20.5, 23.5, 26.5, 29.5]
    assert (list(ring.get_xdata()), list(ring.get_ydata())) == ([10**6], [50.0])
    # The bars of PSNR are as long as the sample standard deviation, 1 / sqrt(2), on both sides.
    low, high = axes.containers[0].lines[2][1].get_segments()[0]
    assert high[1] - low[1] == pytest.approx(2 / math.sqrt(2))
    write_curves(tmp_path / "a", rows)
    assert Image.open(tmp_path / "a" / "s.png").size == (960, 660)
    write_curves(tmp_path / "b", rows)
    assert (tmp_path / "a" / "s.svg").read_bytes() == (tmp_path / "b" / "s.svg").read_bytes()
