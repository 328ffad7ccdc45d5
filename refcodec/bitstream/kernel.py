"""Clauses 7 and 8 by the native kernel: scenes and chunks for refcodec.native, and the meaning of its verdicts.

The kernel reports the error of a substream with the numbers for the error's text. The functions of the NumPy path make
the text from them, so nothing is decoded twice.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..native.library import Kernel, KernelVerdict
from ..native.scene import ChunkBytes, NativeScene
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
    frame: Frame | None = None,
    planes: NDArray[np.int16] | None = None,
    mask_model: NDArray[np.uint16] | None = None,
    position_model: PositionModel | None = None,
) -> NativeScene | None:
    """Returns the kernel's form of a scene, or None without a kernel.

    networks: the result of derive_networks. planes: int16 [5, ch, B, B], or None if only planes are coded; frame and
    models are not needed then.
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
    """Returns the kernel's form of a chunk."""
    e = chunk.entry
    parts = (chunk.positions.data, chunk.masks.data, chunk.attributes.data)
    return ChunkBytes(chunk.form, parts, len(e.anchors), e.kept, e.low, e.high)


_NAMES = {kind.code: kind.name for kind in REGISTRY.values()}


def error_name(verdict: KernelVerdict) -> str | None:
    """Returns the name of the error that the kernel reported, or None."""
    return _NAMES[verdict.status] if verdict.status else None


def substream_error(verdict: KernelVerdict, piece: Piece, lanes: int, path: str) -> BitstreamError:
    """SPEC 8.1 and 8.8: returns the error of a substream that the kernel refused. piece, path: its bytes and name."""
    stream, before = open_substream(piece, lanes, path)
    return before or end_error(_NAMES[verdict.status], stream, *verdict.number)
