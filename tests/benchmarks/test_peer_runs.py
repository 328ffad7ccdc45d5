"""Runs, their figures, conversions, and scenes made of splats."""

from __future__ import annotations

import json
import math
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from benchmarks import results
from benchmarks.peers import __main__ as peers
from benchmarks.peers import convert, runs
from benchmarks.peers.__main__ import main
from benchmarks.peers.convert import there_and_back, tool
from benchmarks.peers.figures import Point, bd_rate, bytes_at, figure, scenes
from benchmarks.peers.runs import Run, perform, records
from benchmarks.peers.scene import main as make_scene
from benchmarks.peers.splats import quality, read_ply, write_ply
from benchmarks.peers.table import TableError, commands, report, with_seeds
from benchmarks.peers.trainer import SplatTrainer
from refcodec.convert.splats import drawn
from refcodec.photographs.photographs import PhotographSet, read_photographs
from refcodec.render.rasterise import Settings

MakeSplats = Callable[[int, int], dict[str, torch.Tensor]]

# --- figures ----------------------------------------------------------------------------------------------------------


def record(label: str, strength: float, seed: int, size: int, psnr: float) -> dict[str, Any]:
    shown = {"bytes": size, "psnr": psnr, "ssim": 0.9}
    run = {"scene": "a", "size": 200, "steps": 10, "changes": [], "strength": strength, "seed": seed, "seconds": 5.0}
    return {**run, "files": {label: shown}}


def curve(*points: tuple[float, float]) -> list[Point]:
    return [Point(0, 1, figure([b]), figure([p]), figure([0.9]), figure([1.0])) for b, p in points]


def test_mean_and_spread() -> None:
    found = figure([30.0, 31.0, 35.0])
    # Deviations of -2, -1 and 3, squared 14, over two.
    assert (found.mean, found.spread) == (32, pytest.approx(math.sqrt(7)))
    assert found.words(2) == "32.00 ± 2.65"
    assert figure([3.0]).words(1) == "3.0"


def test_runs_are_grouped_by_method_and_strength() -> None:
    given = [record("X", s, seed, 100 * s, 30.0 + s + seed) for s in (2, 1) for seed in (0, 1)]
    (scene,) = scenes([*given, record("Y", 1, 0, 70, 20)])
    assert [(p.strength, p.seeds, p.bytes.mean, p.psnr.mean) for p in scene.curves["X, 10 steps"]] == [
        (1, 2, 100, 31.5),
        (2, 2, 200, 32.5),
    ]
    assert [p.seeds for p in scene.curves["Y, 10 steps"]] == [1]


def test_only_seeds_are_averaged() -> None:
    """Other steps and other settings are other methods."""
    one = record("X", 1, 0, 100, 30)
    others = [{**one, "steps": 20}, {**one, "changes": ["degree=0"]}, {**one, "size": 400}]
    found = scenes([one, *others])
    assert [sorted(scene.curves) for scene in found] == [
        ["X, 10 steps", "X, 10 steps, degree=0", "X, 20 steps"],
        ["X, 10 steps"],
    ]
    assert {point.seeds for scene in found for curve in scene.curves.values() for point in curve} == {1}


def test_bytes_between_two_points() -> None:
    """Half way between 100 and 400 bytes on a logarithmic axis lies 200."""
    found = curve((100, 30), (400, 32), (800, 33))
    assert bytes_at(found, 31) == pytest.approx(200)
    assert bytes_at(found, 32) == pytest.approx(400)
    assert bytes_at(found, 30) == pytest.approx(100)
    assert bytes_at(found, 33) == pytest.approx(800)
    assert bytes_at(found, 29.9) is None
    assert bytes_at(found, 33.1) is None


def test_bytes_of_one_point() -> None:
    assert bytes_at(curve((100, 30)), 30) == 100
    assert bytes_at(curve((100, 30)), 31) is None


def test_bd_rate() -> None:
    """Half the bytes at every PSNR are a BD-rate of -50 %."""
    base = curve((100, 30), (200, 31), (400, 33))
    assert bd_rate(base, curve((50, 30), (100, 31), (200, 33))) == pytest.approx(-50)
    assert bd_rate(base, base) == pytest.approx(0)
    assert bd_rate(base, curve((50, 20), (60, 21))) == "no PSNR in common"
    assert bd_rate(base, curve((50, 31))) == "fewer than two points"
    # A point that is larger and worse is left out.
    assert bd_rate(base, curve((50, 30), (60, 29), (100, 31), (200, 33))) == pytest.approx(-50)


def test_the_report_says_where_it_would_extrapolate() -> None:
    given = [
        record("X", 1, 0, 100, 30),
        record("X", 2, 0, 400, 32),
        record("Y", 1, 0, 50, 31),
        record("Y", 2, 0, 99, 34),
    ]
    text = "\n".join(report(scenes(given), "X, 10 steps"))
    assert "| Y, 10 steps | 1 | 1 | 50 | 31.00 | 0.9000 | 5 |" in text
    assert "| 30.00 | 0.1 | beyond its 31.00 to 34.00 dB |" in text
    # A third of the way from 50 to 99 bytes: 62.8, which is 6.37 times smaller.
    assert "| 32.00 | 0.4 | 0.1, 6.37 |" in text
    with pytest.raises(TableError, match="'Z'; there are: X, 10 steps, Y, 10 steps"):
        report(scenes(given), "Z")


def test_few_seeds_are_no_result() -> None:
    given = [record("X", 1, seed, 100, 30) for seed in range(3)] + [record("X", 2, 0, 200, 31), record("Y", 1, 0, 9, 9)]
    (scene,) = with_seeds(scenes(given), 3)
    assert {label: [p.strength for p in curve] for label, curve in scene.curves.items()} == {"X, 10 steps": [1]}
    assert with_seeds(scenes(given), 4) == []


def test_the_commands_of_the_runs() -> None:
    given = [{**record("X", s, seed, 1, 1), "method": "x"} for s in (0.5, 8000.0) for seed in (1, 0)]
    given.append({**given[0], "changes": ["a.b=1"]})
    words = "python -m benchmarks.peers run a FOLDER --method x --strengths"
    assert commands(given, 2) == [f"{words} 0.5 8000 --seeds 0 1 --size 200 --steps 10"]
    assert commands(given, 1)[1] == f"{words} 0.5 --seeds 1 --size 200 --steps 10 --set a.b=1"


# --- runs -------------------------------------------------------------------------------------------------------------


def small(folder: Path) -> Run:
    return Run(folder, "3dgs", 300, 0, 40, 12, ("density.period=5",))


def test_a_whole_run_is_not_run_again(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Without splat-transform there is a PLY file, and a word of how to get the rest."""
    monkeypatch.setattr(runs, "tool", lambda: None)
    made = perform(small(folder), tmp_path)
    assert made is not None
    assert set(made["files"]) == {"3DGS, PLY"}
    assert "npm install" in capsys.readouterr().err
    ply = next(tmp_path.glob("*.ply"))
    assert made["files"]["3DGS, PLY"]["bytes"] == ply.stat().st_size
    assert made["gaussians"] == len(read_ply(ply)["mean"])
    monkeypatch.setattr(runs, "read_photographs", lambda *_, **__: pytest.fail("it was run again"))
    assert perform(small(folder), tmp_path) == made
    assert records(tmp_path) == [made]


def test_a_record_of_other_settings_is_refused(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A default may change after a run was made. Its points must not stand beside new ones."""
    monkeypatch.setattr(runs, "tool", lambda: None)
    made = perform(small(folder), tmp_path)
    assert made is not None
    made["settings"]["density"]["gradient"] = 0.5
    next(tmp_path.glob("*.json")).write_text(json.dumps(made))
    with pytest.raises(ValueError, match=r"density.gradient is 0.5, not 0.0002"):
        perform(small(folder), tmp_path)


def test_an_interrupted_run_goes_on(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The same run again ends as one that was not interrupted."""
    monkeypatch.setattr(runs, "tool", lambda: None)
    whole = perform(small(folder), tmp_path / "whole")
    step = SplatTrainer.step

    def interrupted(trainer: SplatTrainer) -> None:
        step(trainer)
        if trainer.done == 7:
            signal.raise_signal(signal.SIGINT)

    with monkeypatch.context() as patch:
        patch.setattr(SplatTrainer, "step", interrupted)
        assert perform(small(folder), tmp_path / "part") is None
    assert not list((tmp_path / "part").glob("*.json"))
    steps = []
    monkeypatch.setattr(SplatTrainer, "step", lambda trainer: (steps.append(trainer.done), step(trainer)))
    part = perform(small(folder), tmp_path / "part")
    assert steps == [7, 8, 9, 10, 11]
    assert whole is not None
    assert part is not None
    assert part["files"] == whole["files"]


def test_a_run_gets_its_other_formats_later(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It is not trained again for that. Here a copy of the PLY file stands for both formats."""

    def copied(ply: Path, suffix: str) -> tuple[Path, Path]:
        coded, again = ply.with_suffix(f".{suffix}"), ply.with_name("again.ply")
        coded.write_bytes(b"12345")
        again.write_bytes(ply.read_bytes())
        return coded, again

    monkeypatch.setattr(runs, "tool", lambda: None)
    first = perform(small(folder), tmp_path)
    assert first is not None
    monkeypatch.setattr(runs, "tool", lambda: Path("splat-transform"))
    monkeypatch.setattr(runs, "there_and_back", copied)
    monkeypatch.setattr(runs, "SplatTrainer", lambda *_: pytest.fail("it was trained again"))
    second = perform(small(folder), tmp_path)
    assert second is not None
    assert set(second["files"]) == {"3DGS, PLY", "3DGS, SPZ", "3DGS, SOG"}
    assert second["files"]["3DGS, SPZ"] == {**first["files"]["3DGS, PLY"], "bytes": 5}
    assert perform(small(folder), tmp_path) == second


def test_commands(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(runs, "tool", lambda: None)
    words = ["run", str(folder), str(tmp_path), "--method", "3dgs", "--size", "40", "--steps", "3"]
    assert main([*words, "--strengths", "200", "400", "--seeds", "0", "1"]) == 0
    assert len(records(tmp_path)) == 4
    assert main(["table", str(tmp_path), "--baseline", "3DGS, PLY, 3 steps"]) == 0
    text = (tmp_path / "peers.md").read_text()
    assert text.count("| 3DGS, PLY, 3 steps | 200 | 2 |") == 1
    assert (tmp_path / "peers.svg").read_text().startswith("<?xml")
    assert main(["table", str(tmp_path), "--baseline", "another"]) == 64
    monkeypatch.setattr(results, "RESULTS", tmp_path / "RESULTS.md")
    # Two seeds are few.
    assert main(["table", str(tmp_path), "--baseline", "3DGS, PLY, 3 steps", "--results"]) == 64
    (tmp_path / "tables.md").write_text("# small\n")
    own = ["--experiment", str(tmp_path), "--results", "--seeds", "2"]
    assert main(["table", str(tmp_path), "--baseline", "3DGS, PLY, 3 steps", *own]) == 0
    text = results.RESULTS.read_text()
    assert "<!-- peers-few: begin -->" in text
    assert "table FOLDER --experiment small --results --seeds 2\n" in text
    assert "| 3DGS, PLY, 3 steps | 200 | 2 |" in text


@pytest.mark.parametrize("text", ["[1]", "3", "{}", '{"scene": "a"}', "{", ""])
def test_a_file_that_is_no_record(tmp_path: Path, text: str, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "other.json").write_text(text)
    assert main(["table", str(tmp_path)]) == 64
    assert "other.json" in capsys.readouterr().err


def test_each_size_has_a_section(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(runs, "tool", lambda: None)
    monkeypatch.setattr(results, "RESULTS", tmp_path / "RESULTS.md")
    monkeypatch.setattr(peers, "SEEDS", 1)
    words = ["run", str(folder), str(tmp_path), "--method", "3dgs", "--strengths", "200", "--seeds", "0"]
    for size, steps in (("40", "3"), ("20", "3"), ("20", "4")):
        assert main([*words, "--size", size, "--steps", steps]) == 0
    table = ["table", str(tmp_path), "--baseline", "3DGS, PLY, 3 steps", "--results", "--seeds", "1"]
    assert main(table) == 0
    small, large = results.RESULTS.read_text().split("<!-- peers-40: begin -->")
    assert "## Peers in one harness, 20 pixels" in small
    assert small.count("benchmarks.peers run") == small.count("--size 20 ") == 2
    assert large.count("benchmarks.peers run") == large.count("--size 40 ") == 1
    assert "| 3DGS, PLY, 4 steps | 200 | 1 |" in small
    assert "| 3DGS, PLY, 4 steps | 200 | 1 |" not in large
    # The table of the folder has them all.
    whole = (tmp_path / "peers.md").read_text()
    assert [whole.count(f"### {folder.name}, {size} pixels") for size in (20, 40)] == [1, 1]
    # Made again, a section stands where it was.
    assert main(table) == 0
    assert results.RESULTS.read_text().count("## Peers") == 2


def test_a_ply_file_by_a_command(folder: Path, tmp_path: Path) -> None:
    output = tmp_path / "scene.ply"
    words = ["train", str(folder), "-o", str(output), "--size", "40", "--steps", "5", "--most", "200"]
    assert main([*words, "--set", "degree=0"]) == 0
    assert read_ply(output)["rest"].shape[1] == 0
    assert main([*words, "--set", "degrees=0"]) == 64
    assert main(["train", str(tmp_path / "nothing"), "-o", str(output)]) == 64


@pytest.mark.slow
@pytest.mark.parametrize("strength", [0, 0.004])
def test_a_run_of_the_format(folder: Path, tmp_path: Path, strength: float) -> None:
    changes = ("start.anchors=200", "growth.most=300")
    made = perform(Run(folder, "c3gs", strength, 0, 40, 24, changes), tmp_path)
    assert made is not None
    if strength:
        assert made["files"]["C3GS"]["bytes"] == next(tmp_path.glob("*.c3gs")).stat().st_size
    else:
        assert set(made["files"]) == {"Scaffold-GS"}
    assert not list(tmp_path.glob("*.train-state"))


# --- conversions ------------------------------------------------------------------------------------------------------

needs_tool = pytest.mark.skipif(tool() is None, reason=f"splat-transform is missing: {convert.INSTALL}")


@needs_tool
@pytest.mark.parametrize("suffix", convert.FORMATS)
@pytest.mark.parametrize("degree", [0, 1, 3])
def test_there_and_back(
    suffix: str, degree: int, photographs: PhotographSet, make_splats: MakeSplats, tmp_path: Path
) -> None:
    """What comes back looks the same but for the formats' rounding, and is as many Gaussians."""
    splats = make_splats(500, degree)
    # SOG keeps clusters of harmonics, so there are only a few here, and 1 % of noise.
    few = splats["rest"][torch.arange(500) % 8]
    splats["rest"] = few + 0.01 * splats["rest"]
    camera = photographs.train[0].camera
    centre = camera.rotation.T @ np.array([0, 0, 8.0]) + camera.centre
    splats["mean"] = splats["mean"] + splats["mean"].new_tensor(centre.tolist())
    write_ply(splats, tmp_path / "a.ply")
    coded, again = there_and_back(tmp_path / "a.ply", suffix)
    assert coded.stat().st_size < (tmp_path / "a.ply").stat().st_size
    found = read_ply(again)
    assert found["rest"].shape == splats["rest"].shape
    one, two = (drawn(s, camera, Settings())[0].numpy() for s in (splats, found))
    error = float(np.mean((one - two) ** 2))
    assert one.std() > 0.05
    assert -10 * math.log10(error) > 30


def test_without_the_program(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(convert, "tool", lambda: None)
    with pytest.raises(convert.ToolError, match="npm install"):
        there_and_back(tmp_path / "a.ply", "spz")


# --- scenes of splats -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("shade", [255, 0])
def test_a_scene_of_a_splat(shade: int, make_splats: MakeSplats, tmp_path: Path) -> None:
    """The cameras that the reader finds show the images that were written, over any background, and no points."""
    splats = make_splats(300, 1)
    write_ply(splats, tmp_path / "a.ply")
    words = [str(tmp_path / "a.ply"), "-o", str(tmp_path / "scene"), "--views", "5", "--tests", "3", "--size", "48"]
    assert make_scene([*words, "--up=-y"]) == 0
    found = read_photographs(tmp_path / "scene", background=(shade, shade, shade))
    assert (len(found.train), len(found.test)) == (5, 3)
    assert not list(tmp_path.glob("scene/*.ply"))
    view = Settings(near_plane=0.01, background=(shade / 255,) * 3)
    for photograph in (*found.train, *found.test):
        # Exact but for the rounding to eight bits of colour and alpha.
        assert quality(splats, (photograph,), view)["psnr_3dgs"] > 44
        assert (photograph.image[0, 0] == shade).all()
        assert photograph.empty()[0, 0]
    # Up in the image is -y in the world, on average over the cameras.
    assert np.mean([p.camera.rotation[1] for p in found.train], axis=0).argmax() == 1


def test_a_scene_of_nothing(tmp_path: Path) -> None:
    assert make_scene([str(tmp_path / "a.ply"), "-o", str(tmp_path / "scene")]) == 64
