"""Looking at scenes: cameras, files of images, figures of quality, and the commands render and eval."""

import io
import json
import math
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

for package in ("numba", "PIL", "skimage", "scipy"):
    pytest.importorskip(package, reason="looking at scenes needs the packages of the extra render")

from PIL import Image  # noqa: E402
from random_scenes import random_scene  # noqa: E402
from skimage.color.colorconv import xyz2rgb, xyz_from_rgb  # noqa: E402

import refcodec  # noqa: E402
from refcodec.bitstream import codec  # noqa: E402
from refcodec.bitstream.cameras import CAMERAS, NamedCamera, emit_cameras  # noqa: E402
from refcodec.bitstream.scene import Ancillary  # noqa: E402
from refcodec.cli.main import main  # noqa: E402
from refcodec.evaluate.quality import measures  # noqa: E402
from refcodec.rendering.camera import looking  # noqa: E402
from refcodec.rendering.view import View, eight_bits, gif, own_camera, png  # noqa: E402

ROOT = Path(__file__).resolve().parents[2]
PHOTOGRAPHS = ROOT / "examples" / "photographs" / "caliterra"
EXAMPLE = ROOT / "vectors" / "tiny-example.c3gs"


@pytest.mark.parametrize("up_axis", range(6))
def test_an_orbit_looks_at_the_middle(up_axis: int) -> None:
    scene = random_scene(71, 50)
    view = View(replace(scene, render=replace(scene.render, up_axis=up_axis)))
    middle = np.median(view.values.positions.astype(np.float64), axis=0)
    up = np.zeros(3)
    up[up_axis // 2] = [1, -1][up_axis % 2]
    distances = []
    for camera in view.orbit(7):
        assert np.allclose(camera.rotation @ camera.rotation.T, np.eye(3))
        assert np.linalg.det(camera.rotation) == pytest.approx(1)
        x, y, z = camera.rotation @ middle + camera.translation
        assert abs(x) + abs(y) < 1e-9 * z
        # What is above the middle is above it in the image, whose y points down, and in its middle column.
        above = camera.rotation @ (middle + up * z / 10) + camera.translation
        assert above[1] < 0
        assert above[0] == pytest.approx(0, abs=1e-9 * z)
        distances.append(z)
    assert np.allclose(distances, distances[0])


@pytest.mark.requirement("G6.5-2")
@pytest.mark.parametrize(("codes", "reported"), [((1, 8), False), ((2, 2), False), ((9, 16), True)])
def test_pictures_are_of_the_display(codes: tuple[int, int], reported: bool, tmp_path: Path, capsys: Any) -> None:
    """SPEC [G6.5-2]: linear light is encoded before eight bits. Other colours are drawn as sRGB, which is said."""
    scene = random_scene(73, 40)
    render = replace(scene.render, colour_primaries=codes[0], transfer_characteristics=codes[1])
    (tmp_path / "a.c3gs").write_bytes(codec.emit(replace(scene, render=render)))
    assert main(["render", str(tmp_path / "a.c3gs"), "-o", str(tmp_path / "out")]) == 0
    assert (f"the codes {codes[0]} and {codes[1]}" in capsys.readouterr().err) is reported
    view = View(scene)
    plain = np.clip(view.draw(own_camera(view.camera)), 0, 1)
    expected = xyz2rgb(plain @ xyz_from_rgb.T) if codes[1] == 8 else plain
    drawn = np.asarray(Image.open(tmp_path / "out" / "default.png"))
    assert np.abs(drawn / 255 - expected).max() < 0.6 / 255


def test_an_orbit_around_nothing() -> None:
    cameras = View(random_scene(72, 0)).orbit(2)
    assert all(np.isfinite(camera.translation).all() for camera in cameras)
    assert View(random_scene(72, 0)).draw(cameras[0].resized(8, 6)).shape == (6, 8, 3)


def test_huge_cameras_are_drawn_smaller(tmp_path: Path) -> None:
    """A file of a few bytes may ask for 65535 x 65535 pixels."""
    stated = NamedCamera("large", 65535, 13107, (65535.0, 50000.0), (32767.5, 6553.5))
    camera = own_camera(stated)
    assert (camera.width, camera.height) == (4096, 819)
    assert camera.fx == pytest.approx(4096)
    assert camera.cy == pytest.approx(409.5)
    thin = own_camera(replace(stated, width=1, height=65535))
    assert (thin.width, thin.height) == (1, 4096)
    assert own_camera(NamedCamera()).width == NamedCamera().width
    scene = replace(random_scene(73, 3), ancillary=(Ancillary(CAMERAS, 0, emit_cameras([stated])),))
    assert View(scene).orbit(1)[0].width == 4096


@pytest.mark.parametrize(
    "wrong",
    [
        *({"width": w, "height": h} for w, h in ((10**9, 1), (65535, 65535), (10_000, 10_001), (0, 5), (-1, -1))),
        *(
            {side: value}
            for side in ("width", "height")
            for value in (1.5, 1e300, math.nan, True, None, "8", np.ones(3))
        ),
        *({name: value} for name in ("fx", "fy", "cx", "cy") for value in (math.nan, math.inf, None, "x", np.ones(3))),
        *({name: value} for name in ("fx", "fy") for value in (0, -1.0)),
        *(
            {"rotation": value}
            for value in (None, 0.0, [0, 0, 0], np.zeros(3), np.full((3, 3), math.nan), np.eye(3) * 1j)
        ),
        *({"translation": value} for value in (None, 0.0, [0, 0, 0], np.zeros((3, 3)), np.full(3, math.inf))),
    ],
    ids=str,
)
def test_what_is_no_camera_draws_nothing(wrong: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    """A ValueError by each method that takes a camera, before any Gaussian is computed."""
    scene = refcodec.decode(EXAMPLE)
    camera = replace(scene.camera, **wrong)
    monkeypatch.setattr("refcodec.rendering.view.gaussians", pytest.fail)
    monkeypatch.setattr("refcodec.api.scenes.gaussians_of", pytest.fail)
    for use in (scene.render, scene.gaussians):
        with pytest.raises(ValueError, match=r"image|focal|rotation|translation"):
            use(camera)
        with pytest.raises(ValueError, match="the camera must be a Camera"):
            use("x")


def test_sides_of_numpy_are_sides() -> None:
    scene = refcodec.decode(EXAMPLE)
    camera = scene.camera.resized(np.int64(8), np.uint16(6))  # type: ignore[arg-type]
    assert scene.render(camera).shape == (6, 8, 3)


def test_what_does_not_fit_in_memory_is_refused(tmp_path: Path, monkeypatch, capsys) -> None:
    monkeypatch.setattr("refcodec.rendering.rasterise.PAIRS_MAX", 0)
    assert main(["render", str(EXAMPLE), "-o", str(tmp_path / "images")]) == 64
    assert "cannot be drawn" in capsys.readouterr().err
    assert main(["eval", str(EXAMPLE), str(PHOTOGRAPHS), "--size", "32"]) == 64
    assert "cannot be drawn" in capsys.readouterr().err


def test_looking() -> None:
    rotation = looking(np.array([0.0, 0.0, 2.0]), np.array([0.0, -1.0, 0.0]))
    assert np.allclose(rotation, np.eye(3))


def test_images_as_files() -> None:
    made = np.array([[[0, 0.5, 1], [-1, 2, 0.25]]], np.float32)
    assert eight_bits(made).tolist() == [[[0, 128, 255], [0, 255, 64]]]
    assert np.asarray(Image.open(io.BytesIO(png(eight_bits(made))))).tolist() == eight_bits(made).tolist()
    # The image says that its values are those of sRGB.
    assert b"cICP\x01\x0d\0\x01" in png(eight_bits(made))[:200]
    with Image.open(io.BytesIO(gif([np.full((4, 4, 3), v, np.uint8) for v in (0, 100, 200)]))) as animation:
        assert animation.n_frames == 3


def by_loops(a: np.ndarray, b: np.ndarray) -> float:
    """SSIM with zeros outside, written out."""
    window = np.exp(-((np.arange(11) - 5) ** 2) / 4.5)
    window = np.outer(window, window) / window.sum() ** 2
    total = []
    for channel in range(3):
        x, y = (np.pad(image[..., channel], 5) for image in (a, b))
        for i in range(a.shape[0]):
            for j in range(a.shape[1]):
                p, q = x[i : i + 11, j : j + 11], y[i : i + 11, j : j + 11]
                mp, mq = (window * p).sum(), (window * q).sum()
                vp, vq, both = (
                    (window * p * p).sum() - mp**2,
                    (window * q * q).sum() - mq**2,
                    (window * p * q).sum() - mp * mq,
                )
                total.append((2 * mp * mq + 1e-4) * (2 * both + 9e-4) / ((mp**2 + mq**2 + 1e-4) * (vp + vq + 9e-4)))
    return float(np.mean(total))


def test_measures() -> None:
    rng = np.random.default_rng(3)
    photograph = rng.integers(0, 256, (14, 17, 3)).astype(np.uint8)
    same = measures(photograph / 255, photograph)
    assert (same["psnr"], same["psnr_3dgs"]) == (np.inf, np.inf)
    assert same["ssim"] == pytest.approx(1)
    assert same["ssim_3dgs"] == pytest.approx(1)
    grey = np.full((14, 17, 3), 100, np.uint8)
    # 10 of 255 everywhere: 20 log10(25.5).
    assert measures(np.full((14, 17, 3), 110 / 255), grey)["psnr"] == pytest.approx(20 * np.log10(25.5))
    assert measures(np.full((14, 17, 3), 110 / 255), grey)["psnr_3dgs"] == pytest.approx(20 * np.log10(25.5))
    # A value past white counts as white.
    assert measures(np.full((14, 17, 3), 7.0), np.full((14, 17, 3), 255, np.uint8))["psnr_3dgs"] == np.inf
    made = np.clip(photograph / 255 + rng.normal(0, 0.2, photograph.shape), 0, 1)
    right = measures(made, photograph)
    assert right["ssim_3dgs"] == pytest.approx(by_loops(made, photograph / 255), abs=1e-12)
    # An exposure of its own costs nothing in the best colours; those of a plain image are the means.
    assert measures(0.3 + photograph / 510, photograph)["psnr_cc"] > 100 > right["psnr_cc"] > right["psnr_3dgs"]
    error = np.mean((photograph / 255).var(axis=(0, 1)))
    assert measures(np.full((14, 17, 3), 0.7), photograph)["psnr_cc"] == pytest.approx(-10 * np.log10(error))
    # What a mask excludes does not count, whatever it is.
    mask = rng.random((14, 17)) < 0.5
    other = [np.where(mask[..., None], values, rng.permutation(values)) for values in (made, photograph)]
    masked, error = measures(*other, mask), np.mean((made - photograph / 255)[mask] ** 2)
    assert masked == measures(made, photograph, mask) != right
    assert masked["psnr_3dgs"] == pytest.approx(-10 * np.log10(error))


# --- commands ---------------------------------------------------------------------------------------------------------


@pytest.fixture
def file(tmp_path: Path) -> str:
    """A scene with a small camera of its own."""
    scene = random_scene(73, 30, gain=0.3, base_step=(0.5, 0.125, 0.25))
    scene.networks["opacity"][-1][1][:] = 5
    own = NamedCamera("own", 40, 30, (35.0, 35.0), (20.0, 15.0))
    scene = replace(scene, ancillary=(Ancillary(CAMERAS, 0, emit_cameras([own])),))
    path = tmp_path / "scene.c3gs"
    path.write_bytes(codec.emit(scene))
    return str(path)


def test_render(file: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["render", file, "-o", str(tmp_path / "own")]) == 0
    assert Image.open(tmp_path / "own" / "default.png").size == (40, 30)
    assert main(["render", file, "-o", str(tmp_path / "orbit"), "--cameras", "orbit", "--frames", "3"]) == 0
    names = [*(f"orbit-000{number}.png" for number in range(3)), "orbit.gif"]
    assert sorted(p.name for p in (tmp_path / "orbit").iterdir()) == names
    assert main(["render", file, "-o", str(tmp_path / "photos"), "--cameras", str(PHOTOGRAPHS), "--size", "40"]) == 0
    made = sorted((tmp_path / "photos").iterdir())
    assert [p.stem for p in made] == sorted(p.stem for p in (PHOTOGRAPHS / "images").iterdir())
    assert Image.open(made[0]).size == (40, 30)
    assert "3 images, orbit.gif" in capsys.readouterr().out


def test_eval(file: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["eval", file, str(PHOTOGRAPHS), "--size", "40x30", "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["bytes"] == Path(file).stat().st_size == sum(result["parts"].values())
    assert set(result["mean"]) == {"psnr", "ssim", "psnr_3dgs", "ssim_3dgs", "psnr_cc"}
    assert (result["excluded"], result["masks"]) == (0, "")
    assert set(result["decode_seconds"]) == {"planes", "chunks", "total"}
    assert {"positions", "masks", "attributes", "planes", "weights"} <= set(result["parts"])
    assert result["held_out"]
    assert len(result["images"]) == 10
    for name, value in result["mean"].items():
        assert value == pytest.approx(np.mean([row[name] for row in result["images"]]))
    assert main(["eval", file, str(PHOTOGRAPHS), "--size", "40"]) == 0
    printed = capsys.readouterr().out
    assert f"{result['mean']['psnr']:.4f}" in printed
    assert "images a second" in printed


@pytest.mark.parametrize("words", [["render", "-o", "new"], ["eval", str(PHOTOGRAPHS)]], ids=lambda words: words[0])
def test_an_import_that_fails_is_a_fault(
    words: list[str], file: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """If no package is missing, it is not hidden."""
    monkeypatch.chdir(tmp_path)
    for name in ("evaluate.evaluation", "evaluate.quality", "rendering.view", "rendering.rasterise"):
        monkeypatch.delitem(sys.modules, f"refcodec.{name}", raising=False)
    monkeypatch.setitem(sys.modules, "refcodec.rendering.view", None)
    command, *more = words
    assert main([command, file, *more]) == 70
