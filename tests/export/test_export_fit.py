"""One set of Gaussians for all views: exact for a scene that does not depend on the view, else near."""

import math
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from statistics import fmean

import numpy as np
import pytest

for package in ("numba", "PIL", "scipy"):
    pytest.importorskip(package, reason="exporting needs the packages of the extra render")

from random_scenes import random_scene  # noqa: E402

from refcodec.bitstream.cameras import NamedCamera, cameras, rotation_matrix  # noqa: E402
from refcodec.bitstream.codec import parse  # noqa: E402
from refcodec.bitstream.dimensions import RENDERING  # noqa: E402
from refcodec.export.fit import agreement, fit  # noqa: E402
from refcodec.export.views import FEW, SIDE, views_of  # noqa: E402
from refcodec.formats.packing import opacities  # noqa: E402
from refcodec.formats.splats import Splats  # noqa: E402
from refcodec.rendering.camera import Camera, looking, named_camera  # noqa: E402
from refcodec.rendering.gaussians import gaussians  # noqa: E402
from refcodec.rendering.rasterise import draw, settings_of  # noqa: E402
from refcodec.rendering.view import View, own_camera  # noqa: E402

ROOT = Path(__file__).resolve().parents[2]
TRAINED = ROOT / "vectors" / "valid" / "trained-caliterra.c3gs"


def quiet(stage: str, done: int, total: int) -> None:
    """Progress that nobody sees."""


def trained() -> View:
    return View(parse(TRAINED.read_bytes()).scene)


def around(view: View, count: int, side: int = 64) -> list[Camera]:
    """A few small views."""
    cameras = views_of(view, [view.camera]).fit
    return [camera.resized(side, 3 * side // 4) for camera in cameras[:: len(cameras) // count][:count]]


def unmoved() -> View:
    """A scene whose networks do not look at the view, with Gaussians that can be seen."""
    view = trained()
    for name in RENDERING:
        (weight, bias), *others = view.networks[name]
        weight = weight.copy()
        weight[:, -4:] = 0
        view.networks[name] = [(weight, bias), *others]
    return view


@pytest.mark.parametrize(("degree", "iterations"), [(0, 0), (2, 0), (1, 3)])
def test_a_scene_that_is_the_same_from_everywhere(degree: int, iterations: int) -> None:
    """Its Gaussians come back as they are, and the images too, with colours that do not turn."""
    view = unmoved()
    views = around(view, 8)
    fitted = fit(view, views, degree, iterations, quiet)
    splats = fitted.splats
    drawn = gaussians(view.values, view.masks, view.networks, views[0], view.info.distance_unit)
    # Those that are seen are among those of the scene, in their order.
    where = {tuple(mean): i for i, mean in enumerate(drawn.mean)}
    at = [where[tuple(mean)] for mean in splats.mean]
    # An offset of zero may come twice.
    _, first, times = np.unique(drawn.mean, axis=0, return_index=True, return_counts=True)
    alone = np.isin(at, first[times == 1])
    assert alone.sum() > 0.8 * len(at)
    assert (np.diff(np.array(at)[alone]) > 0).all()
    assert 0.7 * fitted.of < len(at) < fitted.of
    np.testing.assert_allclose(opacities(splats)[alone], drawn.opacity[at][alone], atol=1e-5)
    spread = rotation_matrix(drawn.quaternion[at].astype(np.float64)) * drawn.lengths[at][:, None, :]
    mine = rotation_matrix(splats.unit_quaternions()) * np.exp(splats.scale)[:, None, :]
    wanted = spread @ spread.transpose(0, 2, 1)
    error = np.abs(mine @ mine.transpose(0, 2, 1) - wanted).max(axis=(1, 2))
    assert (error <= 1e-4 * np.abs(wanted).max(axis=(1, 2)))[alone].all()
    if not iterations:
        colour = splats.base * 0.28209479 + 0.5
        np.testing.assert_allclose(colour[alone], drawn.colour[at][alone], atol=1e-4)
        assert np.abs(splats.rest).max(initial=0) < 1e-3
    # What no view sees by a tenth of a pixel is not missed.
    assert agreement(view, splats, views, quiet) > 50


def test_the_regression_finds_a_colour_that_turns() -> None:
    """A colour that is nearly linear in the direction is found by degree 1, and not by degree 0."""
    view = unmoved()
    # A large bias keeps the unit active, so that colours depend on the x of the direction without a kink.
    weight, bias = (array.copy() for array in view.networks["colour"][0])
    weight[0], bias[0], weight[0, -4] = 0, 2, 1
    second, constant = (array.copy() for array in view.networks["colour"][1])
    second[:] = 0
    second[:, 0] = 0.3
    view.networks["colour"] = [(weight, bias), (second, constant - 0.6)]
    views = around(view, 8)
    flat, linear = (agreement(view, fit(view, views, degree, 0, quiet).splats, views, quiet) for degree in (0, 1))
    assert flat < 40
    assert linear > 47


@pytest.mark.parametrize("low_pass", [0.0, 0.1, 1.0])
def test_the_filter_is_that_of_viewers(low_pass: float) -> None:
    """Whatever the filter of a scene: the fit and its PSNR are for a viewer with 0.3 square pixels."""
    view = unmoved()
    view.info = replace(view.info, low_pass=low_pass)
    views = around(view, 4)
    before, after = (fit(view, views, 0, iterations, quiet).splats for iterations in (0, 4))

    def seen(splats: Splats) -> float:
        viewer = replace(settings_of(view.info), low_pass=0.3)
        images = ((draw(splats, camera, viewer).image, view.draw(camera)) for camera in views)
        return fmean(-10 * math.log10(float(((a.clip(0, 1) - b.clip(0, 1)) ** 2).mean())) for a, b in images)

    assert agreement(view, after, views, quiet) == pytest.approx(seen(after), abs=0.01)
    assert seen(after) > seen(before) + 0.2


@pytest.mark.slow
def test_more_harmonics_are_nearer() -> None:
    """The images of a trained scene from the views of the fit, for each degree, without and with least squares."""
    view = trained()
    views = around(view, 10, 48)
    alone, together = (
        [agreement(view, fit(view, views, degree, iterations, quiet).splats, views, quiet) for degree in range(4)]
        for iterations in (0, 5)
    )
    assert together == sorted(together)
    assert all(more > less + 0.1 for less, more in pairwise(together))
    assert all(more > less for less, more in zip(alone, together, strict=True))
    assert alone[1] > alone[0] + 2
    assert together[3] > 38


def test_what_nobody_sees_goes() -> None:
    view = trained()
    camera = around(view, 1)[0]
    front = fit(view, [camera], 0, 0, quiet)
    assert len(front.splats.mean) < fit(view, around(view, 8), 0, 0, quiet).splats.mean.shape[0]
    turn = np.diag([-1.0, 1.0, -1.0])
    away = replace(camera, rotation=turn @ camera.rotation, translation=turn @ camera.translation)
    with pytest.raises(ValueError, match="no camera sees"):
        fit(view, [away], 0, 0, quiet)
    with pytest.raises(ValueError, match="no camera sees"):
        fit(View(random_scene(72, 0)), [camera], 0, 0, quiet)


def test_groups_do_not_matter(monkeypatch: pytest.MonkeyPatch) -> None:
    view = trained()
    views = around(view, 4)
    whole = fit(view, views, 1, 0, quiet).splats
    monkeypatch.setattr("refcodec.export.fit._GROUP", 100)
    parts = fit(view, views, 1, 0, quiet).splats
    for name in ("mean", "base", "rest", "opacity", "scale"):
        np.testing.assert_allclose(getattr(parts, name), getattr(whole, name), atol=1e-4)


def test_progress_is_told() -> None:
    view = trained()
    calls: dict[str, list[tuple[int, int]]] = {}
    fit(view, around(view, 3), 0, 2, lambda stage, done, total: calls.setdefault(stage, []).append((done, total)))
    assert list(calls) == ["views", "regression", "images"]
    for steps in calls.values():
        assert [done for done, _ in steps] == sorted(done for done, _ in steps)
        assert steps[-1][0] == steps[-1][1]


# --- views ------------------------------------------------------------------------------------------------------------


def test_views_around_a_scene() -> None:
    """They are apart, look at the middle, and are as far as the file's own camera if that is near the scene."""
    scene = parse(TRAINED.read_bytes()).scene
    view = View(scene)
    stated = cameras(scene.ancillary)
    views = views_of(view, stated)
    assert (len(views.fit), len(views.test)) == (64 + len(stated), 8)
    middle, radius = view.extent
    centres = np.array([camera.centre for camera in (*views.fit[1:], *views.test)])
    distances = np.linalg.norm(centres - middle, axis=1)
    away = float(np.linalg.norm(own_camera(view.camera).centre - middle))
    np.testing.assert_allclose(distances, np.clip(away, 1.2 * radius, 3 * radius))
    apart = np.linalg.norm(centres[:, None] - centres, axis=2) + 1e9 * np.eye(len(centres))
    assert apart.min() > 0.1 * distances[0]
    for camera in views.test:
        x, y, z = camera.rotation @ middle + camera.translation
        assert abs(x) + abs(y) < 1e-9 * z
    assert max(camera.width for camera in views.fit) <= SIDE


def test_cameras_of_a_file() -> None:
    view = trained()
    stated = [NamedCamera(f"{i}", 4000 + i, 1000) for i in range(FEW)]
    views = views_of(view, stated)
    assert len(views.fit) == FEW
    assert {(camera.width, camera.height) for camera in views.fit} <= {(SIDE, 99), (SIDE, 100)}
    assert len(views_of(view, stated[1:]).fit) == 64 + FEW - 1
    assert len(views_of(view, []).fit) == 64


def test_views_between_cameras() -> None:
    """Half way between neighbours, once each, with a level horizon if theirs is."""
    ring = []
    for degrees in (0, 10, 40, 52, 100, 115, 170, 190, 220):
        turn = np.radians(degrees)
        away = np.array([np.cos(turn), np.sin(turn), 0.5])
        rotation = looking(-away, np.array([0.0, 0.0, 1.0]))
        ring.append(Camera(f"{degrees}", 400, 300, 300.0, 300.0, 200.0, 150.0, rotation, -rotation @ (4 * away)))
    views = views_of(trained(), [named_camera(camera, camera.name) for camera in ring])
    assert len(views.fit) == 9
    turns = sorted(np.degrees(np.arctan2(c.centre[1], c.centre[0])) % 360 for c in views.test)
    np.testing.assert_allclose(turns, [5, 46, 107.5, 180, 205], atol=1e-3)
    for camera in views.test:
        assert np.linalg.det(camera.rotation) == pytest.approx(1)
        assert abs(camera.rotation[0, 2]) < 1e-6
        # The middle is in the middle of the image.
        x, y, z = camera.translation
        assert abs(x) + abs(y) < 0.03 * z
