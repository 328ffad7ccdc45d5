"""Clauses 7 and 8 by the native kernel: scenes and chunks for refcodec.native, and what its verdicts mean.

The kernel says which error a substream has, with the numbers that the error's text names. The functions that make the
texts are those of the NumPy path, so that nothing is decoded twice.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..native.library import REFUSED_FORM, REFUSED_STEPS, Kernel, Verdict, kernel
from ..native.scene import Anchors, ChunkBytes, NativeScene, values, weight_symbols
from .chunks import CodedChunk
from .dimensions import RENDERING, Dimensions
from .entropy import end_error, open_substream
from .errors import REGISTRY, BitstreamError
from .frame import Frame
from .header import Lanes
from .networks import IntNetwork
from .positions import PositionModel
from .source import Piece
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


_NAMES = {kind.code: kind.name for kind in REGISTRY.values()}


def error_name(verdict: Verdict) -> str | None:
    """Returns the name of the error that the kernel found, or None if there is none."""
    return _NAMES[verdict.status] if verdict.status else None


def substream_error(verdict: Verdict, piece: Piece, lanes: int, path: str) -> BitstreamError:
    """SPEC 8.1 and 8.8: returns the error of a substream that the kernel refused. piece, path: its bytes and name."""
    stream, before = open_substream(piece, lanes, path)
    return before or end_error(_NAMES[verdict.status], stream, *verdict.number)


__all__ = [
    "REFUSED_FORM",
    "REFUSED_STEPS",
    "Anchors",
    "Kernel",
    "NativeScene",
    "Verdict",
    "chunk_bytes",
    "error_name",
    "kernel",
    "native_scene",
    "substream_error",
    "values",
    "weight_symbols",
]
