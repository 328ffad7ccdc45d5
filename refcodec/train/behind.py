"""Points behind the given ones: of a background that is plain or blurred, COLMAP finds none.

Anchors would grow there only from the edge of others, each to what one photograph shows.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ..photographs.photographs import PhotographSet
from ..rendering.camera import Camera
from .hull import shown

F64 = NDArray[np.float64]
U8 = NDArray[np.uint8]

# The tiles of a photograph along its longer side. The depth of a tile is that of so many points around it.
TILES, AROUND = 12, 4
# The least number of cameras that see a tile at its depth. Where fewer do, as at the edge of a flight, no points were
# found for this reason, and points behind would only stand before what other cameras see.
CAMERAS = 10


def points_behind(photographs: PhotographSet, deepest: float, most: int, seed: int) -> tuple[F64, U8]:
    """Returns points in the tiles of photographs that show none: float64 [M, 3], world units, and uint8 [M, 3].

    Each is on the ray of a pixel, and has its colour. Its disparity is drawn evenly, from that of the farthest point
    around the tile to that of `deepest` times its depth. most: M at most, by chance. Raises PhotographError.
    """
    random, points, colours = np.random.default_rng(seed), [np.zeros((0, 3))], [np.zeros((0, 3), np.uint8)]
    poses = _poses([photograph.camera for photograph in photographs.train])
    for photograph in photographs.train:
        camera = photograph.camera
        size = np.array([camera.width, camera.height])
        _, pixels, depth = shown(camera, photographs.points)
        if len(pixels) < AROUND:
            continue
        edge = size.max() / TILES
        free = np.ones(np.ceil(size / edge).astype(int), bool)
        free[tuple((pixels // edge).astype(int).T)] = False
        tiles = np.argwhere(free)
        at = np.minimum((tiles + random.random(tiles.shape)) * edge, size - 1e-6)
        around = depth[cKDTree(pixels).query(at, AROUND)[1]]
        places = _lifted(camera, at, np.median(around, axis=1))
        column, row = at.astype(int).T
        counts = (_seen(poses, places) >= CAMERAS) & (photograph.mask is None or photograph.mask[row, column])
        disparity = random.uniform(1 / deepest, 1, len(at)) / around.max(axis=1)
        points.append(_lifted(camera, at, 1 / disparity)[counts])
        colours.append(photograph.image[row, column][counts])
    found, seen = np.concatenate(points), np.concatenate(colours)
    chosen = np.sort(random.permutation(len(found))[:most])
    return found[chosen], seen[chosen]


def _poses(cameras: list[Camera]) -> tuple[F64, F64, F64]:
    """Rotations [c, 3, 3], translations [c, 1, 3], and focal lengths, principal points and sizes [3, c, 1, 2]."""
    lenses = np.array([[(c.fx, c.fy), (c.cx, c.cy), (c.width, c.height)] for c in cameras])
    turns, shifts = np.array([c.rotation.T for c in cameras]), np.array([c.translation for c in cameras])
    return turns, shifts[:, None], lenses.swapaxes(0, 1)[:, :, None]


def _seen(poses: tuple[F64, F64, F64], places: F64) -> NDArray[np.int64]:
    """The number of cameras that see each of some places [n, 3], int64 [n]. As `shown`, but for all cameras at once."""
    turns, shifts, (focal, centre, size) = poses
    away = places @ turns + shifts
    depth = away[..., 2:]
    pixels = away[..., :2] / np.maximum(depth, 1e-12) * focal + centre
    seen: NDArray[np.int64] = ((depth > 0) & (pixels >= 0) & (pixels < size)).all(axis=2).sum(axis=0)
    return seen


def _lifted(camera: Camera, pixels: F64, depth: F64) -> F64:
    """The places of pixels [n, 2] at depths [n], world units: [n, 3]."""
    rays = np.append((pixels - [camera.cx, camera.cy]) / [camera.fx, camera.fy], np.ones((len(pixels), 1)), axis=1)
    lifted: F64 = (rays * depth[:, None] - camera.translation) @ camera.rotation
    return lifted
