"""A file of splats to a scene: pictures from cameras, and a training from them."""

import json
import signal
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

for package in ("torch", "numba", "PIL", "skimage", "scipy"):
    pytest.importorskip(package)

from plain import made, write  # noqa: E402

from refcodec.cli.main import main  # noqa: E402
from refcodec.convert import views  # noqa: E402
from refcodec.convert.drawing import drawn, tensors  # noqa: E402
from refcodec.convert.views import AXES, orbit, write_photographs  # noqa: E402
from refcodec.convert.views import given as chosen  # noqa: E402
from refcodec.folder.read import read_folder  # noqa: E402
from refcodec.photographs.photographs import read_photographs  # noqa: E402
from refcodec.rendering.camera import Camera  # noqa: E402
from refcodec.rendering.rasterise import Settings  # noqa: E402
from refcodec.train.trainer import Trainer  # noqa: E402

Captured = pytest.CaptureFixture[str]
SMALL = ("--size", "48", "--steps", "30")


def silent(stage: str, done: int, total: int) -> None:
    """Progress that nobody sees."""


def test_pictures_show_the_splats(tmp_path: Path) -> None:
    """Cameras and points come back from the folder, and what they see is what was drawn."""
    given, splats = made(), tensors(made())
    groups = orbit(given, AXES["-y"], 40, 6, 2)
    write_photographs(given, groups, tmp_path / "pictures", silent, (9, 99, 0))
    photographs = read_photographs(tmp_path / "pictures")
    assert (len(photographs.train), len(photographs.test)) == (6, 2)
    assert not photographs.random
    seen = splats["mean"][splats["opacity"].sigmoid() >= 0.1]
    assert np.array_equal(np.sort(photographs.points, axis=0), np.sort(seen.double().numpy(), axis=0))
    for photograph in (*photographs.train, *photographs.test):
        image, _, _ = drawn(splats, photograph.camera, Settings(near_plane=0.01, background=(9 / 255, 99 / 255, 0)))
        assert np.abs(image.clamp(0, 1).numpy() * 255 - photograph.image).max() < 0.51
        assert photograph.image[:, :, 2].max() > 50
    # Up in the images is -y in the world.
    assert np.mean([p.camera.rotation[1] for p in photographs.train], axis=0).argmax() == 1


@pytest.mark.parametrize("up", [(0, 0, -1), (0.6, 0, 0.8), (1, 1, 1)])
def test_up_is_any_direction(up: tuple[float, ...]) -> None:
    """The images of all cameras have it upwards, and the cameras look at the middle from above and from below."""
    direction = np.array(up) / np.linalg.norm(up)
    cameras = orbit(made(), direction, 40, 12, 2)["train"]
    heights = [float((camera.centre - made().mean.mean(axis=0)) @ direction) for camera in cameras]
    assert min(heights) < 0 < max(heights)
    for camera in cameras:
        np.testing.assert_allclose(camera.rotation @ camera.rotation.T, np.eye(3), atol=1e-9)
        assert camera.rotation[1] @ direction < 0
        assert abs(camera.rotation[0] @ direction) < 1e-9


def test_given_cameras_are_spread(tmp_path: Path) -> None:
    turn = np.eye(3)
    cameras = [Camera(f"c{i}", 400, 200, 300, 310, 200, 100, turn, np.array([0, 0, i + 3.0])) for i in range(100)]
    groups = chosen(cameras, 16, 100)
    assert [len(groups[name]) for name in ("train", "test")] == [14, 2]
    assert groups["train"][0].translation[2] == 3
    assert groups["test"][-1].translation[2] == 102
    assert {(c.width, c.height, c.fx, c.cy) for c in groups["train"]} == {(100, 50, 75, 25)}
    # One camera is to learn from.
    assert [len(group) for group in chosen(cameras[:1], 16, None).values()] == [1, 0]


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The current folder."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.slow
def test_a_file_of_splats_becomes_a_file(place: Path, capsys: Captured) -> None:
    """Around the splats, with pictures that are kept: eval compares the file with them."""
    write(made(200, 1), place / "a.sog")
    words = ["convert", "a.sog", "-o", "scene", "--views", "16", "--up=+z", *SMALL, "--pictures", "pictures"]
    assert main([*words, "--lambda", "0.01"]) == 0
    report = json.loads(Path("scene", "training.json").read_text())
    assert report["settings"]["rate"]["lambda_r"] == 0.01
    assert len(report["quantised"]) == 8
    assert main(["encode", "scene", "-o", "a.c3gs"]) == 0
    capsys.readouterr()
    assert main(["eval", "a.c3gs", "pictures", "--json"]) == 0
    assert len(json.loads(capsys.readouterr().out)["images"]) == 8
    assert read_folder(Path("scene")).render.up_axis == 4
    # Nothing is left beside what was asked for.
    assert sorted(path.name for path in place.iterdir()) == ["a.c3gs", "a.sog", "pictures", "scene"]
    assert main(words) == 64
    assert "exists: choose another folder" in capsys.readouterr().err


@pytest.mark.slow
def test_gaussians_in_one_place(place: Path, capsys: Captured) -> None:
    """They become one anchor, which has no spread of features."""
    splats = made(50, 0)
    splats.mean[:] = 3
    write(splats, place / "a.ply")
    assert main(["convert", "a.ply", "-o", "scene", "--views", "4", "--size", "24", "--steps", "3"]) == 0
    assert "Warning" not in capsys.readouterr().err


@pytest.mark.slow
def test_a_training_goes_on_with_its_pictures(place: Path, monkeypatch: pytest.MonkeyPatch, capsys: Captured) -> None:
    """Ctrl-C leaves a scene, the saved training and the pictures. They are not drawn again."""
    write(made(200, 1), place / "a.ply")
    words = ["convert", "a.ply", "-o", "scene", "--pictures", "pictures", "--views", "8", *SMALL]
    real = Trainer.run

    def interrupted(self: Trainer, watch: Callable[[Trainer], None], keep: Callable[[], None]) -> bool:
        def stop(trainer: Trainer) -> None:
            watch(trainer)
            if trainer.clock.done == 10:
                signal.raise_signal(signal.SIGINT)

        return real(self, stop, keep)

    with monkeypatch.context() as patch:
        patch.setattr(Trainer, "run", interrupted)
        assert main(words) == 130
    assert "stopped at step 10" in capsys.readouterr().err
    pictures = {path: path.stat().st_mtime_ns for path in Path("pictures").rglob("*")}
    monkeypatch.setattr(views, "write_photographs", None)
    assert main([*words, "--resume"]) == 0
    assert {path: path.stat().st_mtime_ns for path in Path("pictures").rglob("*")} == pictures
    assert sorted(path.name for path in place.iterdir()) == ["a.ply", "pictures", "scene"]


@pytest.mark.slow
def test_the_cameras_of_a_model(place: Path, capsys: Captured) -> None:
    """3DGS writes cameras.json beside its folder point_cloud."""
    cloud, stated = Path("model/point_cloud/iteration_30000/point_cloud.ply"), Path("model/cameras.json")
    cloud.parent.mkdir(parents=True)
    write(made(200, 0), cloud)
    own = {"width": 90, "height": 60, "fx": 80.0, "fy": 80.0, "rotation": np.eye(3).tolist()}
    cameras = [own | {"id": i, "img_name": str(i), "position": [0.1 * i, 0.0, -4.0]} for i in range(9)]
    stated.write_text(json.dumps(cameras))
    assert main(["convert", str(cloud), "-o", "scene", *SMALL, "--up=+z"]) == 0
    assert read_folder(Path("scene")).render.up_axis == 4
    assert json.loads(Path("scene", "training.json").read_text())["size"] == [48, 32]
    stated.write_text("[{}]")
    assert main(["convert", str(cloud), "-o", "other", *SMALL]) == 64
    assert "cameras.json" in capsys.readouterr().err
    assert sorted(path.name for path in place.iterdir()) == ["model", "scene"]
