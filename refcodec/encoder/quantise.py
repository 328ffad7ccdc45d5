"""SPEC.md B.7: converts float attributes, with given networks, to a scene of integers."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..bitstream.attributes import ATTRIBUTE_SYMBOL_MAX, KINDS, Attributes, zero_attributes
from ..bitstream.cameras import NamedCamera, camera_sections
from ..bitstream.codec import derive_steps
from ..bitstream.conventions import F32, Int64
from ..bitstream.dimensions import Dimensions
from ..bitstream.frame import Frame
from ..bitstream.header import Lanes, PositionGrid, RenderInfo
from ..bitstream.limits import MAIN
from ..bitstream.networks import ACTIVATION_MAX, Layer
from ..bitstream.scene import Scene
from ..bitstream.tables import STEP_SHIFT, tables
from .cloud import AnchorCloud
from .masks import mask_model
from .positions import morton_order, pack_positions, to_fp16
from .sizes import CHUNK_SIZE, choose_lanes
from .weights import pack_weights

# A feature is constant if its deviation is below this share of the largest one.
VARYING = 1e-5

# Anchors of a block.
BLOCK = 1 << 16


def packed(scene: Scene, positions: str | None, weights: str | None, layers: Int64 | None = None) -> Scene:
    """Returns the scene with positions and weights in the wanted modes.

    positions, weights: "raw" for mode 0, "packed" for mode 1. None packs them in Main, and keeps their mode in Tiny.
    Packed ones are not packed again. layers: as for pack_positions.
    """
    if positions == "raw":
        scene = replace(scene, position_model=None, position_forms=None)
    elif scene.position_model is None and (positions or scene.profile == MAIN):
        scene = pack_positions(scene, layers)
    if weights == "raw":
        return replace(scene, weight_scales=None, weight_forms=None)
    if scene.weight_scales is None and (weights or scene.profile == MAIN):
        return pack_weights(scene)
    return scene


def carm_shifts(features: NDArray[np.int32], inputs: int) -> NDArray[np.uint8]:
    """Returns for each input of CARM the smallest shift that brings its symbols within an activation (SPEC 7.9).

    features: int32 [N, F], symbols. inputs: the number of inputs. The result is uint8 [inputs].
    """
    largest = np.abs(features[:, :inputs]).max(axis=0, initial=0)
    shift = [max(int(v) // (ACTIVATION_MAX + 1), 0).bit_length() for v in largest]
    return np.array(shift, dtype=np.uint8)


def varying(deviations: NDArray[np.floating]) -> NDArray[np.floating]:
    """Returns the deviations of features, [F], without those of constant features (SPEC B.5).

    If most features of a scene are constant, the median of all deviations would give a base step of 0.
    """
    return deviations[deviations >= VARYING * deviations.max(initial=0)]


def symbols(values: F32, steps: NDArray[np.uint8], base_step: float) -> NDArray[np.int32]:
    """SPEC B.7: returns the symbols nearest to values, int32 [n, ...].

    values: float32 [n, ...]. steps: uint8 [n], the step index of each anchor. base_step: the step at index 32. Raises
    ValueError for a value that is not finite or has too large a symbol.
    """
    unit = base_step * tables().step[steps].astype(np.float64) / (1 << STEP_SHIFT)
    unit = unit.reshape(-1, *[1] * (values.ndim - 1))
    limit, rounded = ATTRIBUTE_SYMBOL_MAX, np.empty(values.shape, np.int32)
    # Blocks, so that large scenes have no copy in float64.
    for begin in range(0, len(values), BLOCK):
        rows = slice(begin, begin + BLOCK)
        scaled = np.rint(values[rows].astype(np.float64) / unit[rows])
        if not np.isfinite(scaled).all() or np.abs(scaled).max(initial=0) > limit:
            raise ValueError(f"an attribute is not finite, or more than {limit} steps from zero")
        rounded[rows] = scaled
    return rounded


def order_anchors(cloud: AnchorCloud, grid: PositionGrid) -> tuple[AnchorCloud, NDArray[np.float16]]:
    """SPEC B.1 and B.6: returns the anchors that keep an offset, along a Morton curve, and their positions.

    The positions are float16 [n, 3]. Masked offsets become 0. Raises ValueError if fp16 cannot hold a position.
    """
    kept = np.flatnonzero(cloud.masks.any(axis=1))
    half = to_fp16(cloud.positions[kept], grid)
    order = morton_order(half)
    chosen = kept[order]
    offsets = np.where(cloud.masks[chosen][:, :, None], cloud.offsets[chosen], np.float32(0))
    ordered = AnchorCloud(
        cloud.positions[chosen], cloud.features[chosen], cloud.scalings[chosen], offsets, cloud.masks[chosen]
    )
    return ordered, half[order]


def quantise(
    cloud: AnchorCloud,
    *,
    dimensions: Dimensions,
    networks: Mapping[str, list[Layer]],
    frame: Frame | None,
    grid: PositionGrid,
    planes: NDArray[np.int16],
    plane_shift: int,
    carm_shift: NDArray[np.uint8],
    base_step: tuple[float, float, float],
    render: RenderInfo | None = None,
    cameras: Sequence[NamedCamera] = (),
    lanes: Lanes | None = None,
    profile: int = MAIN,
    chunk_size: int = CHUNK_SIZE,
) -> Scene:
    """Returns a scene from float attributes and given networks and planes (SPEC B).

    The networks determine the step indices, and the steps the symbols. Anchors that keep no offset are dropped. The
    others are sorted. Positions and weights are in mode 0.

    planes: int16 [5, ch, B, B]. carm_shift: uint8 [CARM inputs]. base_step: float32 values of features, scalings and
    offsets. render, lanes: None for the defaults. cameras: of the scene. Raises ValueError for a value that a file
    cannot hold.
    """
    ordered, positions = order_anchors(cloud, grid)
    count = len(positions)
    scene = Scene(
        profile=profile,
        dimensions=dimensions,
        chunk_size=chunk_size,
        lanes=lanes or choose_lanes(count, 2.0 * dimensions.attribute_width),
        base_step=base_step,
        grid=grid,
        render=render or RenderInfo(),
        frame=frame,
        plane_shift=plane_shift,
        carm_shift=carm_shift,
        networks=dict(networks),
        planes=planes,
        mask_model=mask_model(ordered.masks),
        positions=positions,
        masks=ordered.masks,
        attributes=zero_attributes(dimensions, count),
        ancillary=camera_sections(cameras),
    )
    steps = derive_steps(scene)
    features, scalings, offsets = (
        symbols(getattr(ordered, kind), steps[:, i], base_step[i]) for i, kind in enumerate(KINDS)
    )
    return replace(scene, attributes=Attributes(features, scalings, offsets, steps))
