"""Projects Gaussians to ellipses in the image, and takes gradients back through it (SPEC.md 14.4)."""

import math
from typing import Any

import numpy as np
from numba import prange

from .camera import Camera
from .compiled import compiled
from .constants import F32, LEAST, LOG2_MIN, SLACK, SUMS, TILE_HEIGHT, TILE_WIDTH
from .tiles import Pairs

# SPEC 14.4: how far beyond the edges of the image slopes may be, as a share of its size.
BEYOND = 0.15
# exp(-w^2 / 2) = exp2(-(K w)^2).
_K2 = 0.5 / math.log(2)
# The bounds of the inverse deviations, which have to fit float32. A Gaussian with a steeper one meets no centre of a
# pixel and is not drawn. A flatter one is raised to the bound, since it makes no difference over an image.
_FLATTEST, _STEEPEST = 1e-30, 1e30
# From this opacity on exp2 would overflow.
_OPACITY_MAX = 2.0**126


@compiled()
def _dot(x: Any, y: Any) -> float:
    return x[0] * y[0] + x[1] * y[1] + x[2] * y[2]


@compiled()
def _combine(f: Any, v: Any) -> Any:
    """Returns the sum of three vectors v, each times its factor in f."""
    return (
        f[0] * v[0][0] + f[1] * v[1][0] + f[2] * v[2][0],
        f[0] * v[0][1] + f[1] * v[1][1] + f[2] * v[2][1],
        f[0] * v[0][2] + f[1] * v[1][2] + f[2] * v[2][2],
    )


@compiled()
def _row3(values: F32, i: int) -> Any:
    return np.float64(values[i, 0]), np.float64(values[i, 1]), np.float64(values[i, 2])


@compiled()
def _rows_of(v: Any) -> Any:
    """Returns a flat tuple as rows of three. Parallel loops take no nested tuples."""
    return (v[0], v[1], v[2]), (v[3], v[4], v[5]), (v[6], v[7], v[8]), (v[9], v[10], v[11])


@compiled()
def _camera_space(i: int, mean: F32, view: Any) -> Any:
    """Returns the mean of Gaussian i in camera space. view: the rows of the rotation and the translation, as tuples."""
    m = _row3(mean, i)
    return _dot(view[0], m) + view[3][0], _dot(view[1], m) + view[3][1], _dot(view[2], m) + view[3][2]


@compiled()
def _axes(i: int, p: Any, quaternion: F32, view: Any, lens: Any) -> Any:
    """Returns the directions of Gaussian i, whose mean is p in camera space.

    With the derivative J of the projection, the rotation W of the camera and the rotation R of the Gaussian they are:
    the two rows of J W, the unit quaternion, 1 / the length of the given quaternion, the columns of R, and the two rows
    of J W R.
    """
    fx, fy, _, _, x_low, x_high, y_low, y_high = lens
    near = 1 / p[2]
    slope_x, slope_y = min(max(p[0] * near, x_low), x_high), min(max(p[1] * near, y_low), y_high)
    row_x = _combine((fx * near, 0.0, -fx * near * slope_x), view)
    row_y = _combine((0.0, fy * near, -fy * near * slope_y), view)
    w, (x, y, z) = np.float64(quaternion[i, 0]), _row3(quaternion[:, 1:], i)
    shrink = 1 / math.sqrt(w * w + x * x + y * y + z * z)
    w, x, y, z = w * shrink, x * shrink, y * shrink, z * shrink
    columns = (
        (1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)),
        (2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)),
        (2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)),
    )
    along_x = (_dot(row_x, columns[0]), _dot(row_x, columns[1]), _dot(row_x, columns[2]))
    along_y = (_dot(row_y, columns[0]), _dot(row_y, columns[1]), _dot(row_y, columns[2]))
    return row_x, row_y, (w, x, y, z), shrink, columns, along_x, along_y


@compiled()
def _scaled(s: Any, v: Any) -> Any:
    return s[0] * v[0], s[1] * v[1], s[2] * v[2]


@compiled(parallel=True)
def project_gaussians(
    inputs: Any, view: Any, lens: Any, width: int, height: int, low_pass: float, near_plane: float
) -> Any:
    """SPEC 14.4, PROJECT: returns record f32[N,16], room i32[N], depth f64[N] and radius f32[N].

    inputs: mean, f32[N,3], quaternion, f32[N,4], scale, f32[N,3], opacity, f32[N], and colour, f32[N,3]. view, lens: as
    view_of and lens_of give them.

    room is the number of tiles in the box around the ellipse. radius is that of Rendering. A Gaussian that is not drawn
    has room 0, radius 0 and no record.

    A record fills one line of the cache. It holds:

    - 0 and 1: the column and the row of the pixel of the image that is nearest to the centre,
    - 2 and 3: u and v at the centre of that pixel,
    - 4 to 7: a, b, c and log2(opacity),
    - 8 to 10: red, green and blue,
    - 11 to 14: the box in tiles, as int32: from x, to x, from y, to y.

    Then alpha = exp2(log2(opacity) - u^2 - v^2). A pixel to the right adds a to u. A pixel below adds b to u and c to
    v. So a, b and c are a triangular root of the inverse covariance. It keeps digits that the quadratic form of a
    needle loses. Since u and v count from a pixel of the image, they also keep digits if the centre is far away.
    """
    mean, quaternion, scale, opacity, colour = inputs
    n = mean.shape[0]
    record, room = np.empty((n, 16), np.float32), np.empty(n, np.int32)
    depth, radius = np.empty(n, np.float64), np.empty(n, np.float32)
    box = record.view(np.int32)
    k = math.sqrt(_K2)
    for i in prange(n):
        room[i], radius[i] = 0, 0
        # SPEC 14.5: with an opacity below 1/255 every alpha counts as 0.
        if not (opacity[i] >= LEAST and opacity[i] < _OPACITY_MAX):
            continue
        if not (math.isfinite(colour[i, 0]) and math.isfinite(colour[i, 1]) and math.isfinite(colour[i, 2])):
            continue
        log_opacity = math.log2(np.float64(opacity[i]))
        world = _rows_of(view)
        p = _camera_space(i, mean, world)
        # SPEC 14.4: a Gaussian at depth near_plane or less is not drawn.
        if not (p[2] > near_plane and p[2] < math.inf):
            continue
        _, _, _, _, _, along_x, along_y = _axes(i, p, quaternion, world, lens)
        s = _row3(scale, i)
        # SPEC 14.4: to_x and to_y are the rows of `half` in PROJECT. The covariance has their products as entries.
        to_x, to_y = _scaled(s, along_x), _scaled(s, along_y)
        x2, y2, xy = _dot(to_x, to_x), _dot(to_y, to_y), _dot(to_x, to_y)
        cross = (
            to_x[1] * to_y[2] - to_x[2] * to_y[1],
            to_x[2] * to_y[0] - to_x[0] * to_y[2],
            to_x[0] * to_y[1] - to_x[1] * to_y[0],
        )
        # The root of d in PROJECT, by Lagrange's identity. It takes no difference of large products, so that needles
        # keep their width.
        root = math.sqrt(_dot(cross, cross) + low_pass * (x2 + y2) + low_pass * low_pass)
        width_x, width_y = math.sqrt(x2 + low_pass), math.sqrt(y2 + low_pass)
        a, b, c = k * width_y / root, -k * xy / (width_y * root), k / width_y
        x, y = lens[0] * p[0] / p[2] + lens[2], lens[1] * p[1] / p[2] + lens[3]
        # The root is infinite if the determinant of the covariance overflows. The condition also fails for NaN.
        if not (root < math.inf and max(a, c) < _STEEPEST and abs(b) < _STEEPEST and abs(x) + abs(y) < math.inf):
            continue
        reach = math.sqrt(max(log_opacity - LOG2_MIN, 0.0)) / k
        reach_x, reach_y = reach * width_x, reach * width_y
        # The pixels whose centres are in the box of the ellipse. They are compared as floats, since an integer may not
        # hold a far edge.
        left, right = max(x - reach_x - 0.5 - SLACK, 0.0), min(x + reach_x - 0.5 + SLACK, width - 1.0)
        top, bottom = max(y - reach_y - 0.5 - SLACK, 0.0), min(y + reach_y - 0.5 + SLACK, height - 1.0)
        if not (left <= right and top <= bottom):
            continue
        x_from, x_to, y_from, y_to = math.ceil(left), math.floor(right), math.ceil(top), math.floor(bottom)
        if x_from > x_to or y_from > y_to:
            continue
        box[i, 11], box[i, 12] = x_from // TILE_WIDTH, x_to // TILE_WIDTH + 1
        box[i, 13], box[i, 14] = y_from // TILE_HEIGHT, y_to // TILE_HEIGHT + 1
        room[i] = (box[i, 12] - box[i, 11]) * (box[i, 14] - box[i, 13])
        # SPEC 14.2: the centres of pixels are at halves.
        column, row = math.floor(min(max(x, 0.0), width - 1.0)), math.floor(min(max(y, 0.0), height - 1.0))
        dx, dy = column + 0.5 - x, row + 0.5 - y
        record[i, 0], record[i, 1], record[i, 2], record[i, 3] = column, row, a * dx + b * dy, c * dy
        record[i, 4], record[i, 5], record[i, 6], record[i, 7] = max(a, _FLATTEST), b, max(c, _FLATTEST), log_opacity
        record[i, 8], record[i, 9], record[i, 10] = colour[i, 0], colour[i, 1], colour[i, 2]
        depth[i] = p[2]
        middle, apart = (x2 + y2) / 2, (x2 - y2) / 2
        radius[i] = reach * math.sqrt(low_pass + middle + math.sqrt(apart * apart + xy * xy))
    return record, room, depth, radius


@compiled(parallel=True)
def unproject_gaussians(
    sums: F32, record: F32, pairs: Pairs, inputs: Any, view: Any, lens: Any, width: int, height: int
) -> Any:
    """Adds up the gradients of the pairs of each Gaussian, and takes them back through the projection.

    Returns the arrays of Gradients, in their order. sums: as unblend_tiles gives them. record, inputs: those of
    project_gaussians.
    """
    (begin, count, place, _, _), (mean, quaternion, scale, opacity, _) = pairs, inputs
    n = mean.shape[0]
    d_mean, d_quaternion = np.empty((n, 3), np.float32), np.empty((n, 4), np.float32)
    d_scale, d_colour = np.empty((n, 3), np.float32), np.empty((n, 3), np.float32)
    d_opacity, screen = np.empty(n, np.float32), np.empty(n, np.float32)
    fx, fy, _, _, x_low, x_high, y_low, y_high = lens
    for i in prange(n):
        if count[i] == 0:
            for j in range(3):
                d_mean[i, j], d_quaternion[i, j], d_scale[i, j], d_colour[i, j] = 0, 0, 0, 0
            d_quaternion[i, 3], d_opacity[i], screen[i] = 0, 0, 0
            continue
        s_1, s_u, s_v, s_uu, s_uv, s_vv, s_red, s_green, s_blue = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for p in range(begin[i], begin[i] + count[i]):
            at = place[p] * SUMS
            s_1 += sums[at]
            s_u += sums[at + 1]
            s_v += sums[at + 2]
            s_uu += sums[at + 3]
            s_uv += sums[at + 4]
            s_vv += sums[at + 5]
            s_red += sums[at + 6]
            s_green += sums[at + 7]
            s_blue += sums[at + 8]
        d_colour[i, 0], d_colour[i, 1], d_colour[i, 2] = s_red, s_green, s_blue
        d_opacity[i] = s_1 / opacity[i]
        # alpha = opacity * exp(-(u^2 + v^2) / (2 K^2)), where (u, v) is A times the offset from the centre. A has the
        # rows (a, b) and (0, c). So the gradient of the centre is A^T s / K^2, and that of the covariance is
        # A^T S A / (2 K^4). d_xy is the sum of the gradients of the two entries xy.
        a, b, c = np.float64(record[i, 4]) / _K2, np.float64(record[i, 5]) / _K2, np.float64(record[i, 6]) / _K2
        d_x, d_y = a * s_u, b * s_u + c * s_v
        screen[i] = math.sqrt((d_x * width) ** 2 + (d_y * height) ** 2) / 2
        twice_xx = a * a * s_uu
        d_xy = a * (b * s_uu + c * s_uv)
        twice_yy = b * b * s_uu + 2 * b * c * s_uv + c * c * s_vv
        world = _rows_of(view)
        q = _camera_space(i, mean, world)
        row_x, row_y, unit, shrink, columns, along_x, along_y = _axes(i, q, quaternion, world, lens)
        # The entries of the covariance are products of to_x and to_y. These are along_x and along_y times the scale,
        # and along_x and along_y are row_x and row_y times the columns.
        s = _row3(scale, i)
        to_x, to_y = _scaled(s, along_x), _scaled(s, along_y)
        d_to_x = _combine((twice_xx, d_xy, 0.0), (to_x, to_y, to_y))
        d_to_y = _combine((d_xy, twice_yy, 0.0), (to_x, to_y, to_y))
        d_scale[i, 0] = d_to_x[0] * along_x[0] + d_to_y[0] * along_y[0]
        d_scale[i, 1] = d_to_x[1] * along_x[1] + d_to_y[1] * along_y[1]
        d_scale[i, 2] = d_to_x[2] * along_x[2] + d_to_y[2] * along_y[2]
        d_x_axes, d_y_axes = _scaled(d_to_x, s), _scaled(d_to_y, s)
        # r0, r1 and r2 are the columns of the gradient of R.
        r0 = _combine((d_x_axes[0], d_y_axes[0], 0.0), (row_x, row_y, row_y))
        r1 = _combine((d_x_axes[1], d_y_axes[1], 0.0), (row_x, row_y, row_y))
        r2 = _combine((d_x_axes[2], d_y_axes[2], 0.0), (row_x, row_y, row_y))
        w, x, y, z = unit
        d_w = 2 * (x * (r1[2] - r2[1]) + y * (r2[0] - r0[2]) + z * (r0[1] - r1[0]))
        d_i = 2 * (y * (r1[0] + r0[1]) + z * (r2[0] + r0[2]) + w * (r1[2] - r2[1]) - 2 * x * (r1[1] + r2[2]))
        d_j = 2 * (x * (r1[0] + r0[1]) + z * (r2[1] + r1[2]) + w * (r2[0] - r0[2]) - 2 * y * (r0[0] + r2[2]))
        d_k = 2 * (x * (r2[0] + r0[2]) + y * (r2[1] + r1[2]) + w * (r0[1] - r1[0]) - 2 * z * (r0[0] + r1[1]))
        # The part that lengthens the quaternion is taken out, since only its direction counts.
        radial = w * d_w + x * d_i + y * d_j + z * d_k
        d_quaternion[i, 0], d_quaternion[i, 1] = (d_w - w * radial) * shrink, (d_i - x * radial) * shrink
        d_quaternion[i, 2], d_quaternion[i, 3] = (d_j - y * radial) * shrink, (d_k - z * radial) * shrink
        d_row_x, d_row_y = _combine(d_x_axes, columns), _combine(d_y_axes, columns)
        near = 1 / q[2]
        # A slope that was limited is a constant.
        d_slope_x = -fx * near * _dot(d_row_x, world[2]) if x_low <= q[0] * near <= x_high else 0.0
        d_slope_y = -fy * near * _dot(d_row_y, world[2]) if y_low <= q[1] * near <= y_high else 0.0
        d_q = (near * (fx * d_x + d_slope_x), near * (fy * d_y + d_slope_y), 0.0)
        depth_gradient = -near * (_dot(d_row_x, row_x) + _dot(d_row_y, row_y) + _dot(q, d_q))
        d = _combine((d_q[0], d_q[1], depth_gradient), world)
        d_mean[i, 0], d_mean[i, 1], d_mean[i, 2] = d
    return d_mean, d_quaternion, d_scale, d_opacity, d_colour, screen


def view_of(camera: Camera) -> tuple[float, ...]:
    """Returns the rows of the rotation and the translation, as one flat tuple of 12.

    numba would count references to the rows of an array.
    """
    return (*camera.rotation.ravel().tolist(), *camera.translation.tolist())


def lens_of(camera: Camera) -> tuple[float, ...]:
    """Returns fx, fy, cx, cy, and the limits of the slopes: least x / z, largest x / z, least y / z, largest y / z.

    The projection's derivative is taken within these limits (SPEC 14.4).
    """
    beyond_x, beyond_y = BEYOND * camera.width / camera.fx, BEYOND * camera.height / camera.fy
    slopes_x = -camera.cx / camera.fx - beyond_x, (camera.width - camera.cx) / camera.fx + beyond_x
    slopes_y = -camera.cy / camera.fy - beyond_y, (camera.height - camera.cy) / camera.fy + beyond_y
    return float(camera.fx), float(camera.fy), float(camera.cx), float(camera.cy), *slopes_x, *slopes_y
