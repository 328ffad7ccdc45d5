"""Rendering (SPEC.md chapter 14): Gaussians against the text's own python blocks in binary64."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import mpmath
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from random_scenes import random_scene

import refcodec
from conformance.cases import static
from conformance.manifest import VECTORS
from refcodec import statuses
from refcodec.bitstream.cameras import NamedCamera, rotation_matrix
from refcodec.bitstream.codec import parse
from refcodec.bitstream.dimensions import RENDERING
from refcodec.bitstream.header import RenderInfo
from refcodec.bitstream.reconstruction import Reconstruction, digest, reconstruct
from refcodec.bitstream.reconstruction import gaussians as splat_of
from refcodec.bitstream.scene import Scene
from refcodec.cli.main import main
from refcodec.rendering import gaussians
from refcodec.rendering.camera import Camera, default_camera
from refcodec.rendering.view import View

ROOT = Path(__file__).resolve().parents[2]


# Of the scenes: the distance that the networks have as 1.
UNIT = 2.5


def scene_of(seed: int, anchors: int = 60) -> tuple[Scene, Reconstruction, Camera]:
    """A scene of ordinary sizes, and a camera among its anchors."""
    rng = np.random.default_rng(seed)
    scene = random_scene(seed, anchors, gain=0.3, base_step=(0.5, 0.125, 0.25))
    scene = replace(scene, render=replace(scene.render, distance_unit=UNIT))
    # Some opacities above 0 and some below, by the offset and by the anchor.
    weight, bias = scene.networks["opacity"][-1]
    weight[:], bias[:] = rng.normal(0, 0.1, weight.shape), [0.5, -0.3]
    values = reconstruct(scene)
    values = replace(values, positions=rng.normal(0, 4, (anchors, 3)).astype(np.float32))
    quaternion = rng.normal(size=4)
    rotation = rotation_matrix(quaternion / np.linalg.norm(quaternion))
    return scene, values, Camera("c", 64, 48, 55.0, 54.0, 31.5, 25.0, rotation, rng.normal(0, 3, 3))


def by_the_text(spec: dict, scene: Scene, values: Reconstruction, camera: Camera) -> list[tuple]:
    networks = {name: [(w.tolist(), b.tolist()) for w, b in scene.networks[name]] for name in RENDERING}
    parts = (values.positions, values.features, values.scalings, values.offsets)
    view, drawn = (camera.centre.tolist(), scene.render.distance_unit), []
    for n in range(scene.anchor_count):
        row = (part[n].astype(np.float64).tolist() for part in parts)
        drawn += spec["GAUSSIANS"](networks, *row, scene.masks[n].tolist(), *view)
    return drawn


def compared(actual: gaussians.Gaussians, wanted: list[tuple], tolerance: float) -> None:
    """Each vector within a tolerance relative to its length."""
    assert len(actual.opacity) == len(wanted) > 0
    for name, column in (("mean", 0), ("lengths", 1), ("quaternion", 2), ("opacity", 3), ("colour", 4)):
        made = getattr(actual, name).astype(np.float64).reshape(len(wanted), -1)
        right = np.array([w[column] for w in wanted]).reshape(len(wanted), -1)
        assert (np.abs(made - right).max(axis=1) <= tolerance * np.linalg.norm(right, axis=1)).all(), name


@pytest.mark.requirement("G14.3-1")
@pytest.mark.parametrize("seed", range(8))
def test_gaussians_are_those_of_the_text(spec: dict, seed: int) -> None:
    scene, values, camera = scene_of(seed)
    wanted = by_the_text(spec, scene, values, camera)
    compared(gaussians.gaussians(values, scene.masks, scene.networks, camera, UNIT, np.float64), wanted, 1e-12)
    # In binary32 those whose opacity is next to nothing may come and go.
    single = gaussians.gaussians(values, scene.masks, scene.networks, camera, UNIT)
    assert single.opacity.dtype == np.float32
    assert abs(len(single.opacity) - len(wanted)) <= 1
    if len(single.opacity) == len(wanted):
        compared(single, wanted, 1e-4)


def test_masked_offsets_and_negative_opacities_give_nothing(spec: dict) -> None:
    scene, values, camera = scene_of(9)
    drawn = gaussians.gaussians(values, scene.masks, scene.networks, camera, UNIT)
    assert scene.masks[drawn.anchor, drawn.offset].all()
    assert (drawn.opacity > 0).all()
    nothing = replace(scene, masks=np.zeros_like(scene.masks))
    assert len(gaussians.gaussians(values, nothing.masks, scene.networks, camera, UNIT).opacity) == 0
    assert by_the_text(spec, nothing, values, camera) == []


def test_an_anchor_in_the_camera_and_a_quaternion_of_nothing(spec: dict) -> None:
    """Direction zero at distance zero; an output of four zeros is no rotation."""
    scene, values, camera = scene_of(10, 1)
    for layers in (scene.networks["covariance"], scene.networks["opacity"]):
        layers[-1][0][:] = 0
        layers[-1][1][:] = 1
    scene.networks["covariance"][-1][1].reshape(-1, 7)[:, 3:] = 0
    masks = np.ones_like(scene.masks)
    values = replace(values, positions=camera.centre[None].astype(np.float32))
    camera = replace(camera, translation=-camera.rotation @ values.positions[0].astype(np.float64))
    drawn = gaussians.gaussians(values, masks, scene.networks, camera, UNIT, np.float64)
    assert drawn.quaternion.tolist() == [[1, 0, 0, 0]] * len(drawn.opacity)
    compared(drawn, by_the_text(spec, replace(scene, masks=masks), values, camera), 1e-9)


SIDES = st.integers(1, (1 << 32) - 1)
NUMBERS = st.floats(width=32, allow_nan=False, allow_infinity=False)
ABOVE_0 = st.floats(min_value=0, exclude_min=True, width=32, allow_infinity=False)


@given(
    st.builds(
        NamedCamera,
        width=SIDES,
        height=SIDES,
        focal=st.tuples(ABOVE_0, ABOVE_0),
        principal_point=st.tuples(NUMBERS, NUMBERS),
        rotation=st.tuples(NUMBERS, NUMBERS, NUMBERS, NUMBERS).filter(any),
        translation=st.tuples(NUMBERS, NUMBERS, NUMBERS),
    )
)
def test_the_default_camera_of_any_file(stated: NamedCamera) -> None:
    assert stated.fault() is None
    camera = default_camera(stated)
    assert np.allclose(camera.rotation @ camera.rotation.T, np.eye(3), atol=1e-9)
    assert np.linalg.det(camera.rotation) == pytest.approx(1)
    assert (camera.cx, camera.cy) == stated.principal_point


@given(st.integers(0, 2**32 - 1))
def test_rotation_is_that_of_the_text(spec: dict, seed: int) -> None:
    quaternion = np.random.default_rng(seed).normal(size=(3, 4))
    quaternion /= np.linalg.norm(quaternion, axis=1, keepdims=True)
    wanted = [spec["ROTATION"](q) for q in quaternion.tolist()]
    assert np.allclose(rotation_matrix(quaternion), wanted, atol=1e-15)


# --- images -----------------------------------------------------------------------------------------------------------


def drawn_by_the_text(spec: dict, cloud_of: gaussians.Gaussians, camera: Camera, info: RenderInfo) -> np.ndarray:
    """An image by PROJECT and PIXEL."""
    stated = {"rotation": camera.rotation.tolist(), "translation": camera.translation.tolist()}
    stated |= {"focal": (camera.fx, camera.fy), "principal_point": (camera.cx, camera.cy)}
    stated |= {"size": (camera.width, camera.height)}
    drawn = []
    for n in range(len(cloud_of.opacity)):
        shape = (getattr(cloud_of, name)[n].astype(np.float64).tolist() for name in ("mean", "lengths", "quaternion"))
        projection = spec["PROJECT"](*shape, stated, info.near_plane, info.low_pass)
        if projection is not None:
            drawn.append((projection, float(cloud_of.opacity[n]), cloud_of.colour[n].tolist()))
    drawn.sort(key=lambda d: d[0][2])
    background = [b / 255 for b in info.background]

    def pixel(j: int, i: int) -> list[float]:
        colour: list[float] = spec["PIXEL"](i + 0.5, j + 0.5, drawn, background, info.alpha_max)
        return colour

    return np.array([[pixel(j, i) for i in range(camera.width)] for j in range(camera.height)])


def cloud(seed: int, count: int, spread: float = 1.0) -> gaussians.Gaussians:
    """Gaussians of all sizes around a point before a camera at the origin; some behind it, some beside the image."""
    rng = np.random.default_rng(seed)
    quaternion = rng.normal(size=(count, 4))
    return gaussians.Gaussians(
        (rng.normal(0, spread, (count, 3)) + np.array([0, 0, 3])).astype(np.float32),
        np.exp(rng.normal(-2, 1.5, (count, 3))).astype(np.float32),
        (quaternion / np.linalg.norm(quaternion, axis=1, keepdims=True)).astype(np.float32),
        rng.uniform(0.001, 1, count).astype(np.float32),
        rng.uniform(0, 1, (count, 3)).astype(np.float32),
        np.arange(count),
        np.zeros(count, np.int64),
    )


@pytest.fixture
def rasterise() -> Any:
    return pytest.importorskip("refcodec.rendering.rasterise", reason="images need the packages of the extra render")


VIEW = Camera("view", 37, 21, 30.0, 28.0, 17.0, 11.5, np.eye(3), np.zeros(3))


def same_depth(splats: gaussians.Gaussians) -> None:
    splats.mean[:, 2] = 3


def opaque(splats: gaussians.Gaussians) -> None:
    splats.opacity[:] = 1


def not_points(splats: gaussians.Gaussians) -> None:
    splats.lengths[:] = np.maximum(splats.lengths, 0.01)


BACKGROUND = {"background": (10, 200, 90)}
# The Gaussians, what is changed of them, the camera's turn, and the render information. A pixel differs where an alpha
# next to 1/255 falls on the other side. With alpha_max = 1 an opaque Gaussian finishes a pixel and is not in it; below
# 1/255 nothing counts. Depths that are turned by 1e-8 are equal in binary32.
PLAIN = ((0, 0, 1.0), (1, 1, 0.1), (2, 30, 0.5), (3, 80, 1.5), (4, 60, 6.0))
ALPHAS, LOW_PASSES = (1.0, 0.5, 0.0039215689, 0.003, 1e-30), (0.0, 1e-20, 1e20, 3e38)
IMAGES: list[tuple[tuple[int, int, float], Any, float, dict[str, Any]]] = [
    *((made_of, None, 0.0, BACKGROUND) for made_of in PLAIN),
    ((5, 12, 0.2), same_depth, 0.0, {}),
    *(((9, 30, 0.3), same_depth, angle, {}) for angle in (1e-8, -1e-8)),
    *(((8, 40, 0.5), opaque, 0.0, {**BACKGROUND, "alpha_max": most}) for most in ALPHAS),
    *(((11, 20, 0.5), not_points, 0.0, {**BACKGROUND, "low_pass": least}) for least in LOW_PASSES),
]


@pytest.mark.requirement("G14.5-1")
@pytest.mark.parametrize(
    ("made_of", "change", "angle", "info"), IMAGES, ids=[f"{seed}-{count}" for (seed, count, _), *_ in IMAGES]
)
def test_images_are_those_of_the_text(
    spec: dict, made_of: tuple[int, int, float], change: Any, angle: float, info: dict[str, Any], rasterise: Any
) -> None:
    splats, render = cloud(*made_of), RenderInfo(**info)
    if change:
        change(splats)
    view = replace(VIEW, rotation=np.array([[1, 0, -angle], [0, 1, 0], [angle, 0, 1]]))
    made, wanted = rasterise.image(splats, view, render), drawn_by_the_text(spec, splats, view, render)
    assert made.shape == (21, 37, 3)
    assert made.dtype == np.float32
    assert np.abs(made - wanted).max() < (1e-5 if change is same_depth else 5e-3)
    if change is None:
        # Far better than the 50 dB asked for.
        assert np.mean((made - wanted) ** 2) < 1e-9
    if change is opaque:
        assert (made == made[0, 0]).all() == (render.alpha_max < 1 / 255)


@pytest.mark.parametrize("size", [1e3, 1e6, 1e9, 1e15, 1e18])
def test_long_and_far(spec: dict, size: float, rasterise: Any) -> None:
    """Needles that reach into the image from far outside, and Gaussians that hardly change over it."""
    splats = cloud(10, 6, 0.3)
    splats.mean[:, 0], splats.mean[:3, 1], splats.mean[:, 2] = size * np.array([-1, 1, -0.5, 1, -2, 0.3]), 0.1, 3
    splats.mean[3:, 1] = size * np.array([0.2, -0.5, 0.1])
    splats.quaternion[:] = (1, 0, 0, 0)
    splats.lengths[:] = size
    splats.lengths[:3, 1:] = 0.3
    info = RenderInfo(background=(10, 200, 90))
    made = rasterise.image(splats, VIEW, info)
    assert (made != made[0, 0]).any()
    assert np.allclose(made, drawn_by_the_text(spec, splats, VIEW, info), atol=1e-4)


@pytest.mark.parametrize("seed", range(12))
def test_any_sizes(spec: dict, seed: int, rasterise: Any) -> None:
    """The text with 60 digits: binary64 does not hold its d of a needle. Bound: what float32 makes of a pixel."""
    rng = np.random.default_rng(seed)
    splats, q = cloud(seed, 6), rng.normal(size=4)
    magnitude = np.exp2(rng.uniform(-30, 30, (2, 6, 3))).astype(np.float32)
    splats = replace(splats, mean=splats.mean * magnitude[0], lengths=splats.lengths * magnitude[1])
    camera = Camera("view", 11, 7, 9.0, 8.0, 5.0, 3.5, rotation_matrix(q / np.linalg.norm(q)), np.array([0, 0, 3.0]))
    info = RenderInfo(low_pass=(0.0, 1e-9, 0.3, 100.0)[seed % 4], near_plane=1e-30, background=(10, 200, 90))
    with mpmath.workdps(60):
        mp = np.frompyfunc(lambda x: mpmath.mpf(float(x)), 1, 1)
        quaternion = [[x / mpmath.norm(row.tolist()) for x in row] for row in mp(splats.quaternion)]
        stated = {
            "rotation": mp(camera.rotation).tolist(), "translation": mp(camera.translation).tolist(), "focal": (9, 8),
            "principal_point": (5, 3.5), "size": (11, 7),
        }  # fmt: skip
        shapes = zip(mp(splats.mean).tolist(), mp(splats.lengths).tolist(), quaternion, strict=True)
        projected = [spec["PROJECT"](*shape, stated, info.near_plane, info.low_pass) for shape in shapes]
        drawn = [
            (p, o, c)
            for p, o, c in zip(projected, splats.opacity.tolist(), splats.colour.tolist(), strict=True)
            if p is not None
        ]
        drawn.sort(key=lambda d: d[0][2])
        rest = (drawn, [b / 255 for b in info.background], info.alpha_max)
        wanted = np.array([[spec["PIXEL"](i + 0.5, j + 0.5, *rest) for i in range(11)] for j in range(7)]).astype(float)
    assert np.abs(rasterise.image(splats, camera, info) - wanted).max() < 1e-5


@pytest.mark.filterwarnings("error")
def test_hostile_numbers_give_an_image(rasterise: Any) -> None:
    """Whatever a valid file's floats are, an image is made, of finite numbers and without a warning."""
    splats = cloud(7, 40)
    splats.mean[:10] = [[1e30, 0, 1], [0, 0, 0.2], [0, 0, 1e-30], [np.inf, 0, 1], [np.nan, 0, 1], *[[0, 0, 1e20]] * 5]
    splats.lengths[10:13] = [[0, 0, 0], [1e30, 1e30, 1e30], [np.inf, 1, 1]]
    splats.lengths[13:16] = [[1e-40, 1, 1], [1e18, 1e-18, 0], [1e6, 1e6, 1e6]]
    assert np.isfinite(rasterise.image(splats, VIEW, RenderInfo())).all()
    splats.colour[20:23] = [[np.nan, 0, 0], [0, np.inf, 0], [0, 0, -np.inf]]
    assert np.isfinite(rasterise.image(splats, VIEW, RenderInfo())).all()
    # Any magnitudes of means and lengths, with the least and the largest values of the render information.
    rng = np.random.default_rng(12)
    least, most = float(np.finfo(np.float32).smallest_subnormal), float(np.finfo(np.float32).max)
    for near_plane, low_pass, focal in ((least, 0.0, most), (least, most, least), (1.0, 0.0, 30.0), (most, 0.3, 30.0)):
        splats = cloud(13, 300)
        magnitude = np.exp2(rng.uniform(-140, 120, (2, 300, 3))).astype(np.float32)
        splats = replace(splats, mean=splats.mean * magnitude[0], lengths=splats.lengths * magnitude[1])
        stated = NamedCamera("least", 40, 30, (focal, focal), (20.0, 15.0))
        made = rasterise.image(splats, default_camera(stated), RenderInfo(near_plane=near_plane, low_pass=low_pass))
        assert np.isfinite(made).all()


@pytest.mark.filterwarnings("error")
def test_hostile_networks_give_gaussians() -> None:
    """Weights and scalings whose products and exponentials overflow."""
    scene, values, camera = scene_of(14)
    for layers in scene.networks.values():
        layers[0][0][:] *= np.float32(1e30)
        layers[-1][0][:] *= np.float32(1e20)
    values = replace(values, scalings=values.scalings * np.float32(1e4), positions=values.positions * np.float32(1e30))
    for dtype in (np.float32, np.float64):
        drawn = gaussians.gaussians(values, scene.masks, scene.networks, camera, UNIT, dtype)
        assert (drawn.opacity > 0).all()


@pytest.mark.requirement("G6.5-1")
def test_another_render_model_is_decoded_but_not_drawn(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    file = VECTORS / "valid" / "render-model-2.c3gs"
    scene = parse(file.read_bytes()).scene
    assert scene.render.render_model == 2
    with pytest.raises(ValueError, match="render_model 2"):
        View(scene)
    opened = refcodec.open(file)
    assert opened.decode().digest() == digest(scene)[0]
    with pytest.raises(ValueError, match="render_model 2"):
        opened.decode().gaussians()
    assert main(["render", str(file), "-o", str(tmp_path / "images")]) == statuses.USAGE
    assert "use a later version" in capsys.readouterr().err


@pytest.mark.requirement("G14.6-1")
@pytest.mark.parametrize("degree", range(4))
def test_static_gaussians_are_those_of_the_text(spec: dict, degree: int) -> None:
    """From a camera among the anchors, in both precisions. At the mean itself the direction is zero."""
    scene = parse(static.of_degree(degree)).scene
    numbers, splats = splat_of(scene), gaussians.static_splats(scene)
    _, _, camera = scene_of(3)
    for place in (camera.centre, numbers[0, :3].astype(np.float64)):
        moved = replace(camera, translation=-camera.rotation @ place)
        wanted = [spec["STATIC_GAUSSIAN"](row, list(moved.centre)) for row in numbers.astype(np.float64).tolist()]
        compared(gaussians.static_gaussians(splats, scene.masks, moved, np.float64), wanted, 1e-9)
        compared(gaussians.static_gaussians(splats, scene.masks, moved), wanted, 1e-4)
    assert len(View(scene).gaussians(camera).mean) == scene.masks.sum()


def test_what_reads_the_view_takes_no_static_scene() -> None:
    with pytest.raises(gaussians.RenderModelError, match="must have 0"):
        gaussians.check_view_dependent(parse((VECTORS / "valid" / "static-degree-1.c3gs").read_bytes()).scene.render)
