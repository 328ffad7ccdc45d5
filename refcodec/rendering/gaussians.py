"""Clauses 14.3 and 14.6: from a view-dependent or static scene and a camera to Gaussians, in floating point."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from ..bitstream.dimensions import RENDER_MODELS, RENDERING, STATIC
from ..bitstream.header import RenderInfo
from ..bitstream.networks import Layer
from ..bitstream.reconstruction import Reconstruction, reconstruct, splat_to
from ..bitstream.scene import Scene
from ..formats.harmonics import harmonics
from ..formats.splats import Splats
from ..statuses import UsageError
from .camera import Camera

# SPEC 6.5: the render model of 14.3.
VIEW_DEPENDENT = 0
# Gaussians of a block.
BLOCK = 1 << 12


@dataclass(frozen=True, eq=False)
class Gaussians:
    """The n Gaussians of a view. All arrays but the last two have one floating-point dtype.

    mean: [n, 3], world units.
    lengths: [n, 3], of the axes, world units.
    quaternion: [n, 4], w, x, y, z, of length 1.
    opacity: [n].
    colour: [n, 3].
    anchor, offset: int64 [n], the anchor and the offset that each comes from.
    """

    mean: NDArray[Any]
    lengths: NDArray[Any]
    quaternion: NDArray[Any]
    opacity: NDArray[Any]
    colour: NDArray[Any]
    anchor: NDArray[np.int64]
    offset: NDArray[np.int64]


class RenderModelError(UsageError, ValueError):
    """A scene of a render model that is not known. It can be decoded, but not drawn."""


# SPEC [G6.5-1]
def check_render_model(info: RenderInfo) -> None:
    """Raises RenderModelError for a scene whose render model is not known."""
    if info.render_model not in RENDER_MODELS:
        raise RenderModelError(
            f"the scene has render_model {info.render_model}, but this version draws only 0 and 1; "
            "use a later version (SPEC.md 6.5)"
        )


def check_view_dependent(info: RenderInfo) -> None:
    """Raises RenderModelError for a scene whose rendering networks do not read the view, such as a static scene."""
    if info.render_model != VIEW_DEPENDENT:
        raise RenderModelError(
            f"the scene has render_model {info.render_model}, but must have {VIEW_DEPENDENT}, view-dependent; "
            "this command does not take other scenes (SPEC.md 6.5)"
        )


def check_static(info: RenderInfo) -> None:
    """Raises RenderModelError for a scene that is not static, and thus has no plain Gaussians."""
    check_render_model(info)
    if info.render_model != STATIC:
        raise RenderModelError(
            "the scene is not static, because its Gaussians depend on the view: `refcodec export FILE -o OUTPUT` fits "
            "plain Gaussians to its views (SPEC.md 6.5)"
        )


def _network(layers: list[Layer], values: NDArray[Any]) -> NDArray[Any]:
    """SPEC 14.3, RENDER_NETWORK."""
    for number, (weight, bias) in enumerate(layers):
        values = values @ weight.T.astype(values.dtype) + bias.astype(values.dtype)
        if number < len(layers) - 1:
            values = np.maximum(values, 0)
    return values


def _logistic(x: NDArray[Any]) -> NDArray[Any]:
    """Returns 1 / (1 + exp(-x)), without overflow."""
    tail = np.exp(-np.abs(x))
    return np.where(x >= 0, 1 / (1 + tail), tail / (1 + tail))


# A file may hold any finite numbers. A Gaussian with a value that overflows is not drawn.
@np.errstate(over="ignore", invalid="ignore")
def gaussians(
    values: Reconstruction,
    masks: NDArray[np.bool_],
    networks: dict[str, list[Layer]],
    camera: Camera,
    distance_unit: float,
    dtype: DTypeLike = np.float32,
) -> Gaussians:
    """SPEC 14.3, GAUSSIANS: returns the Gaussians of all anchors for a camera, in the order of anchors and offsets.

    They need not be in the camera's view. masks: bool [N, K]. networks: the rendering networks, by name. distance_unit:
    world units. dtype: that of the computation and of the result.
    """
    count, k = masks.shape
    # The difference is taken in float64, because far from the origin it would lose digits in float32.
    away = (values.positions.astype(np.float64) - camera.centre).astype(dtype)
    distance = np.linalg.norm(away, axis=1, keepdims=True)
    direction = np.divide(away, distance, out=np.zeros_like(away), where=distance > 0)
    inputs = np.concatenate(
        [values.features.astype(dtype), direction, distance / np.asarray(distance_unit, dtype)], axis=1
    )
    opacity, covariance, colour = (_network(networks[name], inputs) for name in RENDERING)
    opacity = np.tanh(opacity)
    anchor, offset = np.nonzero(masks & (opacity > 0))
    chosen = covariance.reshape(count, k, 7)[anchor, offset]
    lengths = np.exp(values.scalings.astype(dtype))
    quaternion = chosen[:, 3:]
    # The quaternion is scaled first, because squares of small components vanish.
    quaternion = quaternion / np.maximum(np.abs(quaternion).max(axis=1, keepdims=True), np.finfo(dtype).tiny)
    norm = np.linalg.norm(quaternion, axis=1, keepdims=True)
    unit = np.array([1, 0, 0, 0], dtype)
    return Gaussians(
        values.positions.astype(dtype)[anchor] + values.offsets.astype(dtype)[anchor, offset] * lengths[anchor, :3],
        lengths[anchor, 3:] * _logistic(chosen[:, :3]),
        np.where(norm > 0, np.divide(quaternion, norm, where=norm > 0, out=np.zeros_like(quaternion)), unit),
        opacity[anchor, offset],
        _logistic(colour.reshape(count, k, 3)[anchor, offset]),
        anchor,
        offset,
    )


def gaussians_of(scene: Scene, camera: Camera, values: Reconstruction | None = None) -> Gaussians:
    """Returns the Gaussians of a scene for a camera (SPEC 14.3, 14.6). values: those of the scene, if known.

    Raises RenderModelError.
    """
    check_render_model(scene.render)
    if scene.render.render_model == STATIC:
        return static_gaussians(static_splats(scene), scene.masks, camera)
    known = reconstruct(scene) if values is None else values
    return gaussians(known, scene.masks, scene.networks, camera, scene.render.distance_unit)


# SPEC 9.4
def static_splats(scene: Scene) -> Splats:
    """Returns the Gaussians of a static scene, exactly as it decodes, in the order of anchors and offsets.

    Raises RenderModelError for another scene.
    """
    check_static(scene.render)
    n, widths = np.count_nonzero(scene.masks), (3, 3, 4, 1, scene.dimensions.colour_outputs)
    mean, scale, quaternion, logit, harmonic = arrays = [np.empty((n, width), np.float32) for width in widths]
    splat_to(scene, arrays)
    coefficients = harmonic.reshape(n, widths[-1] // 3, 3)
    return Splats(mean, coefficients[:, 0], coefficients[:, 1:], logit[:, 0], scale, quaternion)


@np.errstate(over="ignore", invalid="ignore")
def static_gaussians(
    splats: Splats, masks: NDArray[np.bool_], camera: Camera, dtype: DTypeLike = np.float32
) -> Gaussians:
    """SPEC 14.6, STATIC_GAUSSIAN: returns the Gaussians of a static scene for a camera, in the order of 9.4.

    splats: its Gaussians. masks: bool [N, K]. dtype: as for gaussians.
    """
    mean, quaternion, lengths, opacity = static_shapes(splats, dtype)
    colour = static_colours(splats, camera, np.arange(len(mean))).astype(dtype)
    return Gaussians(mean, lengths, quaternion, opacity, colour, *np.nonzero(masks))


@np.errstate(over="ignore", invalid="ignore")
def static_shapes(splats: Splats, dtype: DTypeLike = np.float32) -> tuple[NDArray[Any], ...]:
    """SPEC 14.6: returns what no camera changes: means, unit quaternions, lengths of axes and opacities, as Gaussians.

    dtype: as for gaussians.
    """
    quaternion = splats.quaternion.astype(dtype)
    return (
        splats.mean.astype(dtype),
        quaternion / np.linalg.norm(quaternion, axis=1, keepdims=True),
        np.exp(splats.scale.astype(dtype)),
        _logistic(splats.opacity.astype(dtype)),
    )


@np.errstate(over="ignore", invalid="ignore")
def static_colours(splats: Splats, camera: Camera, rows: NDArray[np.int64]) -> NDArray[np.float64]:
    """SPEC 14.6: returns the colours of some Gaussians for a camera, [n, 3]. rows: int64 [n]."""
    colour = np.empty((len(rows), 3))
    # The temporary arrays of a block stay in the cache.
    for begin in range(0, len(rows), BLOCK):
        part = rows[begin : begin + BLOCK]
        coefficients = np.concatenate([splats.base[part, None], splats.rest[part]], axis=1, dtype=np.float64)
        values = harmonics(splats.mean[part], camera.centre, splats.degree)
        colour[begin : begin + BLOCK] = np.maximum(0.5 + (values[:, None] @ coefficients)[:, 0], 0)
    return colour


def gaussians_document(gaussians: Gaussians) -> dict[str, Any]:
    """Returns Gaussians as JSON values (vectors/README.md). SPEC 14.4: those that are not finite are left out."""
    kinds = ("anchor", "offset", "mean", "lengths", "quaternion", "opacity", "colour")
    columns = [getattr(gaussians, kind) for kind in kinds]
    finite = np.all([np.isfinite(column).all(axis=tuple(range(1, column.ndim))) for column in columns], axis=0)
    columns = [column[finite].tolist() for column in columns]
    return {"gaussians": [dict(zip(kinds, row, strict=True)) for row in zip(*columns, strict=True)]}
