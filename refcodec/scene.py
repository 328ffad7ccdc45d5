"""The scene: what a bitstream says, as one dataclass of numpy arrays (SPEC.md chapters 3 and 6).

Everything that decides a symbol is an integer here; float values are made from it by refcodec.reconstruction.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from .attributes import SCALINGS, Attributes
from .geometry import Frame
from .networks import Layer
from .positions import PositionModel


@dataclass(frozen=True)
class Dimensions:
    """SPEC 6.3, in its names: K, the feature slices, ch, L, B and the hidden widths of each network."""

    offset_count: int
    slices: tuple[int, ...]
    plane_channels: int
    frequency_count: int
    plane_size: int
    hyper_width: tuple[int, ...]
    sarm_width: tuple[int, ...]
    carm_width: tuple[int, ...]
    render_width: int

    @property
    def features(self) -> int:
        """F, the feature channels of an anchor."""
        return sum(self.slices)

    @property
    def attribute_width(self) -> int:
        """D = F + 6 + 3 K, the attribute channels of an anchor."""
        return self.features + SCALINGS + 3 * self.offset_count

    @property
    def carm_inputs(self) -> int:
        """Feature channels that CARM reads: all but the last slice."""
        return self.features - self.slices[-1]

    def network_shapes(self) -> dict[str, list[tuple[int, int]]]:
        """SPEC 5.8: for each network, in file order, the (out, in) of its layers."""

        def mlp(widths: list[int]) -> list[tuple[int, int]]:
            return [(out, fan_in) for fan_in, out in pairwise(widths)]

        shapes = {
            "hyper": mlp([2 * self.plane_channels + 2 * self.frequency_count, *self.hyper_width, 2 * self.attribute_width + 3]),
            "sarm": mlp([4, *self.sarm_width, 2]),
        }
        for index in range(1, len(self.slices)):
            shapes[f"carm.{index}"] = mlp([sum(self.slices[:index]), *self.carm_width, 2 * self.slices[index]])
        for name, outputs in (("opacity", 1), ("covariance", 7), ("colour", 3)):
            shapes[name] = mlp([self.features + 4, self.render_width, outputs * self.offset_count])
        return shapes


@dataclass(frozen=True)
class PositionGrid:
    """SPEC 6.4: world = (origin + scale_mantissa * P) * 2^(scale_exponent - 24)."""

    origin: tuple[int, int, int] = (0, 0, 0)
    scale_mantissa: int = 1
    scale_exponent: int = 0


@dataclass(frozen=True)
class RenderInfo:
    """SPEC 6.5. background: RGB 0..255; up_axis: 0..5 for +x -x +y -y +z -z; camera: pinhole, world to camera."""

    background: tuple[int, int, int] = (0, 0, 0)
    up_axis: int = 3
    near_plane: float = float(np.float32(0.2))
    distance_unit: float = 1.0
    alpha_max: float = float(np.float32(0.99))
    low_pass: float = float(np.float32(0.3))
    camera_width: int = 800
    camera_height: int = 600
    camera_focal: tuple[float, float] = (700.0, 700.0)
    camera_rotation: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)
    camera_translation: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Lanes:
    """SPEC 6.2: base-2 logarithms of the lanes of a substream of planes, of masks and of attributes."""

    plane: int = 3
    mask: int = 3
    attribute: int = 5


@dataclass(frozen=True, eq=False)
class Scene:
    """One scene. N anchors, K offsets each; shapes and dtypes:

    base_step: float32 values of the steps of features, scalings and offsets at index 32 (SPEC 7.8).
    networks: for each name of Dimensions.network_shapes the layers (weight float32 [out, in], bias float32 [out]).
    plane_shift: SPEC 7.5.4; carm_shift: uint8 [carm inputs]; mask_model: uint16 [K (K + 1) / 2].
    planes: int16 [5, ch, B, B]; positions: float16 [N, 3]; masks: bool [N, K].
    position_model: what the positions are packed with; None for mode 0, which packs none (SPEC 5.11).
    weight_scales: uint8 [layers, 3], in the order of SPEC 5.16; None for mode 0 of the weights (SPEC 5.8).
    attributes: symbols and step indices. extensions: (type, mode, bytes) of ancillary sections, types ascending.
    """

    profile: int
    dimensions: Dimensions
    chunk_size: int
    lanes: Lanes
    base_step: tuple[float, float, float]
    grid: PositionGrid
    render: RenderInfo
    frame: Frame
    plane_shift: int
    carm_shift: NDArray[np.uint8]
    networks: dict[str, list[Layer]]
    planes: NDArray[np.int16]
    mask_model: NDArray[np.uint16]
    positions: NDArray[np.float16]
    masks: NDArray[np.bool_]
    attributes: Attributes
    extensions: tuple[tuple[int, int, bytes], ...] = field(default=())
    position_model: PositionModel | None = None
    weight_scales: NDArray[np.uint8] | None = None

    @property
    def anchor_count(self) -> int:
        """N."""
        return len(self.positions)
