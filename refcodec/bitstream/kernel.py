"""Clauses 7 and 8 by the native kernel: scenes and chunks for refcodec.native, and what its statuses mean.

The kernel says only which error a substream has. The NumPy path then decodes it again and makes the error, so that its
texts are written once.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from ..native.library import REFUSED, Kernel, kernel
from ..native.scene import Anchors, ChunkBytes, NativeScene, values
from .chunks import CodedChunk
from .dimensions import RENDERING, Dimensions
from .errors import BitstreamError
from .frame import Frame
from .header import Lanes
from .networks import IntNetwork
from .positions import PositionModel
from .tables import tables_bytes


def native_scene(
    used: Kernel | None,
    d: Dimensions,
    lanes: Lanes,
    networks: Mapping[str, IntNetwork],
    plane_shift: int,
    carm_shift: NDArray[np.uint8],
    *,
    frame: Frame | None = None,
    planes: NDArray[np.int16] | None = None,
    mask_model: NDArray[np.uint16] | None = None,
    position_model: PositionModel | None = None,
) -> NativeScene | None:
    """Returns what the kernel codes a scene with, or None without a kernel.

    networks: as derive_networks gives them. planes: int16 [5, ch, B, B], or None if only planes are coded. Then frame
    and models are not needed.
    """
    if used is None:
        return None
    numbers = {
        "offset_count": d.offset_count,
        "plane_channels": d.plane_channels,
        "plane_size": d.plane_size,
        "frequency_count": d.frequency_count,
        "plane_shift": plane_shift,
        "slice_count": len(d.slices),
        "slice_width": d.slices,
        "hyper_layers": len(d.hyper_width) + 1,
        "sarm_layers": len(d.sarm_width) + 1 if d.plane_channels else 0,
        "carm_layers": len(d.carm_width) + 1,
        "plane_lanes": 1 << lanes.plane,
        "mask_lanes": 1 << lanes.mask,
        "attribute_lanes": 1 << lanes.attribute,
        "cell_shift": -1 if position_model is None else position_model.cell_shift,
    }
    layers = [
        (layer.weight, layer.bias, layer.exponent)
        for name in d.network_shapes()
        if name not in RENDERING
        for layer in networks[name].layers
    ]
    arrays: dict[str, NDArray[Any]] = {"carm_shift": carm_shift.astype(np.uint8)}
    if frame is not None:
        arrays["frame"] = np.concatenate([value.reshape(-1) for value in vars(frame).values()])
    if planes is not None:
        arrays["planes"] = planes
    if mask_model is not None:
        arrays["mask_model"] = mask_model
    if position_model is not None:
        arrays["position_model"] = position_model.frequency
    return NativeScene(used, tables_bytes(), numbers, layers, arrays)


def chunk_bytes(chunk: CodedChunk) -> ChunkBytes:
    """Returns a chunk as the kernel takes it."""
    e = chunk.entry
    parts = (chunk.positions.data, chunk.masks.data, chunk.attributes.data)
    return ChunkBytes(chunk.form, parts, len(e.anchors), e.kept, e.low, e.high)


def agreed(status: int, error: BitstreamError | None, path: str) -> BitstreamError:
    """Returns the error of the NumPy path. Raises RuntimeError if it is not the one of the kernel's status."""
    if error is None or error.kind.code != status:
        disagreement(path, status, error.kind.code if error else 0)
    return error


def disagreement(path: str, status: int, code: int) -> NoReturn:
    """Raises RuntimeError: the two paths disagree about a part of a file, or of a scene."""
    raise RuntimeError(f"{path}: the native kernel says {status}, and NumPy says {code}")


__all__ = [
    "REFUSED",
    "Anchors",
    "Kernel",
    "NativeScene",
    "agreed",
    "chunk_bytes",
    "disagreement",
    "kernel",
    "native_scene",
    "values",
]
