"""The formats of written splat files, by suffix."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..bitstream.header import RenderInfo
from ..files.outputs import Kind
from .glb import GLB, check_colours, glb_bytes
from .ply import PLY, ply_bytes
from .sog import SOG, sog_file
from .splats import Packed, Splats
from .spz import BITS, SPZ, spz_file

F64 = NDArray[np.float64]

FORMATS: dict[str, Kind] = {".ply": PLY, ".spz": SPZ, ".sog": SOG, ".glb": GLB}


def splat_files(
    splats: Splats, suffixes: Sequence[str], up: F64, render: RenderInfo, spz_bits: int = BITS
) -> list[Packed]:
    """Returns files of the Gaussians of a scene. suffixes, up, spz_bits: as for splat_file. render: of the scene.

    Raises ValueError as splat_file, and if a format states other colours than those of the scene.
    """
    # Only GLB states the colour space.
    if ".glb" in suffixes:
        check_colours(render)
    return [splat_file(splats, suffix, up, spz_bits) for suffix in suffixes]


def splat_file(splats: Splats, suffix: str, up: F64, spz_bits: int = BITS) -> Packed:
    """Returns a file of Gaussians.

    suffix: a key of FORMATS. up: the up axis of the scene, a unit vector, float64 [3]. spz_bits: as for spz_file.
    Raises ValueError if the format cannot hold them, and if there are none.
    """
    if not len(splats.mean):
        raise ValueError("it has no Gaussians")
    if suffix == ".spz":
        return spz_file(splats, spz_bits)
    if suffix == ".sog":
        return sog_file(splats)
    return Packed(ply_bytes(splats) if suffix == ".ply" else glb_bytes(splats, up), splats)
