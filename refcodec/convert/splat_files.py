"""Files of plain 3D Gaussians in all formats."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..folder.layout import SceneFolderError, there
from .glb import glb_up, read_glb
from .sog import read_sog
from .splat_arrays import ADVICE, Arrays
from .splat_ply import read_splat_ply
from .spz import read_spz

READERS = {".ply": read_splat_ply, ".spz": read_spz, ".sog": read_sog, ".json": read_sog, ".glb": read_glb}
# Logits and logarithms beyond these have no effect in float32.
LOGIT_MAX, LOGARITHM_MAX = 20.0, 40.0
# The largest coordinate and the largest coefficient. Squares of larger ones overflow float32, or nearly so.
COORDINATE_MAX, COEFFICIENT_MAX = 1e9, 1e9


def read_splats(file: Path) -> Arrays:
    """Returns the Gaussians of a file, at least one, all with finite numbers.

    file: a .ply, .spz, .sog or .glb file, or the meta.json of a folder of SOG. Raises SceneFolderError, and OSError.
    """
    if not there(file, ADVICE):
        raise SceneFolderError(file, "the file does not exist", "give a .ply, .spz, .sog or .glb file of 3D Gaussians")
    arrays = READERS[file.suffix.lower()](file)
    with np.errstate(invalid="ignore"):
        arrays["opacity"] = arrays["opacity"].clip(-LOGIT_MAX, LOGIT_MAX)
        arrays["scale"] = arrays["scale"].clip(-LOGARITHM_MAX, LOGARITHM_MAX)
    if not len(arrays["mean"]):
        raise SceneFolderError(file, "it has no Gaussians", ADVICE)
    for name, values in arrays.items():
        if not np.isfinite(values).all():
            raise SceneFolderError(file, f"a {name} is NaN or infinite", ADVICE)
    for name, most in (("mean", COORDINATE_MAX), ("base", COEFFICIENT_MAX), ("rest", COEFFICIENT_MAX)):
        if np.abs(arrays[name]).max(initial=0) > most:
            raise SceneFolderError(file, f"a {name} is beyond {most:g}", ADVICE)
    return arrays


def splats_up(file: Path) -> NDArray[np.float64]:
    """Returns the up axis of a file of read_splats, a unit vector, float64 [3]: the stated one, or -y as in 3DGS files.

    Raises SceneFolderError, and OSError.
    """
    return glb_up(file) if file.suffix.lower() == ".glb" else np.array([0.0, -1.0, 0.0])
