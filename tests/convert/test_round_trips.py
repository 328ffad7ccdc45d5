"""Every format that is written and read: the loss of a scene by export, conversion and another encoding, in dB."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch")
for package in ("numba", "scipy", "PIL"):
    pytest.importorskip(package)

from writers import write_packed  # noqa: E402

from refcodec.bitstream.batches import no_progress  # noqa: E402
from refcodec.bitstream.codec import parse  # noqa: E402
from refcodec.bitstream.reconstruction import reconstruct  # noqa: E402
from refcodec.cli.main import main  # noqa: E402
from refcodec.convert.splat_files import read_splats  # noqa: E402
from refcodec.export.fit import agreement, fit, render_settings  # noqa: E402
from refcodec.export.formats import FORMATS, splat_file  # noqa: E402
from refcodec.export.splats import Splats, draw  # noqa: E402
from refcodec.export.views import views_of  # noqa: E402
from refcodec.folder.uncompressed import Uncompressed, write_uncompressed  # noqa: E402
from refcodec.rendering.camera import Camera  # noqa: E402
from refcodec.rendering.view import View  # noqa: E402

# PyTorch advises against TorchScript, which is what Scaffold-GS loads.
pytestmark = pytest.mark.filterwarnings("ignore:.torch.jit:DeprecationWarning")
torch.set_num_threads(1)

TRAINED = Path(__file__).resolve().parents[2] / "vectors" / "valid" / "trained-caliterra.c3gs"
# The least PSNR of a splat that is read, to the splat that was written. PLY has all bits of it, and GLB all but those
# of logits and logarithms. SPZ has lengths to 1/16 of their logarithm, and SOG has 256 values of each kind.
BACK = {".ply": math.inf, ".glb": 130.0, ".spz": 55.0, ".sog": 55.0, ".compressed.ply": 45.0}
# That of a written splat to the scene, from the views of its fit.
OUT = 40.0
# That of a scene whose folder was encoded, to the scene; and of one that was trained from a splat of the scene.
FOLDER, TRAINING = 47.0, 30.0
# A black picture has less.
BLACK = 25.0


@pytest.fixture(scope="module")
def view() -> View:
    return View(parse(TRAINED.read_bytes()).scene)


@pytest.fixture(scope="module")
def cameras(view: View) -> list[Camera]:
    """Some cameras around the scene, which see it."""
    found = [camera.resized(48, 36) for camera in views_of(view, []).fit[::6]]
    assert decibels([view.draw(camera) for camera in found], [np.zeros((36, 48, 3))] * len(found)) < BLACK
    return found


@pytest.fixture(scope="module")
def splats(view: View, cameras: list[Camera]) -> Splats:
    return fit(view, cameras, 2, 0, no_progress).splats


def decibels(first: list[np.ndarray], second: list[np.ndarray]) -> float:
    """The mean PSNR of pairs of images; infinity if all are equal."""
    errors = [np.mean((a.clip(0, 1).astype(float) - b.clip(0, 1)) ** 2) for a, b in zip(first, second, strict=True)]
    return float(np.mean([-10 * math.log10(error) if error else math.inf for error in errors]))


def assert_near(found: View, view: View, cameras: list[Camera], least: float) -> None:
    assert decibels([found.draw(c) for c in cameras], [view.draw(c) for c in cameras]) >= least


@pytest.mark.parametrize("suffix", BACK)
def test_splats(suffix: str, view: View, cameras: list[Camera], splats: Splats, tmp_path: Path) -> None:
    file = tmp_path / f"a{suffix}"
    if suffix in FORMATS:
        packed = splat_file(splats, suffix, view.up)
        file.write_bytes(packed.data)
        # What the file is said to hold is what the export measures.
        assert agreement(view, packed.splats, cameras, no_progress) > OUT
    else:
        write_packed({name: values.astype(float) for name, values in vars(splats).items()}, file)
    found, settings = Splats(**read_splats(file)), render_settings(view)
    images = [[draw(each, camera, settings).image for camera in cameras] for each in (found, splats)]
    assert decibels(*images) >= BACK[suffix]
    if suffix in FORMATS:
        again = [draw(packed.splats, camera, settings).image for camera in cameras]
        assert decibels(images[0], again) >= 60


def test_every_format_is_here() -> None:
    from refcodec.convert.splat_files import READERS  # noqa: PLC0415

    # meta.json is SOG in a folder.
    assert {suffix.rpartition(".")[2] for suffix in BACK} == {suffix[1:] for suffix in FORMATS}
    assert set(READERS) == {*FORMATS, ".json"}


def test_the_scene_folder(tmp_path: Path) -> None:
    assert main(["decode", str(TRAINED), "-o", str(tmp_path / "scene")]) == 0
    assert main(["encode", str(tmp_path / "scene"), "-o", str(tmp_path / "a.c3gs")]) == 0
    assert (tmp_path / "a.c3gs").read_bytes() == TRAINED.read_bytes()


@pytest.mark.slow
@pytest.mark.parametrize("form", ["scaffold", "uncompressed"])
def test_folders(form: str, view: View, cameras: list[Camera], tmp_path: Path) -> None:
    """A folder shows the scene as it is. Encoding it again costs what new steps cost."""
    plain, file = tmp_path / "plain", tmp_path / "a.c3gs"
    if form == "scaffold":
        assert main(["export", str(TRAINED), "-o", str(tmp_path / "model"), "--scaffold"]) == 0
        assert main(["convert", str(tmp_path / "model"), "-o", str(plain)]) == 0
    else:
        scene = parse(TRAINED.read_bytes()).scene
        write_uncompressed(Uncompressed(reconstruct(scene), scene.masks, view.networks, view.info), plain)
    assert main(["encode", str(plain), "-o", str(file), "--lambda", "0.004", "--steps", "30"]) == 0
    assert_near(View(parse(file.read_bytes()).scene), view, cameras, FOLDER)


@pytest.mark.slow
def test_a_splat_becomes_a_scene(view: View, cameras: list[Camera], splats: Splats, tmp_path: Path) -> None:
    """A training of some steps from pictures of a file that refcodec wrote: it stands where the scene stood."""
    (tmp_path / "a.glb").write_bytes(splat_file(splats, ".glb", view.up).data)
    words = ["--views", "24", "--size", "64", "--steps", "200", "--anchors", "1500"]
    assert main(["convert", str(tmp_path / "a.glb"), "-o", str(tmp_path / "scene"), *words]) == 0
    assert main(["encode", str(tmp_path / "scene"), "-o", str(tmp_path / "a.c3gs")]) == 0
    found = View(parse((tmp_path / "a.c3gs").read_bytes()).scene)
    assert_near(found, view, cameras, TRAINING)
