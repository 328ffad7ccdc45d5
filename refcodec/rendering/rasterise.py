"""Images of Gaussians on the CPU, and their gradients (SPEC.md 14.4 and 14.5), with numba and without torch.

The rasteriser is of the kind of Kerbl et al., "3D Gaussian Splatting for Real-Time Radiance Field Rendering" (2023).
Its projection is that of Zwicker et al., "EWA Splatting" (2002). `image` draws the Gaussians of a file. `rasterise`
draws any arrays and keeps what `rasterise_backward` needs.

The projection computes in float64 and the blending in float32. The results are the same bits whatever the number of
threads, because one thread blends a tile and every sum has one order. The number of threads is numba's
(numba.set_num_threads, NUMBA_NUM_THREADS). Numbers of any size are allowed. A Gaussian is not drawn if one of its
values is not finite, or if its projection leaves float64.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from numba import parallel_chunksize
from numpy.typing import ArrayLike

from ..bitstream.header import RenderInfo
from ..formats.splats import Splats
from .blending import blend_tiles, unblend_tiles
from .camera import Camera, check_camera
from .constants import F32, I64, TILE_HEIGHT, TILE_WIDTH
from .gaussians import Gaussians, static_colours, static_shapes
from .projection import lens_of, project_gaussians, unproject_gaussians, view_of
from .tiles import LIST_MAX, PAIRS_MAX, Pairs, list_tiles, sort_by_depth

# The columns of a record that hold colours.
SHADE = slice(8, 11)


@dataclass(frozen=True)
class Settings:
    """Render settings of a file (SPEC 6.5). The defaults are the values of the original 3DGS.

    low_pass: square pixels, added to both variances.
    near_plane: the depth in world units up to which nothing is drawn.
    alpha_max: the largest alpha.
    background: red, green and blue, 1 for white.

    Raises ValueError for values that SPEC R6.5-1 excludes, and for another number of background values than three.
    """

    low_pass: float = 0.3
    near_plane: float = 0.2
    alpha_max: float = 0.99
    background: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        if not (0 <= self.low_pass < math.inf and 0 < self.near_plane < math.inf and 0 < self.alpha_max <= 1):
            raise ValueError(
                f"low_pass {self.low_pass}, near_plane {self.near_plane}, alpha_max {self.alpha_max}: "
                "at least 0, above 0 and in ]0, 1] required"
            )
        if len(self.background) != 3:
            raise ValueError(f"{len(self.background)} background values, not 3")


@dataclass(frozen=True, eq=False)
class _Tape:
    """The record for the backward pass: the inputs, and the lists of the forward pass."""

    inputs: tuple[F32, F32, F32, F32, F32]
    camera: Camera
    settings: Settings
    # f32[N,16], as project_gaussians gives it.
    record: F32
    pairs: Pairs
    # f32[H,W]: for each pixel the place of its last drawn Gaussian in the list of the tile, or -1.
    last: F32


@dataclass(frozen=True, eq=False)
class Rendering:
    """A drawn image.

    image: f32[H,W,3], with the background.
    transmittance: f32[H,W], the share of the background in each pixel.
    radius: f32[N], pixels. It is the larger half axis of the ellipse in which alpha is at least 1/255.

    The radius is 0 for a Gaussian that is not drawn:

    - It is behind the near plane, or outside the image.
    - Its opacity is below 1/255, or 2^126 or more.
    - One of its values is not finite.
    """

    image: F32
    transmittance: F32
    radius: F32
    tape: _Tape = field(repr=False)


@dataclass(frozen=True, eq=False)
class Gradients:
    """The gradients of a loss L with respect to the inputs. They are f32 and have the shapes of the inputs.

    quaternion: with respect to the given quaternion, not to the normalised one.
    screen: f32[N], the measure of densification. It is the length of the gradient of the projected mean in normalised
    device units, |(dL/dx * width / 2, dL/dy * height / 2)| with x and y in pixels. 3DGS grows where its mean over the
    views is above 0.0002.

    All are 0 for a Gaussian that is not drawn.
    """

    mean: F32
    quaternion: F32
    scale: F32
    opacity: F32
    colour: F32
    screen: F32


# A number that float32 cannot hold becomes infinite, and its Gaussian is not drawn.
@np.errstate(over="ignore")
def _inputs(*values: ArrayLike) -> tuple[F32, F32, F32, F32, F32]:
    mean, quaternion, scale, opacity, colour = (np.ascontiguousarray(v, dtype=np.float32) for v in values)
    n = len(opacity) if opacity.ndim == 1 else -1
    shapes = {"mean": (n, 3), "quaternion": (n, 4), "scale": (n, 3), "opacity": (n,), "colour": (n, 3)}
    for (name, shape), value in zip(shapes.items(), (mean, quaternion, scale, opacity, colour), strict=True):
        if value.shape != shape:
            raise ValueError(
                f"{name}: shape {value.shape}, not {shape}; N is the length of opacity, which has one dimension"
            )
    return mean, quaternion, scale, opacity, colour


def rasterise(
    mean: ArrayLike,
    quaternion: ArrayLike,
    scale: ArrayLike,
    opacity: ArrayLike,
    colour: ArrayLike | Callable[[I64], ArrayLike],
    camera: Camera,
    settings: Settings | None = None,
) -> Rendering:
    """Draws N Gaussians. Arrays of other dtypes than float32 are cast.

    mean: f32[N,3].
    quaternion: f32[N,4], w, x, y, z, of any length but 0.
    scale: f32[N,3], standard deviations along the axes, in the unit of mean.
    opacity: f32[N].
    colour: f32[N,3], or a function that returns those of some Gaussians, f32[n,3], by their numbers, i64[n].
    settings: None for Settings().

    Raises ValueError for other shapes, for a camera that check_camera refuses, and for 2^27 or more pairs of a Gaussian
    and a tile that it may touch. The rendering keeps the inputs for rasterise_backward. It does not copy contiguous
    float32 arrays, so they must not be changed before that.
    """
    check_camera(camera)
    settings = settings or Settings()
    inputs = _inputs(mean, quaternion, scale, opacity, np.zeros(np.shape(mean)) if callable(colour) else colour)
    width, height = int(camera.width), int(camera.height)
    record, room, depth, radius = project_gaussians(
        inputs, view_of(camera), lens_of(camera), width, height, float(settings.low_pass), float(settings.near_plane)
    )
    if callable(colour):
        chosen = np.flatnonzero(room)
        record[chosen, SHADE] = colour(chosen)
        strange = chosen[~np.isfinite(record[chosen, SHADE] @ np.ones(3))]
        room[strange], radius[strange] = 0, 0
    count = int(room.sum(dtype=np.int64))
    if count >= PAIRS_MAX:
        raise ValueError(f"{count} pairs of Gaussians and tiles; fewer than {PAIRS_MAX} allowed")
    columns, rows = -(-width // TILE_WIDTH), -(-height // TILE_HEIGHT)
    pairs = Pairs(*list_tiles(sort_by_depth(depth, room), record, room, columns, rows))
    background = np.array(settings.background, np.float32)
    with parallel_chunksize(1):
        image, transmittance, last = blend_tiles(
            record, pairs, width, height, np.float32(settings.alpha_max), background
        )
    tape = _Tape(inputs, camera, settings, record, pairs, last)
    return Rendering(image, transmittance, radius, tape)


def rasterise_backward(
    rendering: Rendering, grad_image: ArrayLike, grad_transmittance: ArrayLike | None = None
) -> Gradients:
    """Returns the gradients of a loss with respect to the inputs of a rendering.

    grad_image: f32[H,W,3], the gradient with respect to the image.
    grad_transmittance: f32[H,W], that with respect to the transmittance, or None for zeros.

    The gradients are exact where the image is smooth. Which alphas are below 1/255, where pixels are finished, and the
    order of depths are taken as constant. Raises ValueError for other shapes, and if 2^24 or more Gaussians meet one
    tile.
    """
    tape, shape = rendering.tape, rendering.transmittance.shape
    grad_image = np.ascontiguousarray(grad_image, dtype=np.float32)
    given = np.zeros(shape, np.float32) if grad_transmittance is None else grad_transmittance
    grad_transmittance = np.ascontiguousarray(given, np.float32)
    if grad_image.shape != (*shape, 3) or grad_transmittance.shape != shape:
        raise ValueError(
            f"gradients of shapes {grad_image.shape} and {grad_transmittance.shape} for an image of {shape}"
        )
    crowd = int(np.diff(tape.pairs.tile_begin).max())
    if crowd >= LIST_MAX:
        raise ValueError(f"{crowd} Gaussians meet one tile; fewer than {LIST_MAX} allowed")
    camera, settings = tape.camera, tape.settings
    alpha_max, background = np.float32(settings.alpha_max), np.array(settings.background, np.float32)
    drawn, along = (rendering.transmittance, tape.last), (grad_image, grad_transmittance)
    with parallel_chunksize(1):
        sums = unblend_tiles(tape.record, tape.pairs, drawn, alpha_max, background, along)
    seen = view_of(camera), lens_of(camera), camera.width, camera.height
    return Gradients(*unproject_gaussians(sums, tape.record, tape.pairs, tape.inputs, *seen))


def settings_of(info: RenderInfo) -> Settings:
    """Returns the render settings of a scene (SPEC 6.5)."""
    red, green, blue = (value / 255 for value in info.background)
    return Settings(info.low_pass, info.near_plane, info.alpha_max, (red, green, blue))


def draw(splats: Splats, camera: Camera, settings: Settings, shapes: Sequence[F32] | None = None) -> Rendering:
    """Draws plain Gaussians, as 3DGS programs do. Raises ValueError as rasterise.

    shapes: static_shapes of them, if known.
    """
    mean, quaternion, lengths, opacity = shapes or static_shapes(splats)
    return rasterise(mean, quaternion, lengths, opacity, partial(static_colours, splats, camera), camera, settings)


def image(g: Gaussians, camera: Camera, info: RenderInfo) -> F32:
    """SPEC 14.5: returns the image of a camera, f32[H,W,3], 1 for white. Raises ValueError as rasterise."""
    made = rasterise(g.mean, g.quaternion, g.lengths, g.opacity, g.colour, camera, settings_of(info)).image
    # SPEC 14.6: harmonics can give colours above 1.
    return np.minimum(made, np.float32(1))
