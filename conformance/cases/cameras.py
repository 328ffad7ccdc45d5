"""Cases of clause 14: Gaussians (14.3) and images (14.5) for cameras, by SPEC.md's blocks in binary64."""

import json
import math
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace
from functools import cache, partial
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from refcodec.bitstream import codec
from refcodec.bitstream.cameras import cameras
from refcodec.bitstream.dimensions import STATIC
from refcodec.bitstream.header import PositionGrid
from refcodec.bitstream.reconstruction import gaussians as splat_of
from refcodec.bitstream.reconstruction import reconstruct
from refcodec.bitstream.scene import Scene
from refcodec.bitstream.splat import OUTPUT_BITS
from refcodec.rendering.camera import Camera, default_camera, read_camera
from refcodec.rendering.gaussians import RENDERING
from refcodec.rendering.view import pfm

from .. import spec_decoder
from . import static
from .numbers import Numbers
from .scenes import TINY_DIMENSIONS, drawn_symbols, lattice, scene, with_symbols
from .table import More, Seen, valid
from .targets import stored
from .weights import BASE_STEPS, dyadic, with_weights

Vector3 = tuple[float, float, float]
F64 = NDArray[np.float64]
# SPEC [G14.3-1]: of means, axis lengths, quaternions, opacities and colours.
TOLERANCE = 1e-4
# Enough digits for the tolerance, but few enough to hide the last bit of a machine's exp.
DIGITS = 9
# The levels of a reference image, and the exponent, times -2, beyond which a Gaussian is not looked at.
LEVELS, FAR = 1 << 16, 40.0


@cache
def _text() -> dict[str, Any]:
    return spec_decoder.names()


def expected(data: bytes, camera: dict[str, Any], text: dict[str, Any] | None = None) -> bytes:
    """Returns the list of Gaussians of a file for a camera, as JSON. text: the names of SPEC.md's blocks, if known."""
    text = _text() if text is None else text
    rows = []
    for (anchor, offset), place, gaussian in seen(codec.parse(data).scene, read_camera(json.dumps(camera)), text):
        kinds = ("mean", "lengths", "quaternion", "opacity", "colour")
        values = {kind: _rounded(value) for kind, value in zip(kinds, gaussian, strict=True)}
        reach = {} if place is None else {"reach": _rounded(math.dist(place, gaussian[0]))}
        rows.append({"anchor": anchor, "offset": offset, **values, **reach})
    return (json.dumps({"gaussians": rows}, separators=(",", ":")) + "\n").encode()


def seen(
    scene: Scene, camera: Camera, text: dict[str, Any]
) -> Iterator[tuple[tuple[int, int], list[float] | None, tuple[Any, ...]]]:
    """Yields the Gaussians for a camera: anchor and offset, its anchor's position unless it is static, its numbers."""
    values, centre = reconstruct(scene), camera.centre.tolist()
    if scene.render.render_model == STATIC:
        for (n, k), each in zip(np.argwhere(scene.masks).tolist(), splat_of(scene).astype(float).tolist(), strict=True):
            # SPEC 14.6: an exponential that overflows is infinite, and its Gaussian is not drawn (14.4).
            with suppress(OverflowError):
                yield (n, k), None, text["STATIC_GAUSSIAN"](each, centre)
        return
    networks = {name: [(w.tolist(), b.tolist()) for w, b in scene.networks[name]] for name in RENDERING}
    for n in range(scene.anchor_count):
        rows = (
            getattr(values, name)[n].astype(np.float64).tolist()
            for name in ("positions", "features", "scalings", "offsets")
        )
        mask = scene.masks[n].tolist()
        position, feature, scaling, offsets = rows
        for k in np.flatnonzero(scene.masks[n]).tolist():
            # One offset at a time, so that the offset of each Gaussian is known.
            alone = [kept and i == k for i, kept in enumerate(mask)]
            unit = scene.render.distance_unit
            for gaussian in text["GAUSSIANS"](networks, position, feature, scaling, offsets, alone, centre, unit):
                yield (n, k), position, gaussian


Projected = tuple[float, float, float, tuple[float, float, float]]


def drawn(
    scene: Scene,
    camera: Camera,
    text: dict[str, Any],
    key: Callable[[Projected, Camera], Any] = lambda seen, _: seen[2],
) -> F64:
    """Returns the image of PIXEL (SPEC [G14.5-1]), float64 [height, width, 3]. key: orders the Gaussians."""
    info, each = scene.render, []
    f: dict[str, Any] = {"size": (camera.width, camera.height)}
    f |= {"focal": (camera.fx, camera.fy), "principal_point": (camera.cx, camera.cy)}
    f |= {"rotation": camera.rotation.tolist(), "translation": camera.translation.tolist()}
    for _, _, (mean, lengths, quaternion, opacity, colour) in seen(scene, camera, text):
        # SPEC 14.4
        if not np.isfinite([*mean, *lengths, *quaternion, opacity, *colour]).all():
            continue
        projected = text["PROJECT"](mean, lengths, quaternion, f, info.near_plane, info.low_pass)
        if projected is not None and np.isfinite([*projected[:3], *projected[3]]).all():
            each.append((projected, opacity, colour))
    each.sort(key=lambda gaussian: key(gaussian[0], camera))
    background = [value / 255 for value in info.background]
    x, y = np.arange(camera.width) + 0.5, np.arange(camera.height)[:, None] + 0.5
    # Far below 1/255, a Gaussian changes no pixel. The list of each pixel leaves it out.
    near = np.zeros((len(each), camera.height, camera.width), bool)
    for number, ((u, v, _, (a, b, c)), _, _) in enumerate(each):
        near[number] = a * (x - u) ** 2 + 2 * b * (x - u) * (y - v) + c * (y - v) ** 2 < FAR
    return np.array(
        [
            [
                text["PIXEL"](
                    i + 0.5, j + 0.5, [each[n] for n in np.flatnonzero(near[:, j, i])], background, info.alpha_max
                )
                for i in range(camera.width)
            ]
            for j in range(camera.height)
        ]
    )


def reference_image(data: bytes, camera: dict[str, Any]) -> bytes:
    """Returns the image of a file for a camera as a PFM file, which hides the last bit of a machine's exp."""
    pixels = drawn(codec.parse(data).scene, read_camera(json.dumps(camera)), _text())
    return pfm((np.round(pixels * LEVELS) / LEVELS).astype(np.float32))


def _rounded(value: Any) -> Any:
    """Returns numbers with DIGITS significant digits."""
    return [_rounded(x) for x in value] if isinstance(value, list) else float(f"{value:.{DIGITS}g}")


def _made() -> Scene:
    numbers, d = Numbers("cameras"), replace(TINY_DIMENSIONS, offset_count=5, render_width=8)
    where, grid = lattice(numbers, 12), PositionGrid((0, 0, 0), 1, 0)
    made = scene("cameras", 12, d, positions=where, base_step=(0.0625, 0.0625, 0.25), grid=grid)
    made = replace(made, render=replace(made.render, distance_unit=2.5))
    for name in ("opacity", "covariance", "colour"):
        for w, b in made.networks[name]:
            w[:] = dyadic(numbers.integers(-99, 99, *w.shape), 8)
            b[:] = dyadic(numbers.integers(-99, 99, len(b)), 7)
    # One offset has a quaternion of length 0.
    with_weights(made, BASE_STEPS, ("covariance.-1", slice(3, 7), 0, 0))
    return drawn_symbols(made, partial(numbers.integers, -25, 9))


@cache
def _file() -> bytes:
    return codec.emit(_made())


# Values that no encoder's scene has by default.
ODD: dict[str, Any] = {"background": (255, 128, 51), "near_plane": 1.75, "alpha_max": 0.75, "low_pass": 0.1}


@cache
def drawable(kind: str) -> bytes:
    """Returns the file valid-KIND. Those that are made have odd render information."""
    _, _, form = kind.rpartition("-")
    if not kind.startswith("drawn"):
        return stored(f"valid/{kind}.c3gs")
    odd = ODD
    if form == "drawn":
        made = _made()
        (w, b), (_, c) = made.networks["opacity"][-1], made.networks["covariance"][-1]
        w[:], b[:], c[:] = w * 4, b + 1, c + 2
    else:
        numbers, made = Numbers(kind), static.ordinary(kind, 12, static.DEGREES[int(form) if form.isdigit() else 0])
        anchors, offsets = made.anchor_count, made.dimensions.offset_count
        scalings, spread = numbers.integers(-30, 4, anchors, 6), 6
        made.networks["opacity"][-1][1][:] += (14 if form == "stop" else 3) << OUTPUT_BITS
        # Pixels above 1.
        made.networks["colour"][-1][1].reshape(offsets, -1)[:, :3] += (3 << OUTPUT_BITS) * (form == "1")
        if form in ("ties", "stop"):
            # Four anchors in one place: Gaussians of equal depth, as their offsets are 0.
            made, spread = replace(made, positions=made.positions[np.arange(anchors) // 4]), 0
        if form in ("stop", "infinite"):
            odd = {**ODD, "background": (255, 255, 255), "alpha_max": made.render.alpha_max}
        if form == "stop":
            # Gaussians larger than any image. Behind two that are opaque, others are less so.
            scalings[:, 3:], made.masks[:] = 80, np.eye(2)[np.minimum(np.arange(anchors) // 2, 1)]
            made.networks["opacity"][-1][1][1] -= 12 << OUTPUT_BITS
        if form == "infinite":
            made.masks[:], made.networks["covariance"][-1][1][7:10] = True, 1000 << OUTPUT_BITS
        made = with_symbols(made, scalings=scalings, offsets=numbers.centred(spread, anchors, offsets, 3))
    return codec.emit(replace(made, render=replace(made.render, **odd)))


def _within() -> list[float]:
    """Returns the translation of a camera at the position of anchor 4."""
    x, y, z = (float(x) for x in lattice(Numbers("cameras"), 12)[4])
    return [y, -x, -z]


# By name: a title, the rotation by rows, and the translation.
VIEWS: dict[str, tuple[str, list[list[float]], list[float]]] = {
    "ahead": ("a camera that looks along z", [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], [0.5, -0.25, 6.0]),
    "turned": (
        "a camera that is turned about all axes",
        [[0.36, 0.48, -0.8], [-0.8, 0.6, 0.0], [0.48, 0.64, 0.6]],
        [1.5, 2.0, -3.0],
    ),
    "within": ("a camera in the place of an anchor", [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]], _within()),
}


def _seen(name: str, make: Callable[[], bytes], view: str) -> Seen:
    _, rotation, translation = VIEWS[view]
    size: dict[str, Any] = {"width": 64, "height": 48, "focal": [50.0, 52.0], "principal_point": [32.0, 23.5]}
    return Seen(name, make(), {**size, "rotation": rotation, "translation": translation})


def _looked_at(
    kind: str, eye: Vector3, target: Vector3, up: Vector3, focal: tuple[float, float] = (50.0, 38.0)
) -> Seen:
    """Returns an image whose principal point is far from its middle."""
    looking = Camera.look_at(eye, target, up, 48, 36, 1.0)
    return _image(kind, replace(looking, fx=focal[0], fy=focal[1], cx=10.5, cy=24.25))


def _stated(kind: str, number: int, width: int, height: int) -> Seen:
    """Returns the image of a camera of the file at another size."""
    scene = codec.parse(drawable(kind)).scene
    return _image(kind, default_camera(cameras(scene.ancillary)[number]).resized(width, height))


def _image(kind: str, c: Camera) -> Seen:
    lens = {"width": c.width, "height": c.height, "focal": [c.fx, c.fy], "principal_point": [c.cx, c.cy]}
    placed = {"rotation": _rounded(c.rotation.tolist()), "translation": _rounded(c.translation.tolist())}
    return Seen(f"valid-{kind}", drawable(kind), {**lens, **placed}, "image")


def _placed(kind: str, translation: Callable[[Scene], list[float]], result: Literal["gaussians", "image"]) -> Seen:
    """Returns what a camera sees that looks along z."""
    made = _image(kind, Camera("", 48, 36, 50.0, 38.0, 10.5, 24.25, np.eye(3), np.zeros(3)))
    place = translation(codec.parse(made.data).scene)
    return replace(made, camera={**made.camera, "translation": place}, result=result)


def _on_mean(scene: Scene) -> list[float]:
    """Returns the translation of a camera at the mean of a Gaussian."""
    return [-float(x) for x in splat_of(scene)[0, :3]]


def _on_near(scene: Scene) -> list[float]:
    """Returns that of a camera whose near plane has Gaussians."""
    x, y, z = _on_mean(scene)
    return [x, y, z + ODD["near_plane"]]


def _undrawn() -> Seen:
    return replace(_seen("valid-render-model-2", partial(drawable, "render-model-2"), "ahead"), result="undrawn")


_FROM, _TO, _UP = (0.0, 0.0, -7.0), (1.0, 0.0, 0.0), (0.0, -1.0, 0.0)
_ROLLED = (5.0, -6.0, 3.0), _TO, (1.0, -1.0, 0.3)
# fmt: off
CASES = [
    *valid("cameras", "", "D9.1-1 D9.2-1", ("cameras", "a scene that cameras look at", _file)),
    *valid("cameras", "direction-sign", "", *(
        (f"camera-{view}", text, _seen, "valid-cameras", _file, view) for view, (text, _, _) in VIEWS.items())),
    *valid("cameras static", "direction-sign harmonics", "", *(
        (f"static-camera-{view}", f"a static scene, and {text}", _seen, "valid-static-degree-3",
         partial(static.of_degree, 3), view) for view, (text, _, _) in VIEWS.items())),
    *valid("cameras", "", "D9.1-1 D9.2-1",
        ("drawn", "a scene with odd render information", drawable, "drawn")),
    *valid("cameras static", "", "D9.4-1", *(
        (f"drawn-{name}", f"a static scene with odd render information, {what}", drawable, f"drawn-{name}")
        for name, what in (*((d, f"degree {d}") for d in range(4)), ("ties", "Gaussians of equal depth"),
                           ("stop", "Gaussians that leave nothing behind them"), ("infinite", "infinite lengths")))),
    *valid("trained main static packed-positions packed-weights", "", "D7.2-1 D9.4-1",
        ("trained-static", "a static scene of 4,309 anchors learnt from aerial photographs", drawable, "trained-static",
         More(seconds=120))),
    *valid("images", "constants-of-3dgs projection", "",
        ("image-drawn", "odd values of everything that a renderer must know", _looked_at, "drawn", _FROM, _TO, _UP),
        ("image-rolled", "a rolled camera beside the scene", _looked_at, "drawn", *_ROLLED),
        ("image-within", "a camera amid the Gaussians", _looked_at, "drawn", (0.5, 0.25, -1.5), (1.0, 0.0, 1.0), _UP),
        ("image-trained", "a camera of a trained file, at another size", _stated, "trained-caliterra", 0, 48, 36)),
    *valid("images static", "constants-of-3dgs projection harmonics", "", *(
        (f"image-degree-{d}", f"a static scene of degree {d}", _looked_at, f"drawn-{d}", _FROM, _TO, _UP)
        for d in range(4)),
        ("image-ties", "Gaussians of equal depth", _looked_at, "drawn-ties", _FROM, _TO, _UP),
        ("image-static-rolled", "a static scene, and a rolled camera beside it", _looked_at, "drawn-3", *_ROLLED),
        ("image-static", "a camera of a trained static file, at another size", _stated, "trained-static", 1, 48, 36),
        ("image-static-near", "a camera near trained Gaussians", _looked_at, "trained-static", (-0.7, -1.0, 3.4),
         (1.0, 0.0, 5.0), (0.0, -1.0, 0.2)),
        ("image-stop", "blending ends before a Gaussian", _looked_at, "drawn-stop", _FROM, _TO, _UP),
        ("image-near", "Gaussians in the near plane, which are not drawn", _placed, "drawn-ties", _on_near, "image"),
        ("image-infinite", "infinite Gaussians, which are not drawn", _looked_at, "drawn-infinite", _FROM, _TO, _UP)),
    *valid("cameras static", "harmonics", "",
        ("list-infinite", "infinite Gaussians, which a list leaves out", _placed, "drawn-infinite", _on_mean,
         "gaussians"),
        ("list-on-mean", "a camera in the place of a Gaussian", _placed, "drawn-3", _on_mean, "gaussians")),
    *valid("images", "render-model", "", ("image-model-2", "a render model that no renderer knows", _undrawn)),
]
