"""Cameras and the Gaussians that SPEC.md's blocks give for them (SPEC 14.3), evaluated in binary64."""

from __future__ import annotations

import json
from functools import cache
from typing import Any

import numpy as np

from refcodec.bitstream import codec
from refcodec.bitstream.reconstruction import reconstruct
from refcodec.render.camera import read_camera
from refcodec.render.gaussians import RENDERING

from ..blocks import SPEC, blocks

# SPEC [G14.3-1]
TOLERANCE = 1e-4
# Enough digits for the tolerance; few enough that the last bit of a machine's exp does not show.
DIGITS = 9


@cache
def _text() -> dict[str, Any]:
    return blocks(SPEC.read_text(encoding="utf-8"))


def expected(data: bytes, camera: dict[str, Any]) -> bytes:
    """The list of Gaussians of a file for a camera, as JSON."""
    scene = codec.parse(data).scene
    values, centre = reconstruct(scene), read_camera(json.dumps(camera)).centre.tolist()
    networks = {name: [(w.tolist(), b.tolist()) for w, b in scene.networks[name]] for name in RENDERING}
    found = []
    for n in range(scene.anchor_count):
        rows = (
            getattr(values, name)[n].astype(np.float64).tolist()
            for name in ("positions", "features", "scalings", "offsets")
        )
        mask = scene.masks[n].tolist()
        position, feature, scaling, offsets = rows
        for k in np.flatnonzero(scene.masks[n]).tolist():
            # One offset at a time, so that each Gaussian's is known.
            alone = [kept and i == k for i, kept in enumerate(mask)]
            for mean, lengths, quaternion, opacity, colour in _text()["GAUSSIANS"](
                networks, position, feature, scaling, offsets, alone, centre, scene.render.distance_unit
            ):
                row = {"anchor": n, "offset": k}
                kinds = {
                    "mean": mean,
                    "lengths": lengths,
                    "quaternion": quaternion,
                    "opacity": opacity,
                    "colour": colour,
                }
                found.append({**row, **{kind: _rounded(value) for kind, value in kinds.items()}})
    return (json.dumps({"gaussians": found}, separators=(",", ":")) + "\n").encode()


def _rounded(value: Any) -> Any:
    """Numbers with DIGITS significant digits."""
    return [_rounded(x) for x in value] if isinstance(value, list) else float(f"{value:.{DIGITS}g}")
