"""Lens distortion: COLMAP's SIMPLE_RADIAL, RADIAL, OPENCV and FULL_OPENCV models, and undistorted images.

All of them use coefficients of FULL_OPENCV. scipy's map_coordinates resamples. opencv would be faster, but takes
150 MB.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.ndimage import map_coordinates

from .cameras import COEFFICIENTS, F64, U8, Camera, Distortion, PhotographError
from .images import shrink

# Sample points of the distortion along each edge of an image, and along each side of a grid over it.
EDGE_POINTS, GRID_POINTS = 129, 33
# A stronger change of the field of view is that of a fisheye lens, or a mistake.
ZOOM_MIN, ZOOM_MAX = 0.2, 2.0
NEWTON_STEPS = 30
# In normalised coordinates: 1e-5 pixel at a focal length of 10,000.
NEWTON_TOLERANCE = 1e-9
# Rows resampled at once, which bounds the memory of coordinates.
ROWS = 256


def distort(points: F64, distortion: Distortion) -> F64:
    """Returns the positions [N, 2] at which points [N, 2] of the image plane z = 1 appear through the lens."""
    p1, p2 = distortion[2:4]
    x, y = points[:, 0], points[:, 1]
    r2 = x * x + y * y
    radial, _ = _radial(r2, distortion)
    return np.stack(
        [x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x), y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y],
        axis=1,
    )


def _radial(r2: F64, distortion: Distortion) -> tuple[F64, F64]:
    """Returns the factor of radial distortion for squared distances from the axis, and its slope in r2, [N] each."""
    k1, k2, _, _, k3, k4, k5, k6 = distortion
    above, below = (1 + r2 * (a + r2 * (b + r2 * c)) for a, b, c in ((k1, k2, k3), (k4, k5, k6)))
    up, down = (a + r2 * (2 * b + r2 * 3 * c) for a, b, c in ((k1, k2, k3), (k4, k5, k6)))
    return above / below, (up - above / below * down) / below


def _slopes(points: F64, distortion: Distortion) -> tuple[F64, F64, F64]:
    """dx'/dx, dx'/dy (which equals dy'/dx) and dy'/dy of distort, each [N]."""
    p1, p2 = distortion[2:4]
    x, y = points[:, 0], points[:, 1]
    radial, slope = _radial(x * x + y * y, distortion)
    bend = 2 * slope
    return (
        radial + x * x * bend + 2 * p1 * y + 6 * p2 * x,
        x * y * bend + 2 * p1 * x + 2 * p2 * y,
        radial + y * y * bend + 6 * p1 * y + 2 * p2 * x,
    )


def undistort(points: F64, distortion: Distortion) -> F64:
    """Returns the inverse of distort, by Newton's method; NaN where it does not converge."""
    out = points.copy()
    with np.errstate(all="ignore"):
        for _ in range(NEWTON_STEPS):
            a, b, d = _slopes(out, distortion)
            error = distort(out, distortion) - points
            determinant = a * d - b * b
            out = (
                out
                - np.stack([d * error[:, 0] - b * error[:, 1], a * error[:, 1] - b * error[:, 0]], axis=1)
                / determinant[:, None]
            )
        wrong = ~(np.abs(distort(out, distortion) - points).max(axis=1) < NEWTON_TOLERANCE)
    out[wrong] = np.nan
    return out


def undistorted_camera(where: Path | str, camera: Camera, distortion: Distortion) -> Camera:
    """Returns the pinhole camera of the undistorted image, which has the same size and no pixel outside the photograph.

    Its frame is the largest upright rectangle of the photograph's shape that fits in the middle of the undistorted
    photograph. The focal lengths and the principal point follow from it. The curved edges outside are
    lost. Raises PhotographError for a distortion that cannot be undone over that frame.
    """
    edge = np.linspace(0, 1, EDGE_POINTS)
    zero, one = np.zeros(EDGE_POINTS), np.ones(EDGE_POINTS)
    size, focal = np.array([camera.width, camera.height]), np.array([camera.fx, camera.fy])
    principal = np.array([camera.cx, camera.cy])

    def inside(x: F64, y: F64, axis: int) -> F64:
        return undistort((np.stack([x, y], axis=1) * size - principal) / focal, distortion)[:, axis]

    # max and min propagate NaN.
    low = np.array([inside(zero, edge, 0).max(), inside(edge, zero, 1).max()])
    high = np.array([inside(one, edge, 0).min(), inside(edge, one, 1).min()])
    zoom = float(((high - low) * focal / size).min())
    named = {name: value for name, value in zip(COEFFICIENTS, distortion, strict=True) if value}
    problem = f"the distortion {', '.join(named)} = {', '.join(f'{v:g}' for v in named.values())} "
    advice = "check the coefficients, or undistort the images beforehand (colmap image_undistorter)"
    if not ZOOM_MIN <= zoom <= ZOOM_MAX:
        problem += "cannot be undone over the whole image, or changes the field of view more than"
        raise PhotographError(where, f"{problem} {ZOOM_MIN:g} to {ZOOM_MAX:g} times", advice)
    focal = focal / zoom
    principal = size / 2 - focal * (low + high) / 2
    grid = np.stack(np.meshgrid(*(np.linspace(0, side, GRID_POINTS) for side in size)), axis=2).reshape(-1, 2)
    plane = (grid - principal) / focal
    a, b, d = _slopes(plane, distortion)
    if not (a * d - b * b > 0).all():
        raise PhotographError(where, f"{problem}folds the image over itself", advice)
    fx, fy = focal.tolist()
    cx, cy = principal.tolist()
    return replace(camera, fx=fx, fy=fy, cx=cx, cy=cy)


def undistorted_image(image: U8, photographed: Camera, distortion: Distortion, camera: Camera) -> U8:
    """Returns the photograph as `camera` would have taken it, uint8 [camera.height, camera.width, 3].

    photographed: the camera of `image` [H, W, 3], distortion aside. Linear interpolation blurs on its own grid of
    pixels, so it is done on the grid of the photograph, and the result is averaged down. A photograph of more than
    twice the target size is first reduced to twice that size.
    """
    width, height = photographed.width, photographed.height
    if width >= 2 * camera.width and height >= 2 * camera.height:
        width, height = 2 * camera.width, 2 * camera.height
        image, photographed = shrink(image, width, height), photographed.resized(width, height)
    target = camera.resized(width, height)
    out = np.empty((target.height, target.width, 3), np.uint8)
    x = (np.arange(target.width) + 0.5 - target.cx) / target.fx
    for top in range(0, target.height, ROWS):
        y = (np.arange(top, min(top + ROWS, target.height)) + 0.5 - target.cy) / target.fy
        plane = np.stack(np.meshgrid(x, y), axis=2).reshape(-1, 2)
        at = distort(plane, distortion) * [photographed.fx, photographed.fy] + [photographed.cx, photographed.cy]
        # map_coordinates counts from pixel centres. Within half a pixel of the edge, it uses the pixel at the edge.
        where = (at - 0.5).T[::-1].reshape(2, len(y), len(x))
        for channel in range(3):
            # In float: with integers, map_coordinates would truncate instead of round.
            part = map_coordinates(image[..., channel], where, output=np.float32, order=1, mode="nearest")
            out[top : top + len(y), :, channel] = np.rint(part)
    return shrink(out, camera.width, camera.height)
