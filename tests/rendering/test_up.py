"""The up direction of a scene (refcodec.rendering.camera): camera rigs with a known up direction."""

import json
import shutil
import subprocess
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
from random_scenes import random_scene
from scipy.spatial.transform import Rotation

from refcodec.bitstream.cameras import CAMERAS, cameras, with_cameras
from refcodec.bitstream.codec import emit, parse
from refcodec.bitstream.reconstruction import digest
from refcodec.cli.main import main
from refcodec.rendering.camera import (
    Camera,
    axis_direction,
    default_camera,
    level_up,
    looking,
    nearest_axis,
    scene_up,
    spread_cameras,
    up_axis,
    up_direction,
)
from refcodec.rendering.view import View

Rig = tuple[list[Camera], np.ndarray]
Z = np.array([0.0, 0.0, 1.0])


def camera(centre: Sequence[float], direction: Sequence[float], top: np.ndarray = Z, roll: float = 0.0) -> Camera:
    """top: what is up in the image. roll: degrees by which the camera is turned about its axis."""
    turn = np.radians(roll)
    rolled = np.array([[np.cos(turn), np.sin(turn), 0], [-np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
    rotation = rolled @ looking(np.array(direction, np.float64), top)
    return Camera("", 40, 30, 40.0, 40.0, 20.0, 15.0, rotation, -rotation @ np.array(centre, np.float64))


def at_middle(centres: np.ndarray, rolls: np.ndarray | None = None) -> list[Camera]:
    return [camera(c, -c, roll=0.0 if rolls is None else rolls[i]) for i, c in enumerate(centres)]


def ground(size: float = 5.0, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-1, 1, (300, 3)) * [size, size, 0.03 * size]


def thing() -> np.ndarray:
    return np.random.default_rng(1).normal(size=(300, 3))


def grid(headings: Callable[[int], float]) -> Rig:
    """A flight at a height of 3 that looks straight down, but for the wind. headings: degrees, of each line."""
    wind = np.random.default_rng(2).normal(0, 0.03, (5, 8, 2))
    cameras = []
    for line in range(5):
        turn = np.radians(headings(line))
        top = np.array([np.cos(turn), np.sin(turn), 0.0])
        cameras += [camera([i - 3.5, 2 * line - 4, 3], [*wind[line, i], -1], top) for i in range(8)]
    return cameras, ground()


def ring(elevation: float, begin: float = 0.0, end: float = 360.0, count: int = 24) -> np.ndarray:
    """Centres on a circle around the middle, float64 [count, 3]. All angles are degrees."""
    turn, height = np.radians(np.linspace(begin, end, count, endpoint=False)), np.radians(elevation)
    flat = np.cos(height)
    return 4 * np.stack([flat * np.cos(turn), flat * np.sin(turn), np.full(count, np.sin(height))], axis=1)


def ahead(spread: float, points: np.ndarray) -> Rig:
    """Cameras on a wall that all look along y at points behind it. spread: of their places, world units."""
    places = np.random.default_rng(3).uniform(-spread, spread, (20, 2))
    return [camera([x, -6, z], [0, 1, 0]) for x, z in places], points


def walk() -> Rig:
    """Along a painted wall: flat, seen from the front, by somebody who does not climb."""
    wall = ground()[:, [0, 2, 1]]
    return [camera([x, -3, 0.05 * (i % 3)], [0, 1, 0]) for i, x in enumerate(np.linspace(-5, 5, 20))], wall


ROLLS = np.random.default_rng(4).normal(0, 4, 24)
RIGS: dict[str, Rig] = {
    "nadir, lines both ways": grid(lambda line: 180.0 * (line % 2)),
    "nadir, lines one way": grid(lambda line: 0.0),
    "nadir, across too": grid(lambda line: 90.0 * line),
    "oblique ring": (at_middle(ring(45), ROLLS), ground()),
    "steep ring": (at_middle(ring(80)), ground()),
    "a quarter of a ring": (at_middle(ring(45, 0, 90), ROLLS), ground()),
    "turntable": (at_middle(ring(20)), thing()),
    "turntable from below": (at_middle(ring(-40)), thing()),
    "upper half of a sphere": (at_middle(np.concatenate([ring(e, count=8) for e in (5, 30, 60, 85)])), thing()),
    "every second one on its side": (at_middle(ring(10), np.where(np.arange(24) % 2, 90.0, 0.0)), thing()),
    "ahead": ahead(0.5, thing()),
    "ahead at a wall": ahead(0.5, ground()[:, [0, 2, 1]]),
    "along a wall": walk(),
    "one": ([camera([0, -4, 0], [0, 1, 0])], thing()),
    "one that looks down a little": ([camera([0, -4, 2], [0, 1, -0.5])], ground()),
    "all alike": ([camera([0, -4, 2], [0, 1, -0.5])] * 20, thing()),
    "no points": (at_middle(ring(30)), np.zeros((0, 3))),
}
TILTED = ("one that looks down a little", "all alike")


def turned(rig: Rig, rotation: np.ndarray) -> Rig:
    """The same rig in a world that is turned. rotation: from its world to the other one."""
    cameras = [
        Camera(c.name, c.width, c.height, c.fx, c.fy, c.cx, c.cy, c.rotation @ rotation.T, c.translation)
        for c in rig[0]
    ]
    return cameras, rig[1] @ rotation.T


@pytest.mark.parametrize("up", range(6))
@pytest.mark.parametrize("name", RIGS)
def test_up_is_found(name: str, up: int) -> None:
    """In a world that is turned so that any axis is up, and askew by 15 degrees."""
    target = axis_direction(up)
    askew = looking(np.array([0.2, 0.15, 1.0]), np.array([0.0, 1.0, 0.1]))
    other = looking(target, np.roll(target, 1))  # its third row is what is up
    rotation = askew @ other.T
    cameras, points = turned(RIGS[name], rotation)
    direction = up_direction(cameras, points)
    assert np.linalg.norm(direction) == pytest.approx(1)
    away = np.degrees(np.arccos(min(direction @ rotation @ Z, 1)))
    if name in TILTED:
        # Nothing says how far they look down. They do so by 27 degrees.
        assert away < 30
    else:
        assert away < 6
        assert up_axis(cameras, points) == nearest_axis(rotation @ Z)


def test_stated_cameras_are_spread() -> None:
    """Few of many, the first one first, each far from those before; their own up is that of all."""
    cameras, _ = RIGS["upper half of a sphere"]
    stated = spread_cameras(cameras, 9)
    assert [c.name for c in stated] == ["default", *map(str, range(1, 9))]
    assert stated[0].matrix() == pytest.approx(cameras[0].rotation, abs=1e-6)
    assert [c.name for c in spread_cameras(cameras, 4)] == [c.name for c in stated[:4]]
    centres = np.array([default_camera(c).centre for c in stated])
    apart = np.linalg.norm(centres[:, None] - centres, axis=2) + 9 * np.eye(9)
    assert apart.min() > 2
    assert scene_up(4, stated) == pytest.approx(Z, abs=1e-6)
    # up_axis decides: a file may have been given another one. It decides alone where there is one camera.
    assert np.array_equal(scene_up(1, stated), axis_direction(1))
    assert np.array_equal(scene_up(4, stated[:1]), Z)
    assert (spread_cameras([], 16), spread_cameras(cameras, 0)) == ([], [])
    # Of cameras in one place one is enough.
    assert len(spread_cameras(cameras[:1] * 20, 16)) == 1


def test_the_horizon_is_level(capsys: pytest.CaptureFixture[str]) -> None:
    """Where up is no axis, an orbit takes it from the cameras."""
    cameras, _ = turned(RIGS["turntable"], looking(np.array([0.2, 0.15, 1.0]), np.array([0.0, 1.0, 0.1])))
    stated = spread_cameras(cameras, 16)
    up = level_up(cameras)
    assert up is not None
    scene = random_scene(71, 50)
    section = with_cameras(scene.ancillary, stated)
    view = View(replace(scene, ancillary=section, render=replace(scene.render, up_axis=nearest_axis(up))))
    for made in view.orbit(5):
        assert abs(made.rotation[0] @ up) < 1e-5
        assert made.rotation[1] @ up < 0


@pytest.mark.skipif(shutil.which("node") is None, reason="node is not there")
def test_the_viewer_finds_the_same() -> None:
    """For every rig, and for every axis that a file may say."""
    askew = looking(np.array([0.2, 0.15, 1.0]), np.array([0.0, 1.0, 0.1]))
    asked, wanted = [], []
    for rig in RIGS.values():
        stated = spread_cameras(turned(rig, askew)[0], 16)
        for axis in range(6):
            asked.append([{"up_axis": axis}, [asdict(camera) for camera in stated]])
            wanted.append(scene_up(axis, stated))
    asked.append([{"up_axis": 3}, []])
    wanted.append(scene_up(3, []))
    module = (Path(__file__).resolve().parents[2] / "refcodec" / "viewer" / "camera.js").as_uri()
    program = f"""
        import {{ upOf }} from {json.dumps(module)};
        import {{ readFileSync }} from "node:fs";
        const asked = JSON.parse(readFileSync(0, "utf8"));
        console.log(JSON.stringify(asked.map(([header, cameras]) => upOf(header, cameras))));
    """
    command = ["node", "--input-type=module", "-e", program]
    run = subprocess.run(command, input=json.dumps(asked), capture_output=True, text=True, check=True)
    directions = np.array(json.loads(run.stdout))
    np.testing.assert_allclose(directions, wanted, atol=1e-6)
    # Some are finer than an axis.
    assert (np.abs(directions).max(axis=1) < 0.99).any()


def test_encode_says_what_is_up_and_drops_cameras(tmp_path: Path) -> None:
    """--up and --cameras change nothing else, and without them a folder gives the same bytes."""
    scene = random_scene(71, 50)
    stated = spread_cameras(RIGS["turntable"][0], 5)
    file, folder, other = tmp_path / "a.c3gs", tmp_path / "scene", tmp_path / "b.c3gs"
    file.write_bytes(emit(replace(scene, ancillary=with_cameras(scene.ancillary, stated))))
    assert main(["decode", str(file), "-o", str(folder)]) == 0
    assert main(["encode", str(folder), "-o", str(other)]) == 0
    assert other.read_bytes() == file.read_bytes()
    assert main(["encode", str(folder), "-o", str(other), "--up=-z", "--cameras", "2"]) == 0
    parsed = parse(other.read_bytes()).scene
    assert parsed.render == replace(scene.render, up_axis=5)
    assert cameras(parsed.ancillary) == stated[:2]
    assert digest(replace(parsed, render=scene.render)) == digest(scene)
    assert main(["encode", str(folder), "-o", str(other), "--cameras", "0"]) == 0
    assert CAMERAS not in other.read_bytes()


def test_nothing_says_what_is_up() -> None:
    assert level_up([]) is None
    assert level_up([camera([0, 0, 0], [0, 1, 0])]) is None
    # Cameras that are turned in all ways, and two pairs that cancel each other out.
    everywhere = Rotation.random(200, random_state=5).as_matrix()
    tumbling = [Camera("", 40, 30, 40.0, 40.0, 20.0, 15.0, r, np.zeros(3)) for r in everywhere]
    assert level_up(tumbling) is None
    pairs = [camera([0, 0, 0], [s, 0, 0], roll=r) for s in (1, -1) for r in (0.0, 180.0)]
    for rig in (tumbling, pairs):
        assert np.linalg.norm(up_direction(rig, np.zeros((0, 3)))) == pytest.approx(1)


def test_numbers_of_axes() -> None:
    assert [nearest_axis(axis_direction(axis)) for axis in range(6)] == list(range(6))
