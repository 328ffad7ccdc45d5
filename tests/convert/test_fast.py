"""convert --fast: Gaussians as a static scene, whose rendering networks are linear decoders."""

import re
from pathlib import Path

import numpy as np
import pytest

for package in ("torch", "numba", "PIL", "skimage", "scipy"):
    pytest.importorskip(package)

from plain import made, write  # noqa: E402

from refcodec.bitstream.codec import emit, parse  # noqa: E402
from refcodec.bitstream.header import RenderInfo  # noqa: E402
from refcodec.bitstream.networks import IntNetwork, derive_layer  # noqa: E402
from refcodec.bitstream.positions import chunk_codes  # noqa: E402
from refcodec.bitstream.reconstruction import gaussians  # noqa: E402
from refcodec.bitstream.splat import OUTPUT_BITS  # noqa: E402
from refcodec.cli.main import main  # noqa: E402
from refcodec.convert import fast  # noqa: E402
from refcodec.convert.drawing import drawn, tensors  # noqa: E402
from refcodec.convert.fast import Measured, coded, converted  # noqa: E402
from refcodec.convert.importance import numbers, own_importance, splats_of  # noqa: E402
from refcodec.convert.linear import hidden_units, network  # noqa: E402
from refcodec.convert.views import AXES, among, generated, near_plane, orbit  # noqa: E402
from refcodec.formats.splats import Splats  # noqa: E402
from refcodec.rendering.gaussians import static_splats  # noqa: E402
from refcodec.rendering.rasterise import Settings, draw  # noqa: E402
from refcodec.rendering.view import View  # noqa: E402
from refcodec.train import fit as train_fit  # noqa: E402


def test_numbers_draw_the_same() -> None:
    """Another choice of a Gaussian's axes is the same Gaussian, with a small rotation."""
    splats = made()
    table = numbers(splats)
    assert np.abs(table[:, 4:7]).max() <= 1
    camera = orbit(splats, AXES["-y"], 40, 3, 1)["train"][1]
    again = splats_of(splats.mean, table)
    first, second = (draw(s, camera, Settings(near_plane=0.01)).image for s in (splats, again))
    assert np.abs(first - second).max() < 1e-4


@pytest.mark.parametrize("classes", [1, 2, 4])
def test_a_linear_network(classes: int) -> None:
    """The integers compute the map of each class up to their last rounding, also at the ends of the range."""
    rng = np.random.default_rng(classes)
    basis = np.linalg.qr(rng.normal(size=(5, 5)))[0]
    steps, inputs = rng.uniform(0.01, 1.6, (classes, 5)), np.array([2, 3, 4, 6, 7])
    middle = rng.normal(size=(classes, 5))
    layers, maps = network(steps, basis, middle, inputs, 9, hidden_units(classes, 5) + 3)
    exact = IntNetwork([derive_layer(*layer) for layer in layers])
    for k in range(classes):
        values = rng.integers(-maps.most[k], maps.most[k] + 1, (50, 5))
        features = rng.integers(-1000, 1000, (50, 9))
        features[:, 0], features[:, inputs] = k, values
        np.testing.assert_allclose(exact(features) / 2.0**OUTPUT_BITS, maps.numbers(values, k), atol=2.0**-OUTPUT_BITS)
        assert np.array_equal(maps.symbols(maps.numbers(values, k), k), values)
        assert np.abs(maps.matrix[k] - steps[k] * basis).max() < 0.02
        np.testing.assert_allclose(maps.middle[k], middle[k], atol=0.02)


def test_no_two_positions_are_equal() -> None:
    """Equal means get neighbouring cells, so that positions are packed."""
    splats = made(200, 0)
    splats.mean[100:] = splats.mean[:100]
    table = numbers(splats)
    n = len(table)
    scene = coded(Measured(splats.mean, table, np.ones(n), np.ones((n, 4)), np.ones(n)), 1e-3)
    assert len(np.unique(scene.positions, axis=0)) == n
    unit = scene.grid.scale_mantissa * 2.0**scene.grid.scale_exponent
    assert np.abs(scene.positions - splats.mean).max() < 4 * unit


@pytest.mark.parametrize("degree", [0, 3])
def test_a_scene_is_as_good_as_wanted(degree: int) -> None:
    splats = made(400, degree)
    cameras = orbit(splats, AXES["-y"], 48, 8, 2)
    render = RenderInfo(near_plane=near_plane(splats))
    result = converted([splats], cameras, render, 1, 40, 20)
    assert result.whole
    assert abs(np.mean(result.psnr) - 40) < 1
    scene = result.scene
    assert scene.position_model is not None
    assert chunk_codes(scene.positions, scene.position_model.cell_shift) is not None
    assert gaussians(scene).shape == (scene.anchor_count, 11 + 3 * (degree + 1) ** 2)
    # What the decoder draws is what the search has judged.
    errors = []
    for camera in cameras["test"]:
        truth, _, _ = drawn(tensors(splats), camera, Settings(near_plane=render.near_plane))
        errors.append(np.square(View(scene).draw(camera).clip(0, 1) - truth.clamp(0, 1).numpy()).mean())
    np.testing.assert_allclose(-10 * np.log10(errors), result.psnr, atol=0.3)


def test_convert_fast(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write(made(100, 1), tmp_path / "a.ply")
    words = ["convert", str(tmp_path / "a.ply"), "-o", str(tmp_path / "a.c3gs"), "--fast"]
    small = ["--views", "8", "--size", "40", "--steps", "5"]
    assert main([*words, *small, "--psnr", "38", "--up=+z"]) == 0
    out, err = capsys.readouterr()
    assert re.search(
        r": 3[78]\.\d dB in 8 pictures of 40 pixels by cameras around and among .*, 3\d\.\d in the worst", out
    )
    assert "were guessed" in err
    scene = parse((tmp_path / "a.c3gs").read_bytes()).scene
    assert (scene.render.render_model, scene.render.up_axis) == (1, 4)
    # The cameras of a file, and those of photographs.
    photographs = Path(__file__).parents[2] / "examples" / "photographs" / "caliterra"
    for cameras in (tmp_path / "a.c3gs", photographs):
        again = [*words[:3], str(tmp_path / "again.c3gs"), "--fast", *small, "--cameras", str(cameras)]
        assert main(again) == 0
        out, err = capsys.readouterr()
        assert "by cameras of the splats" in out
        assert "guessed" not in err
    # An output never replaces an input.
    assert main([*again[:3], str(tmp_path / "a.c3gs"), "--fast", "--cameras", str(tmp_path / "a.c3gs")]) == 64
    assert "a.c3gs" in capsys.readouterr().err


def test_many_gaussians(monkeypatch: pytest.MonkeyPatch) -> None:
    """They have layers and more lanes, and the entropy model learns from some of them; all are in the file."""
    monkeypatch.setattr(fast, "LARGE", 1000)
    monkeypatch.setattr(train_fit, "SAMPLE", 300)
    splats = made(2000, 0)
    splats.opacity[:] = 3
    cameras = orbit(splats, AXES["-y"], 32, 4, 2)
    scene = converted([splats], cameras, RenderInfo(near_plane=near_plane(splats)), 1, 50, 12).scene
    again = parse(emit(scene)).scene
    assert again.chunk_anchors == (scene.anchor_count // 4, scene.anchor_count - scene.anchor_count // 4)
    assert (again.lanes.attribute, len(static_splats(again).mean)) == (fast.LANES, scene.anchor_count)


def far_out(splats: Splats, distance: float) -> Splats:
    """Gaussians with one more, as far away as wanted, and as large as a tenth of it."""
    one = vars(made(1, splats.degree)) | {"scale": np.full((1, 3), np.log(distance / 10), np.float32)}
    one |= {"mean": np.float32([[0, 0, distance]]), "opacity": np.float32([3])}
    return Splats(**{name: np.concatenate([values, one[name]]) for name, values in vars(splats).items()})


@pytest.mark.parametrize("distance", [300, 1e5])
def test_a_sky_costs_nothing(distance: float) -> None:
    """One Gaussian far out sets neither the lattice nor a step of the others, and is where it was."""
    splats = far_out(made(200, 0), distance)
    cameras = generated(splats, AXES["-y"], 48, 8, 8)
    result = converted([splats], cameras, RenderInfo(near_plane=near_plane(splats)), 1, 44, 5)
    assert abs(np.mean(result.psnr) - 44) < 1
    mean = static_splats(parse(emit(result.scene)).scene).mean
    assert abs(np.abs(mean).max() / distance - 1) < 1e-3
    unit = result.scene.grid.scale_mantissa * 2.0**result.scene.grid.scale_exponent
    assert unit < 0.05


def test_cameras_among_the_splats_see_from_near() -> None:
    """Half of them stand inside a hollow ball, and nothing is between any and what it looks at."""
    splats = made(3000, 0)
    away = splats.mean / np.linalg.norm(splats.mean, axis=1, keepdims=True)
    splats.mean[:], splats.opacity[:] = 3 * away, 4
    cameras = among(splats, AXES["-y"], 40, 12, 4)
    assert [len(cameras[name]) for name in ("train", "test")] == [12, 4]
    places = np.array([camera.centre for name in cameras for camera in cameras[name]])
    inside = np.linalg.norm(places, axis=1) < 2.9
    assert 0.4 <= inside.mean() < 1
    nearest = np.linalg.norm(splats.mean[None] - places[:, None], axis=2).min(axis=1)
    assert nearest.min() > 0.2


def test_an_error_counts_in_relation_to_the_gaussian() -> None:
    """Of two Gaussians of one shape, a shift matters by the square of their size, and a fainter one matters less."""
    splats = made(4, 0)
    splats.quaternion[:], splats.opacity[:] = (1, 0, 0, 0), (2, 2, -2, 2)
    splats.scale[:] = np.log([[1, 0.5, 0.1], [10, 5, 1], [1, 0.5, 0.1], [1, 0.5, 1e-6]])
    by_mean, by_length, *_, absence = own_importance(numbers(splats)).T
    assert by_mean[0] / by_mean[1] == pytest.approx(100)
    assert by_length[0] == pytest.approx(by_length[1])
    assert by_mean[2] < by_mean[0] / 10
    assert absence[2] < absence[0] / 10
    # A thin axis is one below a pixel: its importance has a bound.
    assert np.isfinite(by_mean).all()
    assert by_mean[3] < 20 * by_mean[0]


def test_gaussians_in_one_place() -> None:
    splats = made(50, 0)
    splats.mean[:] = 3
    cameras = orbit(splats, AXES["-y"], 24, 4, 1)
    assert converted([splats], cameras, RenderInfo(near_plane=near_plane(splats)), 1, 30, 2).scene.anchor_count > 0
