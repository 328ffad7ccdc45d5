"""Training for users: its messages and errors, and the information that the other commands have about it."""

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from refcodec.bitstream.codec import parse
from refcodec.cli.main import main
from refcodec.photographs.photographs import PhotographSet
from refcodec.train.settings import TrainSettings
from refcodec.train.settings_file import varied
from refcodec.train.start import first_anchors

TINY = ["--steps", "12", "--size", "60", "--set", "growth.most=900"]
CHOSEN = ["--anchors", "300", "--holdout", "5", "--background", "9,20,30"]


@pytest.fixture(scope="module")
def source(examples: Path) -> str:
    return str(examples / "caliterra")


@pytest.fixture(scope="module")
def place(source: str, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a coded scene, its file, and an uncompressed scene."""
    place = tmp_path_factory.mktemp("trained")
    assert main(["train", source, "-o", str(place / "scene"), *TINY, *CHOSEN]) == 0
    assert main(["encode", str(place / "scene"), "-o", str(place / "scene.c3gs")]) == 0
    assert main(["train", source, "-o", str(place / "plain"), *TINY, *CHOSEN, "--lambda", "0"]) == 0
    return place


def evaluated(capsys: pytest.CaptureFixture[str], *words: object) -> tuple[dict, str]:
    capsys.readouterr()
    assert main(["eval", *map(str, words), "--json"]) == 0
    printed = capsys.readouterr()
    return json.loads(printed.out), printed.err


# --- other commands know of the training ------------------------------------------------------------------------------


@pytest.mark.slow
def test_eval_takes_what_the_training_took(place: Path, source: str, capsys: pytest.CaptureFixture[str]) -> None:
    """The size was forgotten: PSNR of full photographs was told without a word."""
    report = json.loads((place / "scene" / "training.json").read_text())
    folder, note = evaluated(capsys, place / "scene", source)
    assert note.count("\n") == 1
    assert "to size 60, as in" in note
    assert "training.json" in note
    # The same photographs, and the PSNR that the training had of them.
    assert [row["image"] for row in folder["images"]] == list(report["quantised"])
    assert folder["mean"]["psnr_3dgs"] == pytest.approx(
        sum(report["quantised"].values()) / len(folder["images"]), abs=0.02
    )
    # A file does not say which photographs were held out.
    file, note = evaluated(capsys, place / "scene.c3gs", source, "--holdout", 5)
    assert "to size 60, as in the camera of the scene" in note
    for key in ("bytes", "parts", "mean", "images"):
        assert file[key] == folder[key]
    # It has the background of its photographs.
    assert parse((place / "scene.c3gs").read_bytes()).scene.render.background == (9, 20, 30)
    given, note = evaluated(capsys, place / "scene.c3gs", source, "--holdout", 5, "--size", 60)
    assert (given["mean"], note) == (file["mean"], "")
    eighth, note = evaluated(capsys, place / "scene.c3gs", source, "--size", 60)
    assert note.count("\n") == 1
    assert "every 8th photograph" in note
    assert "--holdout N compares every N-th one" in note
    assert len(eighth["images"]) == 10
    assert len(evaluated(capsys, place / "plain", source, "--holdout", 0)[0]["images"]) == 75


@pytest.mark.slow
def test_full_photographs_are_asked_for(place: Path, source: str, capsys: pytest.CaptureFixture[str]) -> None:
    file, scene = place / "scene.c3gs", place / "plain"
    small = evaluated(capsys, file, source, "--holdout", 30)[0]["mean"]
    full, note = evaluated(capsys, file, source, "--holdout", 30, "--size", "full")
    assert note == ""
    assert full["mean"]["psnr"] != small["psnr"]
    assert main(["render", str(scene), "--cameras", source, "-o", str(place / "images")]) == 0
    assert "to size 60" in capsys.readouterr().err


@pytest.mark.slow
def test_a_report_that_is_none(
    place: Path, source: str, tmp_path: Path, refused: Callable[..., str], capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "scene").mkdir()
    for file in (place / "plain").iterdir():
        (tmp_path / "scene" / file.name).write_bytes(file.read_bytes())
    report = tmp_path / "scene" / "training.json"
    for text in ("[]", "{", '{"settings": 5}', '{"settings": {"size": 5}}', '{"settings": {"holdout": true}}'):
        report.write_text(text)
        assert "is not a training report" in refused("eval", tmp_path / "scene", source)
    # An older one, and none.
    report.write_text('{"settings": {"size": "50"}}')
    assert "to size 50" in evaluated(capsys, tmp_path / "scene", source)[1]
    report.unlink()
    assert "to size 60, as in the camera of the scene" in evaluated(capsys, tmp_path / "scene", source)[1]


@pytest.mark.slow
def test_a_folder_where_a_file_belongs(place: Path, source: str, tmp_path: Path, refused: Callable[..., str]) -> None:
    assert main(["render", str(place / "scene"), "-o", str(tmp_path / "one")]) == 0
    assert main(["render", str(place / "scene.c3gs"), "-o", str(tmp_path / "two")]) == 0
    drawn = [(tmp_path / name / "default.png").read_bytes() for name in ("one", "two")]
    assert drawn[0] == drawn[1]
    (tmp_path / "empty").mkdir()
    for words in (["eval", tmp_path / "empty", source], ["render", tmp_path / "empty", "-o", tmp_path]):
        assert "is not a scene folder" in refused(*words)


# --- options ----------------------------------------------------------------------------------------------------------


def test_first_anchors(photographs: PhotographSet) -> None:
    few, many, coarse, fine = (
        len(first_anchors(photographs, varied(TrainSettings(), {"start.behind": 1.0, **changes})).lattice)
        for changes in ({"start.anchors": 300}, {"start.anchors": 2000}, {"start.voxel": 3.0}, {"start.voxel": 1.5})
    )
    assert 200 < few < 400
    assert 1500 < many < 2500
    assert coarse < fine
    # World units: twice the edge of one is that of the other.
    edges = [first_anchors(photographs, varied(TrainSettings(), {"start.voxel": edge})).units for edge in (3.0, 1.5)]
    assert edges[0].cell * edges[0].length * 2 == pytest.approx(3, rel=1e-3)
    assert edges[0].cell == pytest.approx(2 * edges[1].cell, rel=1e-3)
