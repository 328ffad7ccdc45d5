"""The loss of a scene by export, conversion and another encoding, in dB."""

import math
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch")
for package in ("numba", "scipy", "PIL"):
    pytest.importorskip(package)

from refcodec.bitstream.batches import no_progress  # noqa: E402
from refcodec.bitstream.codec import parse  # noqa: E402
from refcodec.bitstream.reconstruction import reconstruct  # noqa: E402
from refcodec.cli.main import main  # noqa: E402
from refcodec.export.fit import fit  # noqa: E402
from refcodec.export.views import views_of  # noqa: E402
from refcodec.folder.uncompressed import Uncompressed, write_uncompressed  # noqa: E402
from refcodec.formats.common import Options  # noqa: E402
from refcodec.formats.table import write_splats  # noqa: E402
from refcodec.rendering.camera import Camera  # noqa: E402
from refcodec.rendering.view import View  # noqa: E402

torch.set_num_threads(1)

TRAINED = Path(__file__).resolve().parents[2] / "vectors" / "valid" / "trained-caliterra.c3gs"
# The least PSNR to the scene: of one whose folder was encoded, and of one that was trained from a splat of the scene.
FOLDER, TRAINING = 47.0, 30.0
# A black picture has less.
BLACK = 25.0


@pytest.fixture(scope="module")
def view() -> View:
    return View(parse(TRAINED.read_bytes()).scene)


@pytest.fixture(scope="module")
def cameras(view: View) -> list[Camera]:
    """Some cameras around the scene, which see it."""
    cameras = [camera.resized(48, 36) for camera in views_of(view, []).fit[::6]]
    assert decibels([view.draw(camera) for camera in cameras], [np.zeros((36, 48, 3))] * len(cameras)) < BLACK
    return cameras


def decibels(first: list[np.ndarray], second: list[np.ndarray]) -> float:
    """The mean PSNR of pairs of images; infinity if all are equal."""
    errors = [np.mean((a.clip(0, 1).astype(float) - b.clip(0, 1)) ** 2) for a, b in zip(first, second, strict=True)]
    return float(np.mean([-10 * math.log10(error) if error else math.inf for error in errors]))


def assert_near(shown: View, view: View, cameras: list[Camera], least: float) -> None:
    assert decibels([shown.draw(c) for c in cameras], [view.draw(c) for c in cameras]) >= least


@pytest.mark.slow
def test_a_folder(view: View, cameras: list[Camera], tmp_path: Path) -> None:
    """A folder shows the scene as it is. Encoding it again costs what new steps cost."""
    plain, file = tmp_path / "plain", tmp_path / "a.c3gs"
    scene = parse(TRAINED.read_bytes()).scene
    write_uncompressed(Uncompressed(reconstruct(scene), scene.masks, view.networks, view.info), plain)
    assert main(["encode", str(plain), "-o", str(file), "--lambda", "0.004", "--steps", "30"]) == 0
    assert_near(View(parse(file.read_bytes()).scene), view, cameras, FOLDER)


@pytest.mark.slow
def test_a_splat_becomes_a_scene(view: View, cameras: list[Camera], tmp_path: Path) -> None:
    """A training of some steps from pictures of a file that refcodec wrote: it stands where the scene stood."""
    splats = fit(view, cameras, 2, 0, no_progress).splats
    (tmp_path / "a.glb").write_bytes(write_splats(splats, ".glb", Options(view.up)))
    words = ["--views", "24", "--size", "64", "--steps", "200", "--anchors", "1500"]
    assert main(["convert", str(tmp_path / "a.glb"), "-o", str(tmp_path / "scene"), *words]) == 0
    assert main(["encode", str(tmp_path / "scene"), "-o", str(tmp_path / "a.c3gs")]) == 0
    shown = View(parse((tmp_path / "a.c3gs").read_bytes()).scene)
    assert_near(shown, view, cameras, TRAINING)
