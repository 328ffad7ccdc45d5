"""Cases of clause 14: Gaussians for cameras (14.3), by SPEC.md's blocks in binary64."""

import json
from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from typing import Any

import numpy as np

from refcodec.bitstream import codec
from refcodec.bitstream.dimensions import STATIC
from refcodec.bitstream.header import PositionGrid
from refcodec.bitstream.reconstruction import gaussians as splat_of
from refcodec.bitstream.reconstruction import reconstruct
from refcodec.rendering.camera import read_camera
from refcodec.rendering.gaussians import RENDERING

from .. import spec_decoder
from . import static
from .numbers import Numbers
from .scenes import TINY_DIMENSIONS, drawn_symbols, lattice, scene
from .table import Seen, valid
from .weights import BASE_STEPS, dyadic, with_weights

# SPEC [G14.3-1]: of means, axis lengths, quaternions, opacities and colours.
TOLERANCE = 1e-4
# Enough digits for the tolerance, but few enough to hide the last bit of a machine's exp.
DIGITS = 9


@cache
def _text() -> dict[str, Any]:
    return spec_decoder.names()


def expected(data: bytes, camera: dict[str, Any], text: dict[str, Any] | None = None) -> bytes:
    """Returns the list of Gaussians of a file for a camera, as JSON. text: the names of SPEC.md's blocks, if known."""
    text = _text() if text is None else text
    scene = codec.parse(data).scene
    values, centre = reconstruct(scene), read_camera(json.dumps(camera)).centre.tolist()
    if scene.render.render_model == STATIC:
        places = np.argwhere(scene.masks).tolist()
        numbers = splat_of(scene).astype(np.float64).tolist()
        seen = [text["STATIC_GAUSSIAN"](each, centre) for each in numbers]
        return _document([_row(n, k, each) for (n, k), each in zip(places, seen, strict=True)])
    networks = {name: [(w.tolist(), b.tolist()) for w, b in scene.networks[name]] for name in RENDERING}
    lines = []
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
            seen = text["GAUSSIANS"](networks, position, feature, scaling, offsets, alone, centre, unit)
            lines += [_row(n, k, gaussian) for gaussian in seen]
    return _document(lines)


def _row(anchor: int, offset: int, gaussian: tuple[Any, ...]) -> dict[str, Any]:
    kinds = ("mean", "lengths", "quaternion", "opacity", "colour")
    values = {kind: _rounded(value) for kind, value in zip(kinds, gaussian, strict=True)}
    return {"anchor": anchor, "offset": offset, **values}


def _document(rows: list[dict[str, Any]]) -> bytes:
    return (json.dumps({"gaussians": rows}, separators=(",", ":")) + "\n").encode()


def _rounded(value: Any) -> Any:
    """Returns numbers with DIGITS significant digits."""
    return [_rounded(x) for x in value] if isinstance(value, list) else float(f"{value:.{DIGITS}g}")


@cache
def _file() -> bytes:
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
    return codec.emit(drawn_symbols(made, partial(numbers.integers, -25, 9)))


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


# fmt: off
CASES = [
    *valid("cameras", "", "D9.1-1 D9.2-1", ("cameras", "a scene that cameras look at", _file)),
    *valid("cameras", "direction-sign", "", *(
        (f"camera-{view}", text, _seen, "valid-cameras", _file, view) for view, (text, _, _) in VIEWS.items())),
    *valid("cameras static", "direction-sign harmonics", "", *(
        (f"static-camera-{view}", f"a static scene, and {text}", _seen, "valid-static-degree-3",
         partial(static.of_degree, 3), view) for view, (text, _, _) in VIEWS.items())),
]
