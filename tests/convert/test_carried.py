"""Folders of Scaffold-GS that refcodec exported, converted: they give the same scene, which encodes and trains."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("scipy")

from random_scenes import random_scene  # noqa: E402

from refcodec.bitstream import codec  # noqa: E402
from refcodec.bitstream.cameras import CAMERAS, NamedCamera, cameras, emit_cameras  # noqa: E402
from refcodec.bitstream.dimensions import RENDERING  # noqa: E402
from refcodec.bitstream.reconstruction import reconstruct  # noqa: E402
from refcodec.bitstream.scene import Ancillary, Scene  # noqa: E402
from refcodec.bitstream.weights import to_grid  # noqa: E402
from refcodec.cli.main import main  # noqa: E402
from refcodec.convert.checkpoint import read_checkpoint  # noqa: E402
from refcodec.convert.networks import on_grids  # noqa: E402
from refcodec.encoder.cloud import AnchorCloud  # noqa: E402
from refcodec.encoder.quantise import order_anchors, varying  # noqa: E402
from refcodec.folder.layout import SceneFolderError  # noqa: E402
from refcodec.rendering.gaussians import gaussians  # noqa: E402
from refcodec.rendering.view import View  # noqa: E402
from refcodec.train.fit import base_steps, fit  # noqa: E402
from refcodec.train.fit_input import Given  # noqa: E402
from refcodec.train.settings import FitSettings  # noqa: E402

# PyTorch advises against TorchScript, which is what Scaffold-GS loads.
pytestmark = pytest.mark.filterwarnings("ignore:.torch.jit:DeprecationWarning")
torch.set_num_threads(1)

TRAINED = Path(__file__).resolve().parents[2] / "vectors" / "valid" / "trained-caliterra.c3gs"
# Its principal point is not in the middle, which cameras.json cannot say.
CAMERA = NamedCamera("front", 80, 60, (70.0, 71.0), (33.0, 31.0), (0.5, 0.5, -0.5, 0.5), (0.5, -0.5, 9.0))


def scenes() -> dict[str, Scene]:
    """Scenes with masks and without, with more features than hidden units and with fewer, on a lattice and off it."""
    trained = codec.parse(TRAINED.read_bytes()).scene
    drawn = random_scene(5, 40)
    render = replace(drawn.render, background=(10, 20, 30), distance_unit=3.5, up_axis=4, near_plane=0.5)
    stated = (Ancillary(CAMERAS, 0, emit_cameras([CAMERA])),)
    random = replace(drawn, render=render, ancillary=stated)
    plain = {
        "trained": trained,
        "random": random,
        "all offsets": replace(random, masks=np.ones_like(random.masks)),
    }
    # What a file holds: dropped offsets are 0.
    return {name: codec.parse(codec.emit(scene)).scene for name, scene in plain.items()}


def exported(scene: Scene, folder: Path) -> Path:
    file = folder / "scene.c3gs"
    file.write_bytes(codec.emit(scene))
    assert main(["export", str(file), "-o", str(folder / "model"), "--scaffold"]) == 0
    return folder / "model"


@pytest.mark.parametrize("name", ["trained", "random", "all offsets"])
def test_the_scene_comes_back(name: str, tmp_path: Path) -> None:
    scene = scenes()[name]
    restored = read_checkpoint(exported(scene, tmp_path)).scene
    values = reconstruct(scene)
    np.testing.assert_array_equal(restored.masks, scene.masks)
    for kind in ("positions", "features", "scalings", "offsets"):
        np.testing.assert_array_equal(getattr(restored.values, kind), getattr(values, kind), err_msg=kind)
    assert restored.render == scene.render
    assert restored.cameras == tuple(cameras(scene.ancillary))
    for network in RENDERING:
        for own, stored in zip(restored.networks[network], scene.networks[network], strict=True):
            for a, b in zip(own, stored, strict=True):
                # A division and a multiplication are undone for weights on grids alone.
                np.testing.assert_allclose(a, b, rtol=0 if name == "trained" else 2.0**-20)


def test_a_fit_of_it_shows_the_same(tmp_path: Path) -> None:
    """Grids of networks and the lattice stay. What is lost is lost to the steps of attributes."""
    scene = scenes()["trained"]
    plain = read_checkpoint(exported(scene, tmp_path)).scene
    v = plain.values
    cloud = AnchorCloud(v.positions, v.features, v.scalings, v.offsets, plain.masks)
    fitted = fit(
        Given(cloud, plain.voxel, None, plain.networks, plain.render, plain.cameras), FitSettings(steps=0)
    ).scene
    coded = on_grids(fitted, cloud)
    for name in RENDERING:
        assert all(to_grid(layer) for layer in coded.networks[name])
        assert all(np.array_equal(a[0], b[0]) for a, b in zip(coded.networks[name], scene.networks[name], strict=True))
    assert np.array_equal(coded.positions, np.rint(coded.positions))
    camera = View(scene).orbit(1)[0].resized(48, 36)
    right, made = (View(each).draw(camera).clip(0, 1) for each in (scene, coded))
    assert -10 * np.log10(np.mean((right - made) ** 2)) > 36


@pytest.mark.slow
def test_a_training_goes_on_from_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    photographs = TRAINED.parents[2] / "examples" / "photographs" / "caliterra"
    model = exported(scenes()["trained"], tmp_path)
    assert main(["convert", str(model), "-o", str(tmp_path / "scene")]) == 0
    words = ["train", str(photographs), "--size", "24", "--steps", "4", "--from", str(tmp_path / "scene")]
    assert main([*words, "-o", str(tmp_path / "more")]) == 0
    # Whatever a scene lacks is not the fault of the photographs.
    capsys.readouterr()
    assert main([*words, "-o", str(tmp_path / "none"), "--lambda", "0"]) == 64
    assert f"{tmp_path / 'scene'} cannot be continued: it has masks" in capsys.readouterr().err


def test_features_that_are_constant_have_no_say_in_a_step() -> None:
    """A model may have more features than it uses, as the wider of its layers asks."""
    rng = np.random.default_rng(0)
    n = 50
    features = np.zeros((n, 9), np.float32)
    features[:, :3] = rng.normal(0, 0.3, (n, 3))
    none = np.zeros((n, 2, 3), np.float32)
    cloud = AnchorCloud(none[:, 0], features, np.zeros((n, 6), np.float32), none, np.ones((n, 2), bool))
    (narrow, wide) = (base_steps(c, FitSettings().scene)[0] for c in (replace(cloud, features=features[:, :3]), cloud))
    assert narrow == wide < 0.2
    assert varying(np.zeros(3)).tolist() == [0, 0, 0]


def test_networks_that_show_nothing() -> None:
    """A camera may see none of the Gaussians that judge the grids of networks."""
    scene = scenes()["all offsets"]
    networks = dict(scene.networks)
    (first, (last, end)) = networks["opacity"]
    networks["opacity"] = [first, (last * 0, end * 0 - 1)]
    dark = replace(scene, networks=networks)
    ordered, _ = order_anchors(AnchorCloud(*vars(reconstruct(dark)).values(), dark.masks), dark.grid)
    assert not len(gaussians(reconstruct(dark), dark.masks, dark.networks, View(dark).orbit(1)[0], 1.0).anchor)
    assert on_grids(dark, ordered).networks.keys() == dark.networks.keys()


def test_a_unit_that_weights_do_not_bear(tmp_path: Path) -> None:
    scene = scenes()["random"]
    far = {name: [(layers[0][0] + 8, layers[0][1]), *layers[1:]] for name, layers in scene.networks.items()}
    networks = {name: far[name] if name in RENDERING else layers for name, layers in scene.networks.items()}
    model = exported(replace(scene, networks=networks), tmp_path)
    stated = next(model.rglob("render.json"))
    stated.write_text(stated.read_text().replace('"distance_unit": 3.5', '"distance_unit": 3e38'))
    with pytest.raises(SceneFolderError, match="distance_unit"):
        read_checkpoint(model)
