"""The command `refcodec train`."""

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
import torch

from refcodec.bitstream.cameras import cameras
from refcodec.bitstream.codec import parse
from refcodec.bitstream.metadata import metadata
from refcodec.cli.main import main
from refcodec.folder.georeference import stated_offset
from refcodec.folder.read import read_folder
from refcodec.folder.uncompressed import read_uncompressed
from refcodec.photographs.photographs import PhotographSet
from refcodec.train.command import state_path
from refcodec.train.messages import LINE_SECONDS


@pytest.mark.slow
def test_command(examples: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source, scene, file = str(examples / "caliterra"), tmp_path / "scene", tmp_path / "scene.c3gs"
    words = ["--steps", "30", "--size", "64", "--set", "growth.most=6000", "--progress", "--meta", "title=Site"]
    assert main(["train", source, "-o", str(scene), *words]) == 0
    printed = capsys.readouterr()
    assert "30 steps" in printed.out
    assert "step 30 of 30" in printed.err
    assert not state_path(scene).exists()
    assert main(["encode", str(scene), "-o", str(file)]) == 0
    coded = parse(file.read_bytes()).scene
    assert metadata(coded.ancillary) == {"title": "Site"}
    # The photographs look straight down along +z.
    assert (coded.render.up_axis, len(cameras(coded.ancillary))) == (5, 16)
    assert main(["eval", str(file), source, "--size", "64", "--json"]) == 0
    measured = json.loads(capsys.readouterr().out)
    facts = json.loads((scene / "training.json").read_text())
    assert (facts["settings"]["size"], facts["settings"]["growth"]["most"]) == ("64", 6000)
    assert facts["anchors"] == measured["anchors"]
    assert facts["bytes"]["weights"] == pytest.approx(measured["parts"]["weights"], abs=100)
    # Over an older result, and from there nothing to go on with.
    assert main(["train", source, "-o", str(scene), "--steps", "5", "--size", "64", "--up=-x"]) == 0
    assert read_folder(scene).render.up_axis == 1
    assert main(["train", source, "-o", str(scene), "--resume"]) == 64
    assert "nothing to resume" in capsys.readouterr().err


@pytest.mark.slow
def test_command_without_rate(examples: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source, folder = str(examples / "snowmiku"), tmp_path / "scaffold"
    assert main(["train", source, "-o", str(folder), "--lambda", "0", "--steps", "20", "--size", "64"]) == 0
    scene = read_uncompressed(folder)
    assert main(["eval", str(folder), source, "--size", "64", "--json"]) == 0
    evaluation = json.loads(capsys.readouterr().out.split("\n", 3)[3])
    # Six scalings and ten offsets, and networks with one hidden layer of 50 units.
    assert (scene.render.up_axis, len(scene.cameras)) == (3, 16)
    features = scene.values.features.shape[1]
    assert evaluation["parts"] == {
        "positions": 12 * scene.anchor_count,
        "attributes": 4 * (features + 36) * scene.anchor_count,
        "weights": 4 * (3 * 50 * (features + 5) + 51 * 110),
    }
    assert main(["render", str(folder), "-o", str(tmp_path / "images")]) == 0
    assert (tmp_path / "images" / "default.png").is_file()
    (folder / "networks.safetensors").write_bytes(b"")
    assert main(["eval", str(folder), source]) == 64
    assert "train it again" in capsys.readouterr().err


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a CUDA device")
def test_without_a_cuda_device(examples: Path, tmp_path: Path, refused: Callable[..., str]) -> None:
    assert "CUDA" in refused("train", examples / "caliterra", "-o", tmp_path / "scene", "--device", "cuda")


@pytest.mark.parametrize("rate", ["0.004", "0"])
def test_coordinates_of_a_map(
    rate: str, write_ball: Callable[..., object], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """An offset is subtracted and stated, and eval finds the place again, with or without the statement."""
    write_ball("map", "RGB")
    file, far = tmp_path / "map" / "transforms.json", (500_000.25, 5_400_000.5, 80.0)
    document = json.loads(file.read_text())
    for frame in document["frames"]:
        for axis, shift in enumerate(far):
            frame["transform_matrix"][axis][3] += shift
    file.write_text(json.dumps(document))
    scene, photographs = str(tmp_path / "scene"), str(tmp_path / "map")
    words = ["--steps", "30", "--anchors", "300", "--lambda", rate, "--size", "48"]
    assert main(["train", photographs, "-o", scene, *words]) == 0
    assert "far from the world's origin for its size: [500000.0, 5400000.0, 80.0]" in capsys.readouterr().err
    report = json.loads((tmp_path / "scene" / "training.json").read_text())
    assert main(["eval", scene, photographs, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["mean"]["psnr_3dgs"] == pytest.approx(report["psnr"], abs=0.1)
    if rate != "0":
        stated = stated_offset(metadata(read_folder(Path(scene)).ancillary))
        assert stated.tolist() == [500_000, 5_400_000, 80]


SETTINGS = "from refcodec.cli.main import main\nmain(['train', '--print-settings'])"


@pytest.mark.parametrize(
    ("program", "modules"),
    [
        ("from refcodec.evaluate import evaluation", "torch|refcodec.train"),
        ("from refcodec.rendering import rasterise, view", "torch|refcodec.train"),
        (SETTINGS, "torch|numpy|numba"),
        # Its extra has torch, numba and scipy, but not what reads photographs.
        ("from refcodec.train import fit", "PIL|skimage"),
    ],
)
def test_what_is_not_imported(program: str, modules: str) -> None:
    code = f"{program}\nimport re, sys\nprint([m for m in sys.modules if re.match({modules!r}, m)], file=sys.stderr)"
    assert subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stderr == "[]\n"


@pytest.mark.slow
def test_a_nerf_folder_with_transparent_images(
    write_ball: Callable[[str, str], PhotographSet], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A ball without ground, seen from around it, without points: it is learnt over white."""
    write_ball("ball", "RGBA")
    source, scene, file = str(tmp_path / "ball"), tmp_path / "scene", tmp_path / "scene.c3gs"
    assert main(["train", source, "-o", str(scene), "--steps", "150"]) == 0
    assert main(["encode", str(scene), "-o", str(file)]) == 0
    capsys.readouterr()
    assert parse(file.read_bytes()).scene.render.background == (255, 255, 255)
    assert main(["eval", str(file), source, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["mean"]["psnr"] > 15


@pytest.mark.slow
def test_a_terminal_that_goes_away_does_not_end_a_training(examples: Path, tmp_path: Path) -> None:
    """Neither lines of progress nor SIGTERM cost the scene. Containers are stopped with that signal."""
    command = [sys.executable, "-m", "refcodec", "train", str(examples / "caliterra"), "-o", str(tmp_path / "scene")]
    options = ["--steps", "100000", "--size", "64", "--set", "growth.most=6000", "--progress"]
    with subprocess.Popen([*command, *options], stderr=subprocess.PIPE, stdout=subprocess.DEVNULL) as process:
        assert process.stderr is not None
        assert b"step" in process.stderr.readline()
        process.stderr.close()
        # Longer than from one line to the next.
        with pytest.raises(subprocess.TimeoutExpired):
            process.wait(LINE_SECONDS * 1.5)
        process.terminate()
        assert process.wait() == 130
    assert (tmp_path / "scene" / "scene.json").is_file()
    assert state_path(tmp_path / "scene").is_file()
