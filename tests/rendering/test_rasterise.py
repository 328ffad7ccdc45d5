"""The rasteriser against a dense float64 one, whose gradients are autograd's; SSIM against a float64 convolution."""

import hashlib
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="gradients are compared with torch's")
pytest.importorskip("numba", reason="images need the packages of the extra render")

from hypothesis import given  # noqa: E402
from hypothesis import strategies as st  # noqa: E402

from refcodec.rendering.camera import Camera  # noqa: E402
from refcodec.rendering.rasterise import Settings, rasterise, rasterise_backward  # noqa: E402
from refcodec.train import device, splat  # noqa: E402
from refcodec.train.cpu.photometric import Photometric  # noqa: E402
from refcodec.train.splat import Rasterise  # noqa: E402

HERE = Path(__file__).resolve().parent
NAMES = ("mean", "quaternion", "scale", "opacity", "colour")
Scene = dict[str, np.ndarray]

# Float32 blending against float64. An exponent is off by some 1e-6 (u and v are up to 40 and rounded to 2e-6, but
# small where alpha is not), and so are alpha, the image and the gradients, relative to their norm. Measured over six
# seeds of each case: 1.4e-6 and 2e-6 at most; the bounds leave a factor of three to five.
IMAGE_ERROR, GRADIENT_ERROR = 5e-6, 1e-5
# Where alpha is this close (relatively) to 1/255 or to its cap, or transmittance to 1e-4, the float32 image may
# rightly take the other branch: such pixels are not compared, and no gradient comes from them.
FRAGILE = 2e-5


def camera(width: int = 50, height: int = 37, angle: float = 0.1) -> Camera:
    c, s = np.cos(angle), np.sin(angle)
    rotation = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]) @ np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
    return Camera(
        "view", width, height, 45.0, 43.0, width / 2 + 1.3, height / 2 - 0.7, rotation, np.array([0.05, -0.02, 0.1])
    )


VIEW, COLOURED = camera(), Settings(background=(0.1, 0.2, 0.3))


def scene(
    n: int, seed: int, view: Camera = VIEW, *, size: float = 0.1, low: float = 2, high: float = 6, spread: float = 1.1
) -> Scene:
    """n Gaussians of depth low to high in the view, `spread` times as far as its edges.

    size: of their deviations, in the mean's unit.
    """
    rng = np.random.default_rng(seed)
    z = rng.uniform(low, high, n)
    x = (rng.uniform(-spread, spread, n) * view.width / 2) / view.fx * z
    y = (rng.uniform(-spread, spread, n) * view.height / 2) / view.fy * z
    values = {
        "mean": (np.stack([x, y, z], -1) - view.translation) @ view.rotation,
        "quaternion": rng.normal(size=(n, 4)),
        "scale": size * np.exp(0.5 * rng.normal(size=(n, 3))),
        "opacity": 1 / (1 + np.exp(-1.5 * rng.normal(size=n))),
        "colour": rng.uniform(size=(n, 3)),
    }
    return {k: v.astype(np.float32) for k, v in values.items()}


def dense(
    values: dict[str, torch.Tensor], view: Camera, settings: Settings
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Image, transmittance and the pixels that are fragile: every Gaussian in every pixel, float64.

    values["moved"] [N,2], if there, is added to the projected means.
    """
    world, shift = torch.from_numpy(view.rotation), torch.from_numpy(view.translation)
    p = values["mean"] @ world.T + shift
    drawn = (p[:, 2] > settings.near_plane) & (values["opacity"] >= 1 / 255)
    order = torch.argsort(p[:, 2].detach(), stable=True)
    order = order[drawn[order]]
    p, q, s, opacity, colour = p[order], *(values[k][order] for k in NAMES[1:])
    x, y, z = p.unbind(-1)
    w, i, j, k = (q / q.norm(dim=-1, keepdim=True)).unbind(-1)
    first = (1 - 2 * (j * j + k * k), 2 * (i * j - w * k), 2 * (i * k + w * j))
    second = (2 * (i * j + w * k), 1 - 2 * (i * i + k * k), 2 * (j * k - w * i))
    third = (2 * (i * k - w * j), 2 * (j * k + w * i), 1 - 2 * (i * i + j * j))
    r = torch.stack([*first, *second, *third], -1).reshape(-1, 3, 3)
    covariance = world @ r @ torch.diag_embed(s * s) @ r.transpose(1, 2) @ world.T
    margin_x, margin_y = 0.15 * view.width / view.fx, 0.15 * view.height / view.fy
    slope_x = (x / z).clamp(-view.cx / view.fx - margin_x, (view.width - view.cx) / view.fx + margin_x)
    slope_y = (y / z).clamp(-view.cy / view.fy - margin_y, (view.height - view.cy) / view.fy + margin_y)
    zero = torch.zeros_like(z)
    jacobian = torch.stack(
        [view.fx / z, zero, -view.fx * slope_x / z, zero, view.fy / z, -view.fy * slope_y / z], -1
    ).reshape(-1, 2, 3)
    flat = jacobian @ covariance @ jacobian.transpose(1, 2) + settings.low_pass * torch.eye(2, dtype=torch.float64)
    inverse = torch.linalg.inv(flat)
    centre = torch.stack([view.fx * x / z + view.cx, view.fy * y / z + view.cy], -1)
    if "moved" in values:
        centre = centre + values["moved"][order]
    rows, columns = torch.meshgrid(torch.arange(view.height) + 0.5, torch.arange(view.width) + 0.5, indexing="ij")
    d = torch.stack([columns, rows], -1).double().reshape(-1, 1, 2) - centre
    raw = opacity * torch.exp(-0.5 * torch.einsum("pni,nij,pnj->pn", d, inverse, d))
    seen = raw >= 1 / 255
    alpha = torch.where(seen, raw.clamp(max=settings.alpha_max), 0.0)
    with torch.no_grad():
        left = torch.cumprod(1 - alpha, 1)
        # The first that leaves less than 1e-4 is the last.
        going = before = torch.cat([torch.ones_like(left[:, :1]), left[:, :-1]], 1) >= 1e-4
        fragile = ((raw * 255 - 1).abs() < FRAGILE) | ((raw / settings.alpha_max - 1).abs() < FRAGILE)
        fragile = ((fragile | ((left / 1e-4 - 1).abs() < FRAGILE)) & before).any(1)
    alpha = torch.where(going, alpha, 0.0)
    left = torch.cumprod(1 - alpha, 1)
    front = torch.cat([torch.ones_like(left[:, :1]), left[:, :-1]], 1)
    last = front[:, -1] * (1 - alpha[:, -1]) if len(order) else torch.ones(view.width * view.height).double()
    background = torch.tensor(settings.background, dtype=torch.float64)
    image = (alpha * front[:, : alpha.shape[1]]) @ colour + last[:, None] * background
    shape = (view.height, view.width)
    return image.reshape(*shape, 3), last.reshape(shape), fragile.reshape(shape)


def compare(
    values: Scene, view: Camera = VIEW, settings: Settings | None = None, *, gradient_error: float = GRADIENT_ERROR
) -> Any:
    """Asserts that image, transmittance and gradients are the dense ones; returns the rendering and its gradients."""
    settings = settings or COLOURED
    exact = {k: torch.from_numpy(v).double().requires_grad_() for k, v in values.items()}
    exact["moved"] = torch.zeros(len(values["opacity"]), 2, dtype=torch.float64, requires_grad=True)
    image, transmittance, fragile = dense(exact, view, settings)
    firm = (~fragile).numpy()
    assert firm.mean() > 0.9
    rendering = rasterise(**values, camera=view, settings=settings)
    assert np.abs(rendering.image - image.detach().numpy())[firm].max(initial=0) < IMAGE_ERROR
    assert np.abs(rendering.transmittance - transmittance.detach().numpy())[firm].max(initial=0) < IMAGE_ERROR
    rng = np.random.default_rng(5)
    grad_image = (rng.normal(size=image.shape) * firm[..., None]).astype(np.float32)
    grad_transmittance = (rng.normal(size=firm.shape) * firm).astype(np.float32)
    gradients = rasterise_backward(rendering, grad_image, grad_transmittance)
    loss = (image * torch.from_numpy(grad_image)).sum() + (transmittance * torch.from_numpy(grad_transmittance)).sum()
    if loss.requires_grad:
        loss.backward()
    for name in NAMES:
        expected = np.zeros(values[name].shape) if exact[name].grad is None else exact[name].grad.numpy()
        actual = getattr(gradients, name)
        assert actual.dtype == np.float32
        assert actual.shape == expected.shape
        assert np.linalg.norm(actual - expected) <= gradient_error * np.linalg.norm(expected) + 1e-6, name
    moved = np.zeros((len(gradients.screen), 2)) if exact["moved"].grad is None else exact["moved"].grad.numpy()
    expected = np.hypot(moved[:, 0] * view.width / 2, moved[:, 1] * view.height / 2)
    assert np.linalg.norm(gradients.screen - expected) <= gradient_error * np.linalg.norm(expected)
    return rendering, gradients


# Arguments of scene() and compare(). Needles are thousands of pixels long and less than one wide: u is up to 1e3, and
# its differences count (measured: 3e-5). Of tiny ones the low-pass alone is seen, and scale's gradient vanishes.
SCENES: dict[str, dict[str, Any]] = {
    **{f"{w} x {h}": {"n": 150, "seed": 1, "view": camera(w, h)} for w, h in ((64, 32), (33, 17), (31, 16), (97, 3))},
    **{f"{w} x {h}": {"n": 150, "seed": 1, "view": camera(w, h)} for w, h in ((50, 37), (1, 1), (1, 40))},
    **{f"many {seed}": {"n": 1500, "seed": seed, "size": 0.06} for seed in range(4)},
    # More than a digit of the sort has values.
    "many in one tile": {"n": 5000, "seed": 30, "size": 0.01, "view": camera(20, 12)},
    "huge": {"n": 40, "seed": 6, "size": 5.0},
    "needles": {"n": 60, "seed": 7, "scale": (10.0, 1e-3, 1e-3), "gradient_error": 2e-4},
    "tiny": {"n": 200, "seed": 8, "size": 1e-6},
    "points": {"n": 200, "seed": 8, "size": 1e-12},
    "no low-pass": {"n": 200, "seed": 9, "settings": Settings(low_pass=0.0)},
    "long quaternions": {"n": 100, "seed": 12, "quaternion": np.exp(np.linspace(-3, 3, 100))[:, None]},
}


@pytest.mark.parametrize("name", SCENES)
def test_scenes(name: str) -> None:
    case = {"view": VIEW, **SCENES[name]}
    view, settings, error = case["view"], case.get("settings"), case.get("gradient_error", GRADIENT_ERROR)
    values = scene(case["n"], case["seed"], view, size=case.get("size", 0.1))
    values["scale"][:] = case.get("scale", values["scale"])
    values["quaternion"] *= np.float32(case.get("quaternion", 1))
    rendering, _ = compare(values, view, settings, gradient_error=error)
    assert rendering.transmittance.min() >= 1e-6


def test_opaque() -> None:
    """Alphas at their cap, pixels finished by the first few Gaussians, and many behind."""
    values = scene(800, 3, size=0.3)
    values["opacity"][:] = 1
    rendering, gradients = compare(values)
    assert (rendering.transmittance < 1e-3).mean() > 0.9
    assert (gradients.colour == 0).all(axis=1).any()


@pytest.mark.parametrize("near", [0.2, 0.01])
def test_behind_and_across_the_near_plane(near: float) -> None:
    values = scene(300, 4, size=0.05, low=-1, high=1)
    rendering, gradients = compare(values, VIEW, Settings(near_plane=near))
    depth = (values["mean"].astype(np.float64) @ VIEW.rotation.T + VIEW.translation)[:, 2]
    hidden = depth <= near
    assert hidden.any()
    assert (rendering.radius[hidden] == 0).all()
    assert (np.abs(depth - near) < 0.05).any()
    for name in (*NAMES, "screen"):
        assert (getattr(gradients, name)[hidden] == 0).all()


def test_partly_and_wholly_outside() -> None:
    """Also where the Jacobian's slope is clamped."""
    values = scene(400, 5, size=0.25, spread=2.0)
    rendering, _ = compare(values)
    p = values["mean"].astype(np.float64) @ VIEW.rotation.T + VIEW.translation
    x = VIEW.fx * p[:, 0] / p[:, 2] + VIEW.cx
    outside = (x < 0) | (x > VIEW.width)
    assert ((rendering.radius > 0) & outside).any()
    assert ((rendering.radius == 0) & outside).any()


def test_without_low_pass_points_are_not_drawn() -> None:
    rendering = rasterise(**scene(200, 9, size=0.0), camera=VIEW, settings=Settings(low_pass=0.0))
    assert (rendering.radius == 0).all()


def test_opacity_zero() -> None:
    values = scene(100, 10)
    values["opacity"][::2] = 0
    rendering, gradients = compare(values)
    assert (rendering.radius[::2] == 0).all()
    assert (gradients.opacity[::2] == 0).all()
    values["opacity"][:] = 0
    rendering, _ = compare(values)
    assert (rendering.transmittance == 1).all()


def test_none_at_all() -> None:
    rendering, gradients = compare(scene(0, 0), VIEW, Settings(background=(0.25, 0.5, 1.0)))
    assert (rendering.image == (0.25, 0.5, 1.0)).all()
    assert (rendering.transmittance == 1).all()
    assert gradients.screen.shape == (0,)


def test_equal_depth_in_the_order_of_indices() -> None:
    view = replace(VIEW, rotation=np.eye(3), translation=np.zeros(3))
    values = scene(60, 11, view, size=0.4)
    values["mean"][:, 2] = 3
    rendering, _ = compare(values, view)
    turned = rasterise(**{k: v[::-1] for k, v in values.items()}, camera=view, settings=COLOURED)
    assert np.abs(turned.image - rendering.image).max() > 0.05


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_not_finite_is_not_drawn(name: str, value: float) -> None:
    values = scene(50, 13)
    without = {k: np.delete(v, 7, axis=0) for k, v in values.items()}
    values[name].reshape(50, -1)[7, 0] = value
    rendering, expected = rasterise(**values, camera=VIEW), rasterise(**without, camera=VIEW)
    assert rendering.radius[7] == 0
    np.testing.assert_array_equal(rendering.image, expected.image)
    gradients = rasterise_backward(rendering, np.ones_like(rendering.image))
    assert all(np.isfinite(getattr(gradients, k)).all() for k in (*NAMES, "screen"))


def test_no_rotation_in_a_quaternion_of_zeros() -> None:
    values = scene(50, 14)
    values["quaternion"][3] = 0
    assert rasterise(**values, camera=VIEW).radius[3] == 0


def test_radius() -> None:
    """The larger half axis of the ellipse in which alpha is at least 1/255."""
    view = Camera("view", 49, 49, 40.0, 40.0, 24.5, 24.5, np.eye(3), np.zeros(3))
    values = scene(1, 0, view)
    values["mean"][:], values["scale"][:], values["opacity"][:] = (0, 0, 4), 0.2, 0.8
    rendering = rasterise(**values, camera=view)
    assert rendering.radius[0] == pytest.approx(np.sqrt(2 * np.log(0.8 * 255) * (2.0**2 + 0.3)), rel=1e-6)
    seen = np.argwhere(rendering.transmittance < 1) - 24
    assert np.hypot(*seen.T).max() == pytest.approx(rendering.radius[0], abs=1)


@given(
    n=st.integers(0, 40),
    width=st.integers(1, 70),
    height=st.integers(1, 40),
    seed=st.integers(0, 2**20),
    size=st.floats(-3, 1),
)
def test_any_shape(n: int, width: int, height: int, seed: int, size: float) -> None:
    view = camera(width, height)
    values = scene(n, seed, view, size=10**size, low=-0.5, high=4)
    rendering = rasterise(**values, camera=view)
    assert rendering.image.shape == (height, width, 3)
    assert rendering.radius.shape == (n,)
    exact = {k: torch.from_numpy(v).double() for k, v in values.items()}
    image, transmittance, fragile = dense(exact, view, Settings())
    firm = ~fragile.numpy()
    # Some of these are needles close to the eye: see test_needles.
    assert np.abs(rendering.image - image.numpy())[firm].max(initial=0) < 10 * IMAGE_ERROR
    assert np.abs(rendering.transmittance - transmittance.numpy())[firm].max(initial=0) < 10 * IMAGE_ERROR
    gradients = rasterise_backward(rendering, np.ones_like(rendering.image))
    for name in NAMES:
        assert getattr(gradients, name).shape == values[name].shape
        assert np.isfinite(getattr(gradients, name)).all()
        assert (getattr(gradients, name)[rendering.radius == 0] == 0).all()


def digest() -> str:
    """A hash of every result for a scene of many tiles."""
    view = camera(400, 300)
    values = scene(20000, 40, replace(view, width=400, height=300), size=0.03)
    rendering = rasterise(**values, camera=view)
    rng = np.random.default_rng(0)
    gradients = rasterise_backward(
        rendering, rng.normal(size=rendering.image.shape), rng.normal(size=rendering.transmittance.shape)
    )
    target = torch.from_numpy(rng.uniform(size=rendering.image.shape).astype(np.float32))
    image = torch.from_numpy(rendering.image).requires_grad_()
    value = 1 - Photometric.apply(image, target, 1.0)
    value.backward()
    arrays = [rendering.image, rendering.transmittance, rendering.radius, *vars(gradients).values()]
    arrays += [value.detach().numpy(), image.grad.numpy()]
    return hashlib.sha256(b"".join(np.ascontiguousarray(v).tobytes() for v in arrays)).hexdigest()


@pytest.mark.slow
def test_same_bits_whatever_the_number_of_threads() -> None:
    program = f"""
import sys, numba
sys.path.insert(0, {str(HERE)!r})
from {Path(__file__).stem} import digest
for threads in (1, 2, 3):
    numba.set_num_threads(threads)
    print(digest())
"""
    environment = {**os.environ, "NUMBA_NUM_THREADS": "3"}
    done = subprocess.run([sys.executable, "-c", program], env=environment, check=True, capture_output=True, text=True)
    digests = done.stdout.split()
    assert len(digests) == 3
    assert len(set(digests)) == 1


def test_autograd() -> None:
    values = scene(100, 50)
    inputs = [torch.from_numpy(values[k]).double().requires_grad_() for k in NAMES]
    screen = torch.zeros(100, requires_grad=True)
    expected = rasterise(**values, camera=VIEW)
    for calls in (1, 2):
        image, transmittance, radius = Rasterise.apply(VIEW, None, screen, *inputs)
        np.testing.assert_array_equal(image.detach().numpy(), expected.image)
        np.testing.assert_array_equal(radius.numpy(), expected.radius)
        (image.square().sum() + transmittance.sum()).backward()
        gradients = rasterise_backward(expected, 2 * expected.image, np.ones_like(expected.transmittance))
        for name, value in zip(NAMES, inputs, strict=True):
            assert value.grad.dtype == torch.float64
            wanted = calls * getattr(gradients, name).astype(np.float64)
            np.testing.assert_allclose(value.grad.numpy(), wanted, rtol=1e-12)
        np.testing.assert_allclose(screen.grad, calls * gradients.screen, rtol=1e-6)


def test_autograd_sees_changes_in_place() -> None:
    inputs = [torch.from_numpy(v).requires_grad_() for v in scene(10, 51).values()]
    image, transmittance, _ = Rasterise.apply(VIEW, None, None, *inputs)
    with torch.no_grad():
        transmittance.zero_()
        inputs[0].add_(1)
    with pytest.raises(RuntimeError, match="modified by an inplace operation"):
        image.sum().backward()


def drawn_with_gradients(draw: Any, inputs: list[torch.Tensor]) -> tuple[torch.Tensor, ...]:
    """Image, transmittance, radius, and the gradients of a loss by the five inputs and the screen, on the CPU."""
    inputs = [v.detach().requires_grad_() for v in inputs]
    screen = torch.zeros(len(inputs[0]), device=inputs[0].device, requires_grad=True)
    image, transmittance, radius = draw(tuple(inputs), VIEW, COLOURED, screen)
    (image.square().sum() + transmittance.sum()).backward()
    return tuple(v.detach().cpu() for v in (image, transmittance, radius, *(v.grad for v in (*inputs, screen))))


def rasterised(gaussians: tuple[torch.Tensor, ...], *rest: Any) -> Any:
    return Rasterise.apply(*rest, *gaussians)


def test_draw_on_the_cpu() -> None:
    inputs = [torch.from_numpy(v) for v in scene(100, 52).values()]
    for drawn, expected in zip(*(drawn_with_gradients(d, inputs) for d in (splat.draw, rasterised)), strict=True):
        assert torch.equal(drawn, expected)
    there = tuple(v.to("meta") for v in inputs)
    for some, screen in (((*inputs[:4], there[4]), None), (there, None), (inputs, torch.zeros(100, device="meta"))):
        with pytest.raises(ValueError, match="meta"):
            splat.draw(some, VIEW, None, screen)


def test_what_gsplat_is_given(monkeypatch: pytest.MonkeyPatch) -> None:
    """The dense images of this file stand in its place: matrices, units, the screen's gradient added over calls."""

    def rasterization(
        *inputs: Any, near_plane: float, eps2d: float, packed: bool, backgrounds: torch.Tensor, rasterize_mode: str
    ) -> Any:
        *values, view, lens, width, height = inputs
        assert (packed, rasterize_mode, view.shape, lens.shape) == (False, "classic", (1, 4, 4), (1, 3, 3))
        assert view[0, 3].tolist() == [0, 0, 0, 1]
        matrix = lens[0].double().numpy()
        place = torch.zeros(1, len(values[0]), 2, dtype=torch.float64, requires_grad=True)
        pose = (v.double().numpy() for v in (view[0, :3, :3], view[0, :3, 3]))
        seen_from = Camera("", width, height, *matrix[[0, 1, 0, 1], [0, 1, 2, 2]], *pose)
        settings = Settings(eps2d, near_plane, background=tuple(backgrounds[0].tolist()))
        named = {name: value.double() for name, value in zip(NAMES, values, strict=True)}
        image, transmittance, _ = dense({**named, "moved": place[0]}, seen_from, settings)
        radii = torch.arange(2 * len(values[0])).reshape(1, -1, 2)
        return image.float()[None], 1 - transmittance.float()[None, ..., None], {"means2d": place, "radii": radii}

    monkeypatch.setitem(sys.modules, "gsplat", SimpleNamespace(rasterization=rasterization))
    inputs = [torch.from_numpy(v) for v in scene(60, 53).values()]
    drawn, expected = (drawn_with_gradients(draw, inputs) for draw in (device.draw_on_gpu, rasterised))
    assert drawn[2].tolist() == list(range(1, 120, 2))
    for a, b in zip(drawn[:2] + drawn[3:], expected[:2] + expected[3:], strict=True):
        assert (a - b).norm() < 1e-4 * b.norm()
    screen = torch.zeros(60, requires_grad=True)
    for calls in (1, 2):
        image, transmittance, _ = device.draw_on_gpu(inputs, VIEW, COLOURED, screen)
        (image.square().sum() + transmittance.sum()).backward()
        assert (screen.grad - calls * expected[-1]).norm() < 1e-4 * calls * expected[-1].norm()


@pytest.mark.skipif(not torch.cuda.is_available(), reason="no GPU")
def test_draw_on_the_gpu() -> None:
    """Opacities that no cap reaches. Pixels and gradients differ where an alpha by 1/255 falls on the other side."""
    pytest.importorskip("gsplat", reason="the extra cuda")
    values = scene(500, 54)
    values["opacity"] *= 0.95
    inputs = [torch.from_numpy(v) for v in values.values()]
    drawn, expected = (drawn_with_gradients(splat.draw, given) for given in ([v.cuda() for v in inputs], inputs))
    assert (drawn[0] - expected[0]).abs().mean() < 1e-4
    assert (drawn[1] - expected[1]).abs().mean() < 1e-4
    assert ((drawn[2] > 0) | (expected[2] == 0)).all()
    for a, b in zip(drawn[3:], expected[3:], strict=True):
        assert (a - b).norm() < 1e-2 * b.norm()


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *(("low_pass", -1.0), ("low_pass", np.inf), ("near_plane", 0.0), ("near_plane", np.nan)),
        *(("alpha_max", 1.01), ("background", (0.0,))),
    ],
)
def test_settings_errors(name: str, value: Any) -> None:
    with pytest.raises(ValueError, match=r"required|not 3"):
        Settings(**{name: value})


@pytest.mark.parametrize("name", NAMES)
def test_shape_errors(name: str) -> None:
    values = scene(5, 0)
    values[name] = values[name][:4] if name != "opacity" else values[name][:, None]
    with pytest.raises(ValueError, match="shape"):
        rasterise(**values, camera=VIEW)
    rendering = rasterise(**scene(5, 0), camera=VIEW)
    with pytest.raises(ValueError, match="shapes"):
        rasterise_backward(rendering, rendering.image[1:])


def dense_ssim(x: torch.Tensor, y: torch.Tensor) -> torch.Tensor:
    """3DGS's own form, in float64: a two-dimensional window, zeros around the image."""
    weights = torch.exp(-((torch.arange(11) - 5.0).double() ** 2) / (2 * 1.5**2))
    weights = weights / weights.sum()
    channels = x.shape[2]
    kernel = torch.outer(weights, weights).expand(channels, 1, 11, 11)

    def mean(v: torch.Tensor) -> torch.Tensor:
        return torch.nn.functional.conv2d(v.permute(2, 0, 1)[None], kernel, padding=5, groups=channels)

    m_x, m_y = mean(x), mean(y)
    v_x, v_y, v_xy = mean(x * x) - m_x * m_x, mean(y * y) - m_y * m_y, mean(x * y) - m_x * m_y
    return (((2 * m_x * m_y + 1e-4) * (2 * v_xy + 9e-4)) / ((m_x**2 + m_y**2 + 1e-4) * (v_x + v_y + 9e-4))).mean()


@given(
    width=st.integers(1, 40),
    height=st.integers(1, 30),
    channels=st.integers(1, 4),
    seed=st.integers(0, 2**20),
    noise=st.floats(0, 1),
)
def test_ssim(width: int, height: int, channels: int, seed: int, noise: float) -> None:
    """Float32 variances, differences of squares of size one, are off by some 1e-7: 1e-4 of C2 where all is flat."""
    rng = np.random.default_rng(seed)
    x = rng.uniform(size=(height, width, channels)).astype(np.float32)
    y = ((1 - noise) * x + noise * rng.uniform(size=x.shape)).astype(np.float32)
    image, exact = torch.from_numpy(x).requires_grad_(), torch.from_numpy(x).double().requires_grad_()
    value = 1 - Photometric.apply(image, torch.from_numpy(y), 1.0)
    expected = dense_ssim(exact, torch.from_numpy(y).double())
    (3 * value).backward()
    (3 * expected).backward()
    assert float(value.detach()) == pytest.approx(float(expected.detach()), abs=2e-6)
    assert (image.grad - exact.grad).norm() <= 2e-4 * exact.grad.norm() + 1e-5


def test_ssim_of_equals() -> None:
    """Bright and flat is the worst case of the variances' rounding."""
    for image, most in ((torch.rand(20, 30, 3), 1e-6), (torch.ones(20, 30, 3), 1e-3)):
        assert abs(float(Photometric.apply(image, image, 1.0))) < most


@pytest.mark.parametrize("shapes", [((4, 4, 3), (4, 5, 3)), ((4, 4), (4, 4)), ((0, 4, 3), (0, 4, 3))])
def test_ssim_errors(shapes: tuple[tuple[int, ...], tuple[int, ...]]) -> None:
    with pytest.raises(ValueError, match="must have the same"):
        Photometric.apply(torch.zeros(shapes[0]), torch.zeros(shapes[1]), 1.0)
