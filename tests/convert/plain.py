"""Plain Gaussians for tests of convert."""

from pathlib import Path

import numpy as np

from refcodec.formats.harmonics import REST
from refcodec.formats.splats import Splats, narrowed
from refcodec.formats.table import write_splats


def made(count: int = 300, degree: int = 2) -> Splats:
    """Gaussians in a ball, of opaque and of transparent ones."""
    rng = np.random.default_rng(0)
    quaternion = rng.normal(0, 1, (count, 4))
    return narrowed(
        mean=rng.normal(0, 0.5, (count, 3)),
        base=rng.normal(0, 0.7, (count, 3)).clip(-1.5, 1.5),
        rest=rng.normal(0, 0.2, (count, REST[degree], 3)).clip(-0.9, 0.9),
        opacity=rng.normal(1, 2, count).clip(-4, 4),
        scale=rng.normal(-2.5, 0.4, (count, 3)).clip(-4, -1),
        quaternion=quaternion / np.linalg.norm(quaternion, axis=1, keepdims=True),
    )


def write(splats: Splats, path: Path) -> Path:
    """Writes Gaussians in the format of the path's suffix."""
    path.write_bytes(write_splats(splats, path.suffix))
    return path
