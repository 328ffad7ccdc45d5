"""Rate-distortion curves: Bjontegaard's deltas of known curves, and the command. Its training is simulated."""

from __future__ import annotations

import csv
import json
import math
import signal
import subprocess
import sys
from pathlib import Path

import pytest

for package in ("numba", "PIL", "skimage", "scipy", "matplotlib", "bjontegaard", "torch"):
    pytest.importorskip(package, reason="curves need the packages of the extras train, render and rd")

from PIL import Image  # noqa: E402

from refcodec.cli.main import main  # noqa: E402
from refcodec.experiments import runs  # noqa: E402
from refcodec.experiments.figures import compare  # noqa: E402
from refcodec.experiments.rd import COLUMNS, read_curve  # noqa: E402
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
    with (folder / "rd.csv").open(newline="") as file:
        return list(csv.DictReader(file))


@pytest.mark.slow
@pytest.mark.usefixtures("fake")
def test_rd(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "curve"
    command = ["rd", PHOTOGRAPHS, "-o", str(out), "--steps", "2", "--size", "40", "--rates"]
    assert main([*command, "0.04", "--uncompressed"]) == 0
    assert "done before" not in capsys.readouterr().err
    table = rows(out)
    assert tuple(table[0]) == COLUMNS
    assert [row["rate"] for row in table] == ["0", "0.04"]
    for row in table[1:]:
        assert int(row["bytes"]) == (out / f"rate-{row['rate']}.c3gs").stat().st_size
        assert float(row["bits_per_anchor"]) == pytest.approx(8 * int(row["bytes"]) / int(row["anchors"]), rel=1e-5)
    for row in table:
        assert sum(int(row[part]) for part in COLUMNS[2:8]) == int(row["bytes"])
    assert Image.open(out / "rd.png").size == (960, 660)
    # Rates more: the others are not trained again.
    assert main([*command, "0.04", "0.01", "0.004", "0.002", "--uncompressed"]) == 0
    assert capsys.readouterr().err.count("train: done before") == 2
    other = tmp_path / "other.csv"
    other.write_text("bytes,psnr\n" + "".join(f"{int(row['bytes']) * 1.25},{row['psnr']}\n" for row in rows(out)[1:]))
    assert main([*command, "0.04", "0.01", "0.004", "0.002", "--against", str(other)]) == 0
    assert "BD-rate -20.00 %" in capsys.readouterr().out
    # Before any training: too few rates.
    assert main([*command, "0.04", "0.03", "--against", str(other)]) == 64
    assert "needs 4 rates" in capsys.readouterr().err
    assert not (out / "rate-0.03").exists()


@pytest.mark.usefixtures("fake")
def test_options_of_train_are_passed_on(tmp_path: Path) -> None:
    """The training runs get them unchanged. The held-out photographs are compared."""
    out = tmp_path / "curve"
    given = "--background 9,20,30 --holdout 30 --anchors 700 --set masks.epsilon=0.02 --set size=40"
    command = ["rd", PHOTOGRAPHS, "-o", str(out), "--steps", "2", "--rates", "0.04", *given.split()]
    assert main(command) == 0
    notes = json.loads((out / "rd.json").read_text())["commands"]
    train, evaluated = (notes[f"rate-0.04 {name}"]["arguments"] for name in ("train", "eval"))
    assert " ".join(train).endswith(f"{given} --size 40 --threads {train[-2]} --progress")
    assert evaluated[-5:] == ["--size", "40", "--holdout", "30", "--json"]
    assert len(json.loads((out / "rate-0.04.json").read_text())["images"]) == 3
    # As train refuses them, before any training.
    for wrong in ("--holdout -1", "--voxel 0", "--voxel 1 --anchors 9", "--set masks.epsilom=1", "--background grey"):
        assert main([*command[:2], "-o", str(tmp_path / "none"), *wrong.split()]) == 64
    assert main([*command, "--set", "rate.weight=0.1"]) == 64
    assert not (tmp_path / "none").exists()


@pytest.mark.slow
@pytest.mark.usefixtures("fake")
def test_interrupted(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    out = tmp_path / "curve"
    arguments = ["rd", PHOTOGRAPHS, "-o", str(out), "--steps", "400", "--size", "40", "--rates", "0.01", "--jobs", "1"]
    program = f"import sys; from refcodec.experiments import runs; runs.PROGRAM = {FAKE!r}\n"
    program += f"from refcodec.cli.main import main; sys.exit(main({arguments!r}))"
    monkeypatch.setenv("FAKE_STEP", "20")
    with subprocess.Popen([sys.executable, "-c", program], stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr is not None
        process.stderr.readline()
        process.send_signal(signal.SIGINT)
        _, printed = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "0 of 1 rates done" in printed
    monkeypatch.setenv("FAKE_STEP", "0")
    state = out / "rate-0.01.train-state"
    saved = state.read_bytes()
    assert main(arguments) == 0
    printed = capsys.readouterr().err
    steps = [int(line.split()[-1]) for line in printed.splitlines() if "train: step" in line]
    assert steps[0] > 1
    assert steps[-1] == 400
    # With other settings it begins anew, and what an interrupt left is in nobody's way.
    state.write_bytes(saved)
    assert main([*arguments, "--seed", "3"]) == 0
    assert "train: step 1\n" in capsys.readouterr().err
    assert not state.exists()
    assert [row["rate"] for row in rows(out)] == ["0.01"]


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
    for name in ("refcodec.experiments.rd", "refcodec.experiments.figures", "bjontegaard"):
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "bjontegaard", None)
    assert main(["rd", PHOTOGRAPHS, "-o", out]) == 64
    assert "pip install 'refcodec[train,render,rd]'" in capsys.readouterr().err
    assert not Path(out).exists()
