"""Rate-distortion curves: Bjontegaard's deltas of known curves, and the command. Its training is simulated."""

from __future__ import annotations

import csv
import json
import math
import sys
from pathlib import Path

import pytest

for package in ("numba", "PIL", "skimage", "scipy", "matplotlib", "bjontegaard", "torch"):
    pytest.importorskip(package, reason="curves need the packages of the extras train, render and rd")

from refcodec.cli.main import main  # noqa: E402
from refcodec.experiments import runs  # noqa: E402
from refcodec.experiments.figures import compare  # noqa: E402
from refcodec.experiments.plan import read_experiment  # noqa: E402
from refcodec.experiments.rd import read_curve, scene_name  # noqa: E402
from refcodec.experiments.runs import RunError  # noqa: E402

ROOT = Path(__file__).resolve().parents[2]
FAKE = (sys.executable, str(ROOT / "tests" / "experiments" / "fake_refcodec.py"))
PHOTOGRAPHS = str(ROOT / "examples" / "photographs" / "caliterra")


def curve(
    factor: float = 1.0, more: float = 0.0, sizes: tuple[float, ...] = (1e6, 2e6, 4e6, 9e6, 2e7)
) -> list[dict[str, float]]:
    """PSNR that rises with the logarithm of the size; the sizes are then multiplied, and the PSNR raised."""
    return [
        {"bytes": size * factor, "psnr": 20 + 3 * math.log10(size) ** 1.5 / 10 + more, "rate": 1 / size}
        for size in sizes
    ]


def test_known_differences() -> None:
    """A fifth less everywhere is -20 %; half a decibel more everywhere is 0.5 dB."""
    assert compare(curve(), curve(0.8)).rate == pytest.approx(-20)
    assert compare(curve(0.8), curve()).rate == pytest.approx(25)
    assert compare(curve(), curve(more=0.5)).psnr == pytest.approx(0.5)
    same = compare(curve(), curve())
    assert (same.rate, same.psnr, same.warning) == (0, 0, "")
    # Other sizes of a straight line, in another order, and a point of an uncompressed scene.
    straight = [
        [{"bytes": 10.0**b, "psnr": 5 * b + more} for b in places]
        for places, more in (((5, 6, 7, 8), 0), ((5.5, 6.5, 7, 8, 5), 1))
    ]
    assert compare(straight[0], [{"bytes": 1e12, "psnr": 99.0, "rate": 0}, *straight[1]]).psnr == pytest.approx(1)
    assert compare(*straight).rate == pytest.approx(100 * (10**-0.2 - 1))


def test_differences_without_an_answer() -> None:
    with pytest.raises(RunError, match="in common"):
        compare(curve(), curve(more=50))
    bent = curve()
    bent[2]["psnr"] = 0
    with pytest.raises(RunError, match="rises"):
        compare(bent, curve())
    assert "three quarters" in compare(curve(), curve(sizes=(1e7, 2e7, 4e7, 8e7))).warning


def test_reading_a_curve(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("name,bytes,psnr\na,100,30\nb,200,31.5\n")
    assert read_curve(path) == [{"bytes": 100, "psnr": 30}, {"bytes": 200, "psnr": 31.5}]
    path.write_text("rate,bytes,psnr\n0,900,33\n0.1,200,31.5\n")
    assert read_curve(path) == [{"bytes": 200, "psnr": 31.5}]
    for text in ("bytes\n1\n", "bytes,psnr\n1,x\n", "bytes,psnr\n1\n", "bytes,psnr\n0,30\n", "bytes,psnr\n1,nan\n"):
        path.write_text(text)
        with pytest.raises(RunError):
            read_curve(path)
    with pytest.raises(RunError, match="No such file"):
        read_curve(tmp_path / "none")


# --- the command ------------------------------------------------------------------------------------------------------


@pytest.fixture
def fake(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(runs, "PROGRAM", FAKE)
    monkeypatch.setenv("PYTHONPATH", str(ROOT))


def rows(folder: Path) -> list[dict[str, str]]:
    with (folder / "results.csv").open(newline="") as file:
        return list(csv.DictReader(file))


def cell(folder: Path, rate: str, method: str = "coded") -> Path:
    return folder / "cells" / "caliterra" / method / f"rate-{rate}" / "seed-0"


@pytest.mark.slow
@pytest.mark.usefixtures("fake")
def test_rd(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "curve"
    command = ["rd", PHOTOGRAPHS, "-o", str(out), "--steps", "2", "--size", "40", "--rates"]
    assert main([*command, "0.04", "--uncompressed"]) == 0
    assert "| coded | 0.04 | 1 |" in capsys.readouterr().out
    assert [row["rate"] for row in rows(out)] == ["0.04", "0"]
    assert int(rows(out)[0]["bytes"]) == (cell(out, "0.04") / "work" / "scene.c3gs").stat().st_size
    assert (cell(out, "0", "uncompressed") / "work" / "scene").is_dir()
    # More rates: the others are not trained again.
    assert main([*command, "0.04", "0.01", "0.004", "0.002", "--uncompressed"]) == 0
    assert "2 of 5 cells are done before" in capsys.readouterr().err
    other = tmp_path / "other.csv"
    other.write_text("bytes,psnr\n" + "".join(f"{int(row['bytes']) * 1.25},{row['psnr']}\n" for row in rows(out)[:4]))
    before = (out / "curves" / "caliterra.svg").read_text()
    assert main([*command, "0.04", "0.01", "0.004", "0.002", "--against", str(other)]) == 0
    assert "BD-rate -20.00 %" in capsys.readouterr().out
    assert str(other) in (out / "curves" / "caliterra.svg").read_text()
    assert str(other) not in before
    # Before any training: too few rates, and a reference that would be overwritten.
    assert main([*command, "0.04", "0.03", "--against", str(other)]) == 64
    assert "needs 4 rates" in capsys.readouterr().err
    assert not cell(out, "0.03").exists()
    assert main([*command, "0.04", "0.01", "0.004", "0.002", "--against", str(out / "results.csv")]) == 64


@pytest.mark.usefixtures("fake")
def test_options_of_train_are_passed_on(tmp_path: Path) -> None:
    """They are in the experiment's file and in the commands of its cells. The held-out photographs are compared."""
    out = tmp_path / "curve"
    given = "--background 9,20,30 --holdout 30 --anchors 700 --up=-z --set masks.epsilon=0.02 --set size=40"
    command = ["rd", PHOTOGRAPHS, "-o", str(out), "--steps", "2", "--rates", "0.04", *given.split()]
    assert main(command) == 0
    (scene,) = read_experiment(out / "experiment.toml").scenes
    assert (scene.photographs, scene.size, scene.background, scene.holdout) == (PHOTOGRAPHS, "40", "9,20,30", 30)
    assert (scene.anchors, scene.up, scene.assignments) == (700, "-z", ("masks.epsilon=0.02",))
    result = json.loads((cell(out, "0.04") / "result.json").read_text())
    train, _, evaluated = result["definition"]["commands"]
    words = "--lambda 0.04 --seed 0 --size 40 --holdout 30 --background 9,20,30 --steps 2 --up=-z"
    assert " ".join(train).endswith(f"{words} --set start.anchors=700 --set masks.epsilon=0.02")
    assert evaluated[-5:] == ["--size", "40", "--holdout", "30", "--json"]
    assert len(result["images"]) == 3
    # As train refuses them, before any training.
    for wrong in ("--holdout -1", "--voxel 0", "--voxel 1 --anchors 9", "--set masks.epsilom=1", "--background grey"):
        assert main([*command[:2], "-o", str(tmp_path / "none"), *wrong.split()]) == 64
    assert main([*command, "--set", "rate.lambda_r=0.1"]) == 64
    assert not (tmp_path / "none").exists()


def test_the_name_of_a_scene_is_that_of_its_folder() -> None:
    assert [scene_name(Path("/a", name)) for name in ("b_1.c", "a b/", ".é.", "x" * 70)] == [
        "b_1.c",
        "a-b",
        "scene",
        "x" * 64,
    ]


def test_what_is_wrong_is_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    out = str(tmp_path / "out")
    for wrong, word in [
        (["--rates", "0"], "above 0"),
        (["--rates", "2"], "above 0"),
        (["--rates", "nan"], "above 0"),
        (["--jobs", "0"], "at least 1"),
        (["--size", "wide"], "400x300"),
        (["--against", out], "No such file"),
    ]:
        assert main(["rd", PHOTOGRAPHS, "-o", out, *wrong]) == 64
        assert word in capsys.readouterr().err
    assert main(["rd", str(tmp_path / "none"), "-o", out]) == 64
    for name in ("rd", "command", "tables", "cells", "figures"):
        monkeypatch.delitem(sys.modules, f"refcodec.experiments.{name}")
    monkeypatch.delitem(sys.modules, "bjontegaard")
    monkeypatch.setitem(sys.modules, "bjontegaard", None)
    assert main(["rd", PHOTOGRAPHS, "-o", out]) == 64
    assert "pip install 'refcodec[train,render,rd]'" in capsys.readouterr().err
    assert not Path(out).exists()
