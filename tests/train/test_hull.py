"""Starts without points: within the visual hull of transparent photographs, behind given points, and with few."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from refcodec.photographs.photographs import PhotographSet
from refcodec.train import start
from refcodec.train.behind import CAMERAS, points_behind
from refcodec.train.hull import carved
from refcodec.train.settings import TrainSettings
from refcodec.train.settings_file import varied
from refcodec.train.stages.growth import Growth
from refcodec.train.stages.learning import Learning
from refcodec.train.start import asked_for, choose_voxel, first_anchors
from refcodec.train.trainer import Trainer

Ball = Callable[[str, str], PhotographSet]
RADIUS, BALL = 0.5, (200, 60, 20)


def test_points_are_where_something_is(write_ball: Ball) -> None:
    photographs = write_ball("ball", "RGBA")
    points, colours = carved(photographs, 2000, 0)
    away = np.linalg.norm(points - [0.2, 0, 0], axis=1)
    assert len(points) >= 2000
    # A pixel is an eightieth of the distance; the hull of some views is a little more than the ball.
    assert away.max() < 1.3 * RADIUS
    # The hull holds all of the ball.
    assert (away > 0.9 * RADIUS).any()
    assert np.linalg.norm(points.mean(axis=0) - [0.2, 0, 0]) < 0.05
    # The background is white: no colour is mixed with it but at the edge.
    inner = colours[away < 0.6 * RADIUS]
    assert (inner == BALL).all()
    again, _ = carved(photographs, 2000, 0)
    assert np.array_equal(points, again)
    assert not np.array_equal(points[:100], carved(photographs, 2000, 1)[0][:100])


def test_photographs_that_are_not_transparent_show_nothing_empty(write_ball: Ball) -> None:
    photographs = write_ball("ball", "RGB")
    points, colours = carved(photographs, 2000, 0)
    assert np.array_equal(points, photographs.points)
    assert np.array_equal(colours, photographs.colours)


def test_first_anchors_of_random_points(write_ball: Ball) -> None:
    """A cube of random points had anchors all over it, of which five in a hundred were on the ball."""
    settings = TrainSettings()
    for mode, least in (("RGBA", 0.95), ("RGB", 0.0)):
        photographs = write_ball(mode, mode)
        anchors = first_anchors(photographs, settings)
        places = anchors.units.origin + anchors.lattice * (anchors.units.cell * anchors.units.length)
        inside = (np.linalg.norm(places - [0.2, 0, 0], axis=1) < 1.3 * RADIUS).mean()
        assert inside >= least
        assert 0.5 * settings.start.least < len(anchors.lattice) < 1.5 * settings.start.least
        edges = np.diff(np.unique(anchors.lattice[:, 0]))
        assert (edges % settings.start.random_cells == 0).all()
        # The anchors of a cube of points must find the scene, and learn faster. Those of a hull grow more easily.
        trainer = Trainer(photographs, settings)
        (learning,), (growth,) = trainer.of(Learning), trainer.of(Growth)
        assert growth.threshold == settings.growth.gradient * (settings.growth.hull if mode == "RGBA" else 1.0)
        faster = {name: decay.start / getattr(settings.learning, name).start for name, decay in learning.decays.items()}
        factor = 1.0 if mode == "RGBA" else settings.learning.cube
        assert faster == {"features": factor, "offsets": factor, "scalings": factor, "masks": 1.0}


@pytest.mark.parametrize(
    ("changes", "asked", "points"),
    [
        ({}, 5000, 20000),
        # 21 photographs of 48 x 48 pixels, and seven pixels for an anchor.
        ({"start.pixels": 7}, 6912, 27648),
        ({"start.pixels": 7, "growth.most": 6000}, 6000, 24000),
        ({"start.pixels": 7, "start.anchors": 700}, 700, 20000),
        ({"start.least": 0}, 0, 20000),
    ],
)
def test_more_pixels_ask_for_more_random_points(
    write_ball: Ball, monkeypatch: pytest.MonkeyPatch, changes: dict[str, int], asked: int, points: int
) -> None:
    """5,000 anchors were too few for photographs of 400 pixels: 37.5 dB, where 20,000 made 38.8."""
    photographs, settings = write_ball("ball", "RGBA"), varied(TrainSettings(), changes)
    wanted: list[int] = []

    def noted(photographs: PhotographSet, count: int, seed: int) -> tuple[NDArray[Any], NDArray[Any]]:
        wanted.append(count)
        return carved(photographs, count, seed)

    monkeypatch.setattr(start, "carved", noted)
    assert asked_for(photographs, settings) == asked
    anchors = first_anchors(photographs, settings)
    assert wanted == [points]
    assert 0.5 * (asked or points) < len(anchors.lattice) < 1.5 * (asked or points)
    # Points that are given cannot be as many as are wanted.
    given = asked_for(replace(photographs, random=False), settings)
    assert given == (settings.start.anchors or settings.start.least)


def test_points_behind_given_ones_are_where_photographs_show_none(write_ball: Ball) -> None:
    """The background of a statue had no points, and was a mist: 22.3 dB, where points behind the statue made 23.9."""
    ball = np.random.default_rng(0).normal(size=(3000, 3))
    ball = [0.2, 0, 0] + RADIUS * ball / np.linalg.norm(ball, axis=1, keepdims=True)
    photographs = replace(write_ball("ball", "RGB"), points=ball, colours=np.full(ball.shape, BALL), random=False)
    points, colours = points_behind(photographs, 10.0, 10_000, 0)
    assert len(points) > 1000
    assert (colours == photographs.train[0].image[0, 0]).all()
    # The ball is 3.5 to 4.5 away from most cameras, in the middle of their images.
    away = np.linalg.norm(points - [0.2, 0, 0], axis=1)
    assert away.min() > RADIUS
    assert np.quantile(away, [0.5, 0.99]) == pytest.approx([4.5, 40], rel=0.3)
    some = replace(photographs, train=photographs.train[: CAMERAS - 1])
    assert not len(points_behind(some, 10.0, 10_000, 0)[0])
    excluded = [replace(p, load_mask=lambda: np.zeros((48, 48), bool)) for p in photographs.train]
    assert not len(points_behind(replace(photographs, train=tuple(excluded)), 10.0, 10_000, 0)[0])
    # Too few points to know a depth, and none in any view.
    for given in (ball[:3], ball + 1000):
        assert not len(points_behind(replace(photographs, points=given), 10.0, 10_000, 0)[0])
    few, _ = points_behind(photographs, 10.0, 100, 0)
    assert len(few) == 100
    assert {tuple(point) for point in few} < {tuple(point) for point in points}
    for changes, begin in (({}, True), ({"opaque": False}, False), ({"random": True}, False)):
        anchors = first_anchors(replace(photographs, **changes), TrainSettings())
        places = anchors.units.origin + anchors.lattice * (anchors.units.cell * anchors.units.length)
        assert (np.linalg.norm(places, axis=1) > 10).any() == begin


@pytest.mark.parametrize("count", [2, 40, 3000])
def test_few_points_have_voxels_as_far_apart_as_they_are(count: int) -> None:
    """Fewer points than anchors that are wanted got voxels of a hundred-thousandth of the scene.

    The lattice did not reach its ends then, and nothing grew.
    """
    points = np.random.default_rng(0).uniform(-1, 1, (count, 3))
    assert choose_voxel(points, 5000) > 0.02
