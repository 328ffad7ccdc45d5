"""The loader for three.js, and the reader for splat-transform, with these themselves where they are installed.

They are looked for in the folders of NODE_PATH, and in node_modules of the checkout. To have all of these tests, run
`npm install three @types/three @sparkjsdev/spark @playcanvas/splat-transform typescript` in any folder, and set
NODE_PATH to its node_modules.
"""

import json
import os
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from random_scenes import random_scene
from web_program import MISSING, NODE, ROOT, WEB

import refcodec
from conformance.cases.scenes import MAIN_DIMENSIONS
from refcodec.bitstream import cameras, codec
from refcodec.bitstream.cameras import NamedCamera
from refcodec.bitstream.reconstruction import reconstruct
from refcodec.bitstream.scene import Ancillary
from refcodec.formats.table import read_splats

FOLDERS = [*map(Path, filter(None, os.environ.get("NODE_PATH", "").split(os.pathsep))), ROOT / "node_modules"]
THREE = next((folder for folder in FOLDERS if (folder / "three" / "package.json").exists()), None)

pytestmark = [
    pytest.mark.no_cover,
    pytest.mark.skipif(NODE is None, reason=MISSING),
    pytest.mark.skipif(THREE is None, reason="three is in no folder of NODE_PATH, so its loader is not tested"),
]

# One with a shifted principal point and pixels that are not square, and one without.
CAMERAS = [
    NamedCamera("first", 640, 480, (500.0, 350.0), (300.0, 250.0), (0.5, -0.5, 0.25, 1.0), (1.0, 2.0, 3.0)),
    NamedCamera("second", 100, 50, (80.0, 80.0), (50.0, 25.0)),
]
SCENE = random_scene(53, 300, MAIN_DIMENSIONS, chunk_size=256)


def installed(folder: Path) -> None:
    """Installs the package in a folder as npm would, beside three and what lies there."""
    assert THREE is not None
    modules = folder / "node_modules"
    shutil.copytree(WEB, modules / "c3gs")
    for path in THREE.iterdir():
        if not path.name.startswith(".") and path.name != "c3gs":
            (modules / path.name).symlink_to(path)


@pytest.fixture(scope="module")
def answer(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """What three_web.mjs says."""
    folder = tmp_path_factory.mktemp("three")
    installed(folder)
    shutil.copy(Path(__file__).with_name("three_web.mjs"), folder)
    section = Ancillary(b"cAMs", 0, cameras.emit_cameras(CAMERAS), 9)
    data = codec.emit(replace(SCENE, ancillary=(section,)))
    (folder / "scene.c3gs").write_bytes(data)
    (folder / "damaged.c3gs").write_bytes(data[:-1] + bytes([data[-1] ^ 1]))
    words = [str(NODE), "three_web.mjs", "scene.c3gs", "damaged.c3gs"]
    done = subprocess.run(words, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    answer: dict[str, Any] = json.loads(done.stdout)
    return answer


def test_it_loads_as_loaders_of_three_do(answer: dict[str, Any]) -> None:
    scene = SCENE
    assert answer["anchors"] == answer["called"] == scene.anchor_count
    assert answer["progress"] == sorted(answer["progress"])
    assert answer["progress"][-1] > 0
    positions = reconstruct(scene).positions
    assert np.array_equal(np.array(answer["bounds"], np.float32), [positions.min(axis=0), positions.max(axis=0)])
    assert np.allclose(answer["background"], np.array(scene.render.background) / 255)
    up = np.zeros(4)
    up[scene.render.up_axis // 2] = -1 if scene.render.up_axis % 2 else 1
    assert np.allclose(np.array(answer["upright"]).reshape(4, 4).T @ up, [0, 1, 0, 0])


def test_errors_reach_the_page_and_the_manager(answer: dict[str, Any]) -> None:
    damaged, missing = answer["failures"]["damaged"], answer["failures"]["missing"]
    assert (damaged["kind"], damaged["code"]) == ("C3gsError", 312)
    assert missing["kind"] == "Error"
    assert "status 404" in missing["message"]
    assert answer["bound"] == "BoundPassedError"
    names = ("scene", "damaged", "missing")
    failed = [f"failed {name}.c3gs" for name in names[1:]]
    assert [event for event in answer["events"] if event.startswith("failed")] == failed
    assert [event for event in answer["events"] if event.startswith("loaded")] == [f"loaded {n}.c3gs" for n in names]


def test_cameras_are_those_of_the_file(answer: dict[str, Any]) -> None:
    """Their matrices are those of cameraMatrix and projectionMatrix."""
    for camera, stated in zip(answer["cameras"], CAMERAS, strict=True):
        assert (camera["name"], camera["width"], camera["height"]) == (stated.name, stated.width, stated.height)
        assert camera["matrix"] < 1e-9
        assert camera["projection"] < 1e-9


def test_an_object_carries_its_scene(answer: dict[str, Any]) -> None:
    assert answer["movedCount"] == len(answer["view"]["opacities"]) > 0
    assert answer["moved"] < 1e-5


def test_geometry_has_the_gaussians_of_the_view(answer: dict[str, Any]) -> None:
    view, geometry = answer["view"], answer["geometry"]
    assert geometry["position"] == view["positions"]
    rgba = np.column_stack([view["colours"], view["opacities"]])
    assert np.abs(np.array(geometry["color"]) - 255 * rgba).max() < 0.501
    axes = cameras.rotation_matrix(np.array(view["rotations"])) * np.array(view["scales"])[:, None]
    covariances = (axes @ axes.transpose(0, 2, 1))[:, *np.triu_indices(3)]
    assert np.allclose(geometry["covariance"], covariances, rtol=1e-5, atol=1e-5 * covariances.max())


@pytest.mark.slow
def test_the_types_are_right(tmp_path: Path) -> None:
    """The compiler of TypeScript accepts a use of all that the package declares."""
    assert THREE is not None
    if not all((THREE / name).exists() for name in ("typescript", "@types/three", "@sparkjsdev/spark")):
        pytest.skip("typescript, @types/three and @sparkjsdev/spark are not all in the folder that has three")
    installed(tmp_path)
    shutil.copy(Path(__file__).with_name("usage_web.mts"), tmp_path)
    options = "--noEmit --strict --skipLibCheck --target es2022 --module node16 --lib es2022,dom,dom.iterable"
    words = [str(NODE), "node_modules/typescript/bin/tsc", *options.split(), "usage_web.mts"]
    done = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (0, "")


@pytest.mark.parametrize("name", ["trained-static", "static-degree-0", "static-degree-3"])
def test_splat_transform_gets_the_bits_of_the_decoder(name: str, tmp_path: Path) -> None:
    if not (Path(str(THREE)) / "@playcanvas" / "splat-transform").exists():
        pytest.skip("splat-transform is not where three is, so its reader is not tested")
    installed(tmp_path)
    shutil.copy(ROOT / "examples" / "splat-transform-reader" / "read-c3gs.mjs", tmp_path)
    scene = ROOT / "vectors" / "valid" / f"{name}.c3gs"
    program = ["node_modules/@playcanvas/splat-transform/bin/cli.mjs", "-g", "cpu", "read-c3gs.mjs"]
    words = [str(NODE), *program, "-p", f"file={scene}", "-r", "0,0,180", "out.ply"]
    subprocess.run(words, cwd=tmp_path, capture_output=True, check=True)
    written = read_splats(tmp_path / "out.ply")
    assert all(np.array_equal(own, getattr(written, key)) for key, own in vars(refcodec.splats(scene)).items())
