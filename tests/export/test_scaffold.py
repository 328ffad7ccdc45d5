"""The folder of Scaffold-GS, loaded as in the code of its authors, and its renderings."""

from __future__ import annotations

import json
from argparse import Namespace
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="a folder of Scaffold-GS needs torch")

from plyfile import PlyData  # noqa: E402
from random_scenes import random_scene  # noqa: E402

from refcodec.bitstream import codec  # noqa: E402
from refcodec.bitstream.cameras import CAMERAS, NamedCamera, cameras, emit_cameras  # noqa: E402
from refcodec.bitstream.reconstruction import reconstruct  # noqa: E402
from refcodec.bitstream.scene import Ancillary, Scene  # noqa: E402
from refcodec.cli.main import main  # noqa: E402
from refcodec.folder.ply import read_cloud  # noqa: E402
from refcodec.rendering.camera import default_camera  # noqa: E402
from refcodec.rendering.gaussians import gaussians  # noqa: E402

# PyTorch advises against TorchScript, which is what Scaffold-GS loads.
pytestmark = pytest.mark.filterwarnings("ignore:.torch.jit:DeprecationWarning")

ROOT = Path(__file__).resolve().parents[2]
TRAINED = ROOT / "vectors" / "valid" / "trained-caliterra.c3gs"
CAMERA = NamedCamera("front", 80, 60, (70.0, 71.0), (40.0, 30.0), (0.9, 0.1, -0.3, 0.2), (0.5, -0.4, 9.0))


def scaffold_gaussians(model: Path, arguments: Namespace, centre: Any, modules: list[Any]) -> dict[str, np.ndarray]:
    """What Scaffold-GS draws for a camera, in float64: anchors that are in view, and offsets of positive opacity."""
    vertex = PlyData.read(str(model / "point_cloud.ply")).elements[0]

    def columns(stem: str) -> torch.Tensor:
        names = sorted(
            (p.name for p in vertex.properties if p.name.startswith(stem)), key=lambda n: int(n.split("_")[-1])
        )
        return torch.tensor(np.stack([vertex[name] for name in names], axis=1), dtype=torch.float64)

    anchor = torch.tensor(np.stack([vertex[axis] for axis in "xyz"], axis=1), dtype=torch.float64)
    feature, scaling = columns("f_anchor_feat"), columns("scale_").exp()
    count, k = len(anchor), arguments.n_offsets
    offset = columns("f_offset").reshape(count, 3, k).transpose(1, 2)
    assert feature.shape[1] == arguments.feat_dim
    away = anchor - torch.tensor(centre)
    distance = away.norm(dim=1, keepdim=True)
    inputs = torch.cat([feature, away / distance, distance], dim=1)
    with torch.no_grad():
        opacity, covariance, colour = (module.double()(inputs) for module in modules)
    opacity, covariance, colour = opacity.reshape(-1), covariance.reshape(-1, 7), colour.reshape(-1, 3)
    chosen = opacity > 0
    scaling = scaling.repeat_interleave(k, dim=0)
    mean = anchor.repeat_interleave(k, dim=0) + offset.reshape(-1, 3) * scaling[:, :3]
    parts = {
        "mean": mean,
        "lengths": scaling[:, 3:] * torch.sigmoid(covariance[:, :3]),
        "quaternion": torch.nn.functional.normalize(covariance[:, 3:]),
        "opacity": opacity,
        "colour": colour,
    }
    return {name: values[chosen].numpy() for name, values in parts.items()}


def united(arguments: Namespace, states: dict[str, Any]) -> list[Any]:
    """The networks that Scaffold-GS builds by its arguments, with the state dicts of checkpoints.pth."""
    f, k = arguments.feat_dim, arguments.n_offsets
    inputs = f + 3 + 1
    ends = {"opacity_mlp": (k, torch.nn.Tanh()), "cov_mlp": (7 * k, None), "color_mlp": (3 * k, torch.nn.Sigmoid())}
    made = []
    for name, (outputs, end) in ends.items():
        layers = [torch.nn.Linear(inputs, f), torch.nn.ReLU(True), torch.nn.Linear(f, outputs), *([end] if end else [])]
        module = torch.nn.Sequential(*layers)
        module.load_state_dict(states[name])
        made.append(module)
    assert set(states) == set(ends)
    return made


def scenes() -> dict[str, Scene]:
    trained = codec.parse(TRAINED.read_bytes()).scene
    drawn = random_scene(5, 40)
    kept = replace(drawn, masks=np.ones_like(drawn.masks))
    white = replace(drawn.render, background=(255, 255, 255), distance_unit=3.5)
    return {"trained": trained, "random": replace(drawn, render=white), "all offsets": kept}


@pytest.mark.parametrize("name", ["trained", "random", "all offsets"])
def test_it_draws_the_same(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene = scenes()[name]
    scene = replace(scene, ancillary=(Ancillary(CAMERAS, 0, emit_cameras([CAMERA])),))
    (tmp_path / "scene.c3gs").write_bytes(codec.emit(scene))
    scene = codec.parse((tmp_path / "scene.c3gs").read_bytes()).scene
    folder = tmp_path / "model"
    assert main(["export", str(tmp_path / "scene.c3gs"), "-o", str(folder), "--scaffold"]) == 0
    assert f"{scene.anchor_count:,} anchors" in capsys.readouterr().out
    arguments = eval((folder / "cfg_args").read_text(), {"__builtins__": {}, "Namespace": Namespace})
    assert arguments.white_background == (name == "random")
    assert (arguments.appearance_dim, arguments.use_feat_bank) == (0, False)
    assert (arguments.add_opacity_dist, arguments.add_cov_dist, arguments.add_color_dist) == (True, True, True)
    d = scene.dimensions
    extra = 0 if name == "all offsets" else d.offset_count
    assert arguments.feat_dim == max(d.features, d.render_width) + extra

    model = folder / "point_cloud" / "iteration_30000"
    split = [torch.jit.load(model / f"{part}_mlp.pt") for part in ("opacity", "cov", "color")]
    states = torch.load(model / "checkpoints.pth", weights_only=True)
    camera = default_camera(CAMERA)
    values = reconstruct(scene)
    unit = scene.render.distance_unit
    wanted = gaussians(values, scene.masks, scene.networks, camera, unit, np.float64)
    for modules in (split, united(arguments, states)):
        drawn = scaffold_gaussians(model, arguments, camera.centre, modules)
        for kind in ("mean", "lengths", "quaternion", "opacity", "colour"):
            np.testing.assert_allclose(drawn[kind], getattr(wanted, kind), rtol=1e-4, atol=1e-5, err_msg=kind)
    assert len(wanted.mean) > 10


def test_the_files(tmp_path: Path) -> None:
    """The cloud has the family's layout, and the camera is as viewers of 3DGS have it."""
    folder = tmp_path / "model"
    assert main(["export", str(TRAINED), "-o", str(folder), "--scaffold"]) == 0
    scene = codec.parse(TRAINED.read_bytes()).scene
    file = folder / "point_cloud" / "iteration_30000" / "point_cloud.ply"
    vertex = PlyData.read(str(file))["vertex"]
    width = 10 + max(scene.dimensions.features, 50)
    assert [p.name for p in vertex.properties] == [
        *("x", "y", "z", "nx", "ny", "nz"),
        *(f"f_offset_{i}" for i in range(30)),
        *(f"f_anchor_feat_{i}" for i in range(width)),
        "opacity",
        *(f"scale_{i}" for i in range(6)),
        *(f"rot_{i}" for i in range(4)),
    ]
    cloud, values = read_cloud(file), reconstruct(scene)
    np.testing.assert_array_equal(cloud.positions, values.positions)
    np.testing.assert_array_equal(cloud.offsets, values.offsets)
    np.testing.assert_array_equal(cloud.scalings, values.scalings)
    np.testing.assert_array_equal(cloud.features[:, : scene.dimensions.features], values.features)
    (camera,) = json.loads((folder / "cameras.json").read_text())
    assert set(camera) == {"id", "img_name", "width", "height", "position", "rotation", "fy", "fx"}
    rotation = np.array(camera["rotation"])
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-9)
    (stated,) = cameras(scene.ancillary)
    assert camera["img_name"] == stated.name
    # The camera is where its own frame has zero.
    np.testing.assert_allclose(rotation.T @ camera["position"], -np.array(stated.translation), atol=1e-6)


def test_what_is_replaced(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A folder that refcodec wrote, and none of somebody else."""
    words = ["export", str(TRAINED), "--scaffold", "-o"]
    assert main([*words, str(tmp_path / "a")]) == 0
    assert main([*words, str(tmp_path / "a")]) == 0
    (tmp_path / "a" / "cfg_args").write_text("Namespace(sh_degree=3)")
    assert main([*words, str(tmp_path / "a")]) == 64
    assert "refcodec wrote" in capsys.readouterr().err
    (tmp_path / "b").mkdir()
    assert main([*words, str(tmp_path / "b")]) == 0
    (tmp_path / "c").mkdir()
    (tmp_path / "c" / "diary.txt").write_text("dear diary")
    assert main([*words, str(tmp_path / "c")]) == 64
    assert "has other files" in capsys.readouterr().err
    assert main([*words, str(tmp_path / "c" / "diary.txt")]) == 64
    assert "is a file" in capsys.readouterr().err
    assert [file.name for file in (tmp_path / "c").iterdir()] == ["diary.txt"]
