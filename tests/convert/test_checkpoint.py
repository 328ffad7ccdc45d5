"""Models of the Scaffold-GS family: they convert, draw as their own networks do, fit, encode and decode."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("scipy")

from family import LAYOUTS, VOXEL, Layout, Model  # noqa: E402

from refcodec.bitstream.codec import parse  # noqa: E402
from refcodec.bitstream.reconstruction import reconstruct  # noqa: E402
from refcodec.cli.main import main  # noqa: E402
from refcodec.convert.checkpoint import read_checkpoint  # noqa: E402
from refcodec.folder.uncompressed import Uncompressed, read_uncompressed  # noqa: E402
from refcodec.rendering.camera import Camera  # noqa: E402
from refcodec.rendering.gaussians import gaussians  # noqa: E402

torch.set_num_threads(1)
CENTRES = ((0.3, -12.0, 1.0), (4.0, 3.0, -2.5))


def camera_at(centre: tuple[float, ...]) -> Camera:
    rotation = np.eye(3)
    return Camera("here", 64, 48, 60, 60, 32, 24, rotation, -rotation @ np.array(centre))


def assert_draws(scene: Uncompressed, model: Model, code: np.ndarray | None) -> None:
    """The scene's Gaussians are those of the model's program, in float64."""
    for centre in CENTRES:
        drawn = gaussians(
            scene.values, scene.masks, scene.networks, camera_at(centre), scene.render.distance_unit, float
        )
        wanted = model.gaussians(np.array(centre), code)
        assert len(wanted["mean"]) > 20
        for name, values in wanted.items():
            # Folded biases are rounded to float32.
            np.testing.assert_allclose(getattr(drawn, name), values, rtol=2e-5, atol=2e-6, err_msg=name)


@pytest.mark.parametrize("name", LAYOUTS)
def test_a_model_draws_what_its_networks_say(name: str, tmp_path: Path) -> None:
    model = Model(LAYOUTS[name])
    model.write(tmp_path / "model")
    assert main(["convert", str(tmp_path / "model"), "-o", str(tmp_path / "scene")]) == 0
    scene = read_uncompressed(tmp_path / "scene")
    assert_draws(scene, model, model.code(None))
    assert scene.render.background == (255, 255, 255)
    assert scene.render.distance_unit == 1.0
    assert scene.voxel == VOXEL
    # The camera of cameras.json looks along +y, and +z is upwards in its image.
    assert scene.render.up_axis == 4
    first = scene.cameras[0]
    assert (first.width, first.height, first.focal) == (64, 48, (60.0, 61.0))


@pytest.mark.parametrize(
    "layout",
    [
        Layout("split", features=1, offsets=1),
        Layout("split", features=8, offsets=16, distance=(True, True, True), appearance=1),
        Layout("checkpoints.pth", features=128, offsets=2, distance=(False, False, True), appearance=128),
        Layout("checkpoints.pth", features=33, distance=(True, False, False)),
        Layout("checkpoint.pth", features=128, offsets=16, distance=(True, True, True), masks=True),
        Layout("checkpoint.pth", features=1, offsets=1, distance=(True, True, True), masks=True),
    ],
    ids=str,
)
def test_other_dimensions(layout: Layout, tmp_path: Path) -> None:
    """From one feature to the most that the format holds; distance and appearance where flags of the programs say."""
    model = Model(layout, 400)
    # Of one hidden unit the opacity could be negative everywhere.
    model.networks["opacity_mlp"][2].bias.data += 1
    model.write(tmp_path)
    converted = read_checkpoint(tmp_path)
    assert_draws(converted.scene, model, model.code(None))
    assert converted.appearances == (3 if layout.appearance else 0)


def test_the_appearance_of_a_camera(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for number, name in enumerate(("scaffold, split", "scaffold, united")):
        model, folder = Model(LAYOUTS[name]), tmp_path / str(number)
        model.write(folder)
        words = ["convert", str(folder), "-o", str(tmp_path / f"scene{number}")]
        assert main(words) == 0
        printed = capsys.readouterr()
        assert "an appearance for each of 3 cameras" in printed.err
        assert "next: refcodec encode" in printed.out
        assert main([*words, "--appearance", "1"]) == 0
        assert capsys.readouterr().err == ""
        assert_draws(read_uncompressed(tmp_path / f"scene{number}"), model, model.code(1))
        assert main([*words, "--appearance", "3"]) == 64
        assert "there is no camera 3" in capsys.readouterr().err


def test_networks_of_other_widths_get_one(tmp_path: Path) -> None:
    """The format has one width for all three. Units that are added are 0."""
    model = Model(LAYOUTS["hac"])
    wider = torch.nn.Sequential(torch.nn.Linear(54, 60), torch.nn.ReLU(), torch.nn.Linear(60, 30), torch.nn.Sigmoid())
    model.networks["color_mlp"] = wider
    model.write(tmp_path)
    converted = read_checkpoint(tmp_path)
    assert {len(layers[0][1]) for layers in converted.scene.networks.values()} == {60}
    assert_draws(converted.scene, model, None)


def test_the_last_iteration_or_the_one_that_is_named(tmp_path: Path) -> None:
    models = [Model(LAYOUTS["hac"], seed=seed) for seed in (0, 1)]
    first = models[0].write(tmp_path / "a", 7000)
    models[1].write(tmp_path / "b", 30000).rename(first.parent / "iteration_30000")
    assert_draws(read_checkpoint(tmp_path / "a").scene, models[1], None)
    assert_draws(read_checkpoint(first).scene, models[0], None)


def test_a_model_without_notes(tmp_path: Path) -> None:
    model = Model(LAYOUTS["hac"])
    place = model.write(tmp_path)
    (tmp_path / "cfg_args").unlink()
    (tmp_path / "cameras.json").unlink()
    scene = read_checkpoint(place).scene
    assert scene.voxel is None
    assert scene.render.background == (0, 0, 0)
    assert_draws(scene, model, None)


def test_anchors_off_the_lattice_have_none(tmp_path: Path) -> None:
    model = Model(LAYOUTS["hac"])
    model.anchor = model.anchor + np.float32(0.1)
    model.write(tmp_path)
    assert read_checkpoint(tmp_path).scene.voxel is None


@pytest.mark.slow
@pytest.mark.parametrize("name", LAYOUTS)
def test_a_model_becomes_a_file(name: str, tmp_path: Path) -> None:
    """One command from the converted folder to the file, whose values are those of the model, rounded to its steps.

    At the finest steps, its Gaussians are those of the model's program, to the steps' errors.
    """
    model = Model(LAYOUTS[name], 300)
    model.write(tmp_path / "model")
    scene = tmp_path / "scene"
    words = ["--appearance", "1"] if model.embedding else []
    assert main(["convert", str(tmp_path / "model"), "-o", str(scene), *words]) == 0
    files = []
    for weight in ("0.000001", "0.004", "0.064"):
        files.append(tmp_path / f"{weight}.c3gs")
        assert main(["encode", str(scene), "-o", str(files[-1]), "--steps", "30", "--lambda", weight]) == 0
    fine, usual, coarse = (parse(file.read_bytes()).scene for file in files)
    np.testing.assert_allclose(coarse.base_step, 4 * np.array(usual.base_step), rtol=1e-6)
    assert files[0].stat().st_size > files[1].stat().st_size > files[2].stat().st_size
    plain = read_uncompressed(scene)
    kept = np.flatnonzero(plain.masks.any(axis=1))
    for coded in (fine, usual):
        values = reconstruct(coded)
        # The model's number of each anchor of the file. Positions on the lattice are exact, and thus name the anchors.
        number = np.empty(coded.anchor_count, np.int64)
        number[np.lexsort(values.positions.T)] = kept[np.lexsort(plain.values.positions[kept].T)]
        assert np.array_equal(values.positions, plain.values.positions[number])
        for kind, step in zip(("features", "scalings", "offsets"), coded.base_step, strict=True):
            assert np.abs(getattr(plain.values, kind)[number] - getattr(values, kind)).max() <= step * 0.501
        if coded is usual:
            continue
        networks = {name: coded.networks[name] for name in ("opacity", "covariance", "colour")}
        for centre in CENTRES:
            drawn = gaussians(values, coded.masks, networks, camera_at(centre), coded.render.distance_unit)
            wanted = model.gaussians(np.array(centre), model.code(1) if words else None)
            place = {pair: i for i, pair in enumerate(zip(wanted["anchor"], wanted["offset"], strict=True))}
            named = zip(number[drawn.anchor], drawn.offset, strict=True)
            pairs = [(i, place[pair]) for i, pair in enumerate(named) if pair in place]
            # Those whose opacity is nearly 0 may come and go.
            assert len(pairs) > 0.98 * max(len(wanted["mean"]), len(drawn.mean))
            own, other = np.array(pairs).T
            errors = [getattr(drawn, kind)[own] - wanted[kind][other] for kind in ("opacity", "colour", "mean")]
            errors.append(np.log(drawn.lengths[own]) - np.log(wanted["lengths"][other]))
            assert max(np.sqrt((error**2).mean()) for error in errors) < 0.02


def test_scenes_of_more_than_the_format_holds(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    wide = replace(LAYOUTS["hac"], features=130)
    for number, (layout, reason) in enumerate([(wide, "130 features"), (Layout("split", offsets=17), "17 offsets")]):
        Model(layout).write(tmp_path / str(number))
        assert main(["convert", str(tmp_path / str(number)), "-o", str(tmp_path / "scene")]) == 64
        err = capsys.readouterr().err
        assert err.count("\n") == 1
        assert reason in err
        assert "SPEC.md 11.1" in err
