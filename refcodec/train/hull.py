"""The visual hull: the space that transparent photographs do not show to be empty."""

import numpy as np
from numpy.typing import NDArray

from ..photographs.photographs import Photograph, PhotographSet
from ..rendering.camera import Camera

F64 = NDArray[np.float64]
U8 = NDArray[np.uint8]

# Points that are drawn at once, and how often at most: enough to find things that fill a thousandth of the box.
BATCH, BATCHES = 100_000, 60


def carved(photographs: PhotographSet, wanted: int, seed: int) -> tuple[F64, U8]:
    """Points where no photograph sees through: positions float64 [M, 3] and colours uint8 [M, 3].

    They are drawn evenly in the box of the photographs' points until `wanted` are found or BATCHES are drawn. The
    colour of a point is the mean of the colours that the photographs show at its place. The photographs' points are
    returned in two cases: no photograph is transparent, or all drawn points are seen through. Raises PhotographError.
    """
    empty = [photograph.empty() for photograph in photographs.train]
    if not any(pixels.any() for pixels in empty):
        return photographs.points, photographs.colours
    low, high = photographs.points.min(axis=0), photographs.points.max(axis=0)
    random = np.random.default_rng(seed)
    points, colours = [np.zeros((0, 3))], [np.zeros((0, 3), np.uint8)]
    for _ in range(BATCHES):
        drawn = random.uniform(low, high, (BATCH, 3))
        total, seen = np.zeros((BATCH, 3)), np.zeros(BATCH)
        rows = np.arange(BATCH)
        for photograph, pixels in zip(photographs.train, empty, strict=True):
            inside, at = _pixels(photograph, drawn[rows])
            through = np.zeros(len(rows), bool)
            through[inside] = pixels[at]
            total[rows[inside]] += photograph.image[at]
            seen[rows[inside]] += 1
            rows = rows[~through]
        rows = rows[seen[rows] > 0]
        points.append(drawn[rows])
        colours.append((total[rows] / seen[rows, None]).astype(np.uint8))
        if sum(map(len, points)) >= wanted:
            break
    chosen = np.concatenate(points)
    return (chosen, np.concatenate(colours)) if len(chosen) else (photographs.points, photographs.colours)


def shown(camera: Camera, points: F64) -> tuple[NDArray[np.int64], F64, F64]:
    """The points in a camera's view: rows int64 [n], pixels float64 [n, 2] and depths [n], in the world's unit."""
    away = points @ camera.rotation.T + camera.translation
    rows = np.flatnonzero(away[:, 2] > 0)
    x, y, depth = away[rows].T
    pixels = np.stack([x / depth * camera.fx + camera.cx, y / depth * camera.fy + camera.cy], axis=1)
    inside = ((pixels >= 0) & (pixels < [camera.width, camera.height])).all(axis=1)
    return rows[inside], pixels[inside], depth[inside]


def _pixels(photograph: Photograph, points: F64) -> tuple[NDArray[np.int64], tuple[NDArray[np.int64], ...]]:
    """The points that a photograph shows in pixels that count, int64 [n], and these: rows and columns, int64 [n]."""
    rows, pixels, _ = shown(photograph.camera, points)
    column, row = pixels.astype(np.int64).T
    counts = slice(None) if photograph.mask is None else photograph.mask[row, column]
    return rows[counts], (row[counts], column[counts])
