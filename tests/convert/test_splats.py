"""A file of splats to a scene: pictures from cameras, and a training from them."""

from __future__ import annotations

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
from refcodec.convert.drawing import drawn, tensors  # noqa: E402
from refcodec.convert.views import AXES, orbit, write_photographs  # noqa: E402
from refcodec.convert.views import given as chosen  # noqa: E402
from refcodec.folder.read import read_folder  # noqa: E402
from refcodec.photographs.photographs import read_photographs  # noqa: E402
from refcodec.rendering.camera import Camera  # noqa: E402
from refcodec.rendering.rasterise import Settings  # noqa: E402

Captured = pytest.CaptureFixture[str]
SMALL = ("--size", "48", "--steps", "30")


def silent(stage: str, done: int, total: int) -> None:
    """Progress that nobody sees."""


def test_pictures_show_the_splats(tmp_path: Path) -> None:
    """Cameras and points come back from the folder, and what they see is what was drawn."""
    given, splats = made(), tensors(made())
    views = orbit(given, AXES["-y"], 40, 6, 2)
    write_photographs(given, views, tmp_path / "pictures", silent, (9, 99, 0))
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
    views = chosen(cameras, 16, 100)
    assert [len(views[name]) for name in ("train", "test")] == [14, 2]
    assert views["train"][0].translation[2] == 3
    assert views["test"][-1].translation[2] == 102
    assert {(c.width, c.height, c.fx, c.cy) for c in views["train"]} == {(100, 50, 75, 25)}
    # One camera is to learn from.
    assert [len(views) for views in chosen(cameras[:1], 16, None).values()] == [1, 0]


@pytest.mark.slow
def test_a_file_of_splats_becomes_a_file(tmp_path: Path, capsys: Captured) -> None:
    """Around the splats, with pictures that are kept: eval compares the file with them."""
    write(made(200, 1), tmp_path / "a.sog")
    scene, pictures, file = tmp_path / "scene", tmp_path / "pictures", tmp_path / "a.c3gs"
    words = ["convert", str(tmp_path / "a.sog"), "-o", str(scene), "--views", "16", "--up=+z", *SMALL]
    assert main([*words, "--pictures", str(pictures), "--lambda", "0.01"]) == 0
    report = json.loads((scene / "training.json").read_text())
    assert report["settings"]["rate"]["lambda_r"] == 0.01
    assert len(report["quantised"]) == 2
    assert main(["encode", str(scene), "-o", str(file)]) == 0
    capsys.readouterr()
    assert main(["eval", str(file), str(pictures), "--json"]) == 0
    assert len(json.loads(capsys.readouterr().out)["images"]) == 2
    assert read_folder(scene).render.up_axis == 4
    # Nothing is left beside what was asked for.
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.c3gs", "a.sog", "pictures", "scene"]
    assert main([*words, "--pictures", str(pictures)]) == 64
    assert "exists: choose another folder" in capsys.readouterr().err


@pytest.mark.slow
def test_gaussians_in_one_place(tmp_path: Path, capsys: Captured) -> None:
    """They become one anchor, which has no spread of features."""
    splats = made(50, 0)
    splats.mean[:] = 3
    write(splats, tmp_path / "a.ply")
    words = ["--views", "4", "--size", "24", "--steps", "3"]
    assert main(["convert", str(tmp_path / "a.ply"), "-o", str(tmp_path / "scene"), *words]) == 0
    assert "Warning" not in capsys.readouterr().err


@pytest.mark.slow
def test_a_training_goes_on_with_its_pictures(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Captured
) -> None:
    """Ctrl-C leaves a scene, the saved training and the pictures. They are not drawn again."""
    from refcodec.convert import views  # noqa: PLC0415
    from refcodec.train.trainer import Trainer  # noqa: PLC0415

    write(made(200, 1), tmp_path / "a.ply")
    words = [
        "convert",
        str(tmp_path / "a.ply"),
        "-o",
        str(tmp_path / "scene"),
        "--pictures",
        str(tmp_path / "pictures"),
    ]
    words += ["--views", "8", *SMALL]
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
    pictures = {path: path.stat().st_mtime_ns for path in (tmp_path / "pictures").rglob("*")}
    monkeypatch.setattr(views, "write_photographs", None)
    assert main([*words, "--resume"]) == 0
    assert {path: path.stat().st_mtime_ns for path in (tmp_path / "pictures").rglob("*")} == pictures
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.ply", "pictures", "scene"]


@pytest.mark.slow
def test_the_cameras_of_a_model(tmp_path: Path, capsys: Captured) -> None:
    """3DGS writes cameras.json beside its folder point_cloud."""
    place = tmp_path / "model" / "point_cloud" / "iteration_30000"
    place.mkdir(parents=True)
    write(made(200, 0), place / "point_cloud.ply")
    own = {"width": 90, "height": 60, "fx": 80.0, "fy": 80.0, "rotation": np.eye(3).tolist()}
    cameras = [own | {"id": i, "img_name": str(i), "position": [0.1 * i, 0.0, -4.0]} for i in range(9)]
    (tmp_path / "model" / "cameras.json").write_text(json.dumps(cameras))
    words = ["convert", str(place / "point_cloud.ply"), "-o", str(tmp_path / "scene"), *SMALL]
    assert main([*words, "--up=+z"]) == 0
    assert read_folder(tmp_path / "scene").render.up_axis == 4
    assert json.loads((tmp_path / "scene" / "training.json").read_text())["size"] == [48, 32]
    (tmp_path / "model" / "cameras.json").write_text("[{}]")
    assert main([*words[:3], str(tmp_path / "other"), *SMALL]) == 64
    assert "cameras.json" in capsys.readouterr().err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["model", "scene"]


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (("a.ply", "--appearance", "1"), "--appearance applies only to model folders"),
        (("model", "--views", "5"), "--views applies only to splat files"),
        (("model", "--lambda", "0.1"), "--lambda applies only to splat files"),
        (("a.ply", "--resume"), "nothing to resume"),
        (("a.ply", "--size", "0"), "size"),
        (("a.ply", "--set", "steps=x"), "steps"),
        (("a.ply", "--cameras", "none.json"), "none.json"),
        (("a.ply", "--pictures", "scene"), "the same folder or nested"),
        (("a.ply", "--pictures", "scene/pictures"), "the same folder or nested"),
        (("a.ply", "--pictures", "a.ply"), "exists: choose another folder"),
        (("meta.json",), "not JSON"),
        (("sog",), "not JSON"),
        (("a.spz",), "not an SPZ"),
        (("b.ply",), "the file does not exist"),
        (("a.glb",), "not a GLB"),
        (("a.glb", "--views", "6"), "not a GLB"),
        (
            ("a.splat", "--views", "6"),
            "neither a model folder nor a splat file (.ply, .spz,",
        ),
        (("none", "--views", "6"), "none does not exist"),
    ],
)
def test_wrong_use(
    words: tuple[str, ...], reason: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Captured
) -> None:
    write(made(50, 0), tmp_path / "a.ply")
    for name in ("a.spz", "a.glb", "a.splat"):
        (tmp_path / name).write_bytes(b"no splats")
    (tmp_path / "model").mkdir()
    (tmp_path / "sog").mkdir()
    for folder in (tmp_path, tmp_path / "sog"):
        (folder / "meta.json").write_text("{")
    before = sorted(tmp_path.rglob("*"))
    monkeypatch.chdir(tmp_path)
    assert main(["convert", *words, "-o", "scene"]) == 64
    err = capsys.readouterr().err
    assert err.count("\n") == 1, err
    assert reason in err
    assert sorted(tmp_path.rglob("*")) == before
