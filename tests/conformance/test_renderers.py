"""Wrong renderers, planted in the blocks of SPEC.md chapter 14 or in what connects them: an image shows each."""

import json
import math
import re
from collections.abc import Iterator
from dataclasses import replace
from itertools import count
from typing import Any

import numpy as np
import pytest

from conformance import spec_decoder
from conformance.cases.cameras import drawn
from conformance.manifest import ImageOf, load
from conformance.runner.images import image_difference, read_pfm
from conformance.spec_decoder.program import SPEC, source
from refcodec.bitstream import codec
from refcodec.bitstream.scene import Scene
from refcodec.rendering.camera import Camera, read_camera
from refcodec.rendering.view import pfm

# By name: the function of the blocks, its text and the changed one.
PLANTED = {
    "no low-pass filter": ("PROJECT", "a + low_pass, c + low_pass", "a, c"),
    "the low-pass filter of 3DGS": ("PROJECT", "a + low_pass, c + low_pass", "a + 0.3, c + 0.3"),
    "low-pass filter in one direction": ("PROJECT", "a + low_pass, c + low_pass", "a + low_pass, c"),
    "low_pass as a deviation": ("PROJECT", "a + low_pass, c + low_pass", "a + low_pass**2, c + low_pass**2"),
    "near plane of 3DGS": ("PROJECT", "z <= near_plane", "z <= 0.2"),
    "near plane drawn": ("PROJECT", "z <= near_plane", "z < near_plane"),
    "no near plane": ("PROJECT", "z <= near_plane", "z <= 0"),
    "slopes without clamp": ("PROJECT", "min(max(s, -c / f - beyond), (size - c) / f + beyond)", "s"),
    "slopes clamped as 3DGS does": (
        "PROJECT",
        "min(max(s, -c / f - beyond), (size - c) / f + beyond)",
        "min(max(s, -0.65 * size / f), 0.65 * size / f)",
    ),
    "slopes clamped to the image": ("PROJECT", "0.15 * size / f", "0.0"),
    "rotation transposed in the covariance": ("PROJECT", "ROTATION(quaternion)", "zip(*ROTATION(quaternion))"),
    "covariance without the camera's rotation": ("PROJECT", 'PRODUCT(derivative, camera["rotation"])', "derivative"),
    "derivative without slopes": ("PROJECT", "-fx * slope[0] / z", "0.0"),
    "one focal length": (
        "PROJECT",
        '(fx, fy), (cx, cy) = camera["focal"],',
        '(fx, fy), (cx, cy) = camera["focal"][:1] * 2,',
    ),
    "quaternion x, y, z, w": ("ROTATION", "w, x, y, z = quaternion", "x, y, z, w = quaternion"),
    "lengths squared": ("PROJECT", "m * s for m, s", "m * s * s for m, s"),
    "pixel centres at the corners": ("PIXEL", "u - x, v - y", "u - 0.5 - x, v - 0.5 - y"),
    "no alpha threshold": ("PIXEL", "alpha < 1 / 255", "False"),
    "alpha threshold of 1/512": ("PIXEL", "alpha < 1 / 255", "alpha < 1 / 512"),
    "the largest alpha of 3DGS": ("PIXEL", ", alpha_max)\n", ", 0.99)\n"),
    "no largest alpha": ("PIXEL", ", alpha_max)\n", ", 1.0)\n"),
    "no half in the exponent": ("PIXEL", "* dy * dy) / 2)", "* dy * dy))"),
    "no mixed term": ("PIXEL", "+ 2 * b * dx * dy", ""),
    "mixed term once": ("PIXEL", "2 * b * dx", "b * dx"),
    "cut at 3 deviations": ("PIXEL", "alpha < 1 / 255", "alpha < max(opacity * math.exp(-4.5), 1 / 255)"),
    "cut at 2 deviations": ("PIXEL", "alpha < 1 / 255", "alpha < max(opacity * math.exp(-2), 1 / 255)"),
    "background ignored": ("PIXEL", "o + left * g", "o"),
    "background added as a whole": ("PIXEL", "o + left * g", "o + g"),
    "stop before a Gaussian": (
        "PIXEL",
        "continue\n",
        "continue\n        if left * (1 - alpha) < 1e-4:\n            break\n",
    ),
    "stop at half the transmittance": ("PIXEL", "left < 1e-4", "left < 0.5"),
    "not limited to 1": ("PIXEL", "min(o + left * g, 1.0)", "o + left * g"),
    "colours limited to 1 before blending": ("STATIC_GAUSSIAN", "max(0.5 + x, 0.0)", "min(max(0.5 + x, 0.0), 1.0)"),
    "negative colours": ("STATIC_GAUSSIAN", "max(0.5 + x, 0.0)", "0.5 + x"),
    "colours without a half": ("STATIC_GAUSSIAN", "max(0.5 + x, 0.0)", "max(x, 0.0)"),
    "tanh in a static scene": ("STATIC_GAUSSIAN", "LOGISTIC(numbers[10])", "max(math.tanh(numbers[10]), 0)"),
    "harmonics planar": ("STATIC_GAUSSIAN", "harmonics[i::3]", "harmonics[i * len(values) : (i + 1) * len(values)]"),
    "direction reversed": ("STATIC_GAUSSIAN", "a - b for a, b", "b - a for a, b"),
    "direction of the viewing axis": ("STATIC_GAUSSIAN", "a - b for a, b in zip(mean, centre)", "-b for b in centre"),
    "quaternion as it is": ("STATIC_GAUSSIAN", "NORMALISED(numbers[6:10], [1.0, 0.0, 0.0, 0.0])", "numbers[6:10]"),
    "sign of the first degree": ("HARMONICS", "-0.4886025119029199 * y", "0.4886025119029199 * y"),
    "order of the first degree": ("HARMONICS", "0.4886025119029199 * z", "-0.4886025119029199 * x"),
    "sign of the second degree": ("HARMONICS", "-1.0925484305920792 * x * z", "1.0925484305920792 * x * z"),
    "sign of the third degree": ("HARMONICS", "-0.5900435899266435 * x", "0.5900435899266435 * x"),
    "opacity logistic in a view-dependent scene": ("GAUSSIANS", "math.tanh(opacity[k]), [", "LOGISTIC(opacity[k]), ["),
    "direction to the camera": ("GAUSSIANS", "a - b for a, b", "b - a for a, b"),
    "distance_unit ignored": ("GAUSSIANS", " / distance_unit", ""),
    "lengths without the logistic function": ("GAUSSIANS", "math.exp(s) * LOGISTIC(x)", "math.exp(s)"),
    "offsets as they are": ("GAUSSIANS", "p + o * math.exp(s)", "p + o"),
    "infinite Gaussians drawn": ("STATIC_GAUSSIAN", "math.exp(x) for x", "math.exp(min(x, 9)) for x"),
}
SUITE = load()
# The small files first, which show most faults.
IMAGES = sorted((v for v in SUITE.vectors if isinstance(v.expectation, ImageOf)), key=lambda v: v.input.size)


def shown() -> Iterator[tuple[str, Scene, Camera, bytes]]:
    """The scene, camera and reference image of each vector."""
    for v in IMAGES:
        assert isinstance(v.expectation, ImageOf)
        camera = read_camera(json.dumps(v.expectation.camera))
        yield (
            v.id,
            codec.parse(SUITE.path(v).read_bytes()).scene,
            camera,
            (SUITE.folder / v.expectation.path).read_bytes(),
        )


EVERY = list(shown())


def differing(text: dict[str, Any], change: Any = lambda scene, camera: (scene, camera), **more: Any) -> str | None:
    """The first image that a renderer draws wrongly."""
    for name, scene, camera, right in EVERY:
        made = drawn(*change(scene, camera), text, **more)
        if made.shape != read_pfm(right).shape or image_difference(right, pfm(np.float32(made))):
            return name
    return None


@pytest.mark.slow
@pytest.mark.parametrize("name", PLANTED)
def test_a_wrong_renderer_is_seen(name: str) -> None:
    place, old, new = PLANTED[name]
    text = spec_decoder.names()
    function = re.search(rf"^def {place}\(.*?(?=^\S)", source(SPEC.read_text(encoding="utf-8")), re.M | re.S)
    assert function
    statement = function[0]
    assert old in statement
    exec(statement.replace(old, new, 1), text)
    assert differing(text)


TIES = count(0, -1)
# By name: another order, scene or camera.
CONNECTED: dict[str, dict[str, Any]] = {
    "by distance": {"key": lambda seen, c: seen[2] * math.hypot((seen[0] - c.cx) / c.fx, (seen[1] - c.cy) / c.fy, 1)},
    "by decreasing depth": {"key": lambda seen, _: -seen[2]},
    "not ordered": {"key": lambda seen, _: 0.0},
    "ties in reverse": {"key": lambda seen, _: (seen[2], next(TIES))},
    "principal point in the middle": {"change": lambda s, c: (s, replace(c, cx=c.width / 2, cy=c.height / 2))},
    "principal point off by half a pixel": {"change": lambda s, c: (s, replace(c, cx=c.cx + 0.5, cy=c.cy + 0.5))},
    "rotation transposed": {"change": lambda s, c: (s, replace(c, rotation=c.rotation.T))},
    "up is down": {"change": lambda s, c: (s, replace(c, rotation=c.rotation * [[1], [-1], [-1]]))},
    "black background": {"change": lambda s, c: (replace(s, render=replace(s.render, background=(0, 0, 0))), c)},
    "background of 254": {
        "change": lambda s, c: (
            replace(s, render=replace(s.render, background=tuple(min(x, 254) for x in s.render.background))),
            c,
        )
    },
    "background in reverse": {
        "change": lambda s, c: (replace(s, render=replace(s.render, background=s.render.background[::-1])), c)
    },
    "nothing drawn": {"change": lambda s, c: (replace(s, render=replace(s.render, near_plane=1e9)), c)},
}


@pytest.mark.slow
@pytest.mark.parametrize("name", CONNECTED)
def test_a_wrong_program_is_seen(name: str) -> None:
    text = spec_decoder.names()
    assert differing(text, **CONNECTED[name])
