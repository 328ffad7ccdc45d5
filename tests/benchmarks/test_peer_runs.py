"""Runs, their figures, conversions, and scenes made of splats."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from benchmarks import results
from benchmarks.peers import runs
from benchmarks.peers.__main__ import main
from benchmarks.peers.figures import Point, bd_rate, bytes_at, figure, scenes
from benchmarks.peers.runs import Run, perform, records
from benchmarks.peers.scene import main as make_scene
from benchmarks.peers.splats import quality, write_ply
from benchmarks.peers.table import TableError, commands, report, tools, with_seeds, without
from refcodec.photographs.photographs import read_photographs
from refcodec.rendering.rasterise import Settings

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


def test_bytes_between_two_points() -> None:
    """Half way between 100 and 400 bytes on a logarithmic axis lies 200."""
    found = curve((100, 30), (400, 32), (800, 33))
    assert bytes_at(found, 31) == pytest.approx(200)
    assert bytes_at(found, 32) == pytest.approx(400)
    assert bytes_at(found, 30) == pytest.approx(100)
    assert bytes_at(found, 33) == pytest.approx(800)
    assert bytes_at(found, 29.9) is None
    assert bytes_at(found, 33.1) is None


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
    assert "\n| BD-rate |  | -" in text
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
    others = [{**run, "scene": "b"} for run in given]
    assert commands([*given, *others], 2) == [
        f"{words} 0.5 8000 --seeds 0 1 --size 200 --steps 10".replace(" a ", " a|b ")
    ]


def test_methods_with_a_kind_of_file_are_left_out() -> None:
    (scene,) = without(scenes([record("3DGS, PLY", 1, 0, 70, 20), record("3DGS, SPZ", 1, 0, 7, 20)]), "3DGS, PLY")
    assert list(scene.curves) == ["3DGS, SPZ, 10 steps"]


def test_the_programs_of_runs() -> None:
    given = [
        {"tool": "x 2", "scene": "b"},
        {"tool": "x 2", "scene": "a"},
        {"scene": "c"},
        {"tool": "x 1", "scene": "d"},
    ]
    assert tools(given) == ["x 1 wrote SPZ and SOG of d.", "x 2 wrote SPZ and SOG of a, b."]


# --- runs -------------------------------------------------------------------------------------------------------------


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
