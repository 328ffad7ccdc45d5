"""The scene: the content of a file, as one dataclass of NumPy arrays.

Everything that determines a symbol is an integer here. `reconstruction` computes the float values.
"""

from dataclasses import dataclass, replace
from functools import cache
from itertools import accumulate
from types import NoneType, UnionType
from typing import Any, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import NDArray

from .attributes import Attributes
from .chunks import chunk_ranges
from .dimensions import SCALINGS, Dimensions, layers_of, mask_contexts
from .frame import Frame
from .header import Lanes, PositionGrid, RenderInfo
from .networks import Layer
from .planes import PLANE_SYMBOL_MAX, PLANES
from .positions import CELL_INDEX, HALVES, PACKED, POSITION_MODELS, RAW, PositionModel


@dataclass(frozen=True)
class Ancillary:
    """SPEC 12.1: an ancillary section. after: the number of critical sections before it in the file."""

    type: bytes
    mode: int
    content: bytes
    after: int = 0


@dataclass(frozen=True, kw_only=True, eq=False)
class Scene:
    """One scene of N anchors with K offsets each.

    profile: its number (SPEC 11.1).
    chunk_size: the most anchors of a chunk.
    base_step: float32 values, the steps of features, scalings and offsets at step index 32 (SPEC 7.8).
    frame: None if the dimensions need none.
    plane_shift: the scale of the plane query (SPEC 7.5.4).
    carm_shift: uint8 [CARM inputs], the scale of each input of CARM (SPEC 7.9).
    networks: the layers (weight float32 [out, in], bias float32 [out]) by the names of Dimensions.network_shapes.
    planes: int16 [5, ch, B, B], the symbols of the sub-planes.
    mask_model: uint16 [K (K + 1) / 2].
    positions: float16 [N, 3], on the position grid.
    masks: bool [N, K], True where an offset is kept.
    attributes: the symbols and the step indices.
    ancillary: the ancillary sections in file order.
    position_model: the model of packed positions (SPEC 5.12), or None if the index has mode 0.
    weight_scales: uint8 [layers, 3], the scale indices in the order of SPEC 5.9, or None if the weights' mode is 0.
    chunk_anchors: the number of anchors of each chunk. None means the fewest chunks that chunk_size allows.
    position_forms: the form of each chunk's positions (SPEC 5.14). None packs each chunk that can be packed and does
    not
        become too short (SPEC [R6.10-5]).
    weight_forms: uint8 [layers], the form of each layer in mode 1. None packs each layer that can be packed.
    minor, later: the file's minor version, and the bytes of header fields added by it (SPEC 12.3).
    """

    profile: int
    dimensions: Dimensions
    chunk_size: int
    lanes: Lanes
    base_step: tuple[float, float, float]
    grid: PositionGrid
    render: RenderInfo
    frame: Frame | None
    plane_shift: int
    carm_shift: NDArray[np.uint8]
    networks: dict[str, list[Layer]]
    planes: NDArray[np.int16]
    mask_model: NDArray[np.uint16]
    positions: NDArray[np.float16]
    masks: NDArray[np.bool_]
    attributes: Attributes
    ancillary: tuple[Ancillary, ...] = ()
    position_model: PositionModel | None = None
    weight_scales: NDArray[np.uint8] | None = None
    chunk_anchors: tuple[int, ...] | None = None
    position_forms: tuple[int, ...] | None = None
    weight_forms: NDArray[np.uint8] | None = None
    minor: int = 0
    later: bytes = b""

    @property
    def anchor_count(self) -> int:
        """N, the number of anchors."""
        return len(self.positions)

    @property
    def chunks(self) -> list[range]:
        """The anchors of each chunk."""
        if self.chunk_anchors is None:
            return chunk_ranges(self.anchor_count, self.chunk_size)
        ends = list(accumulate(self.chunk_anchors))
        return [range(end - count, end) for end, count in zip(ends, self.chunk_anchors, strict=True)]


def take_anchors(scene: Scene, keep: NDArray[Any] | slice) -> Scene:
    """Returns the scene with some of its anchors, in the fewest chunks.

    keep: the indices in the wanted order, a boolean array [N], or a slice.
    """
    a = scene.attributes
    chosen = Attributes(a.features[keep], a.scalings[keep], a.offsets[keep], a.steps[keep])
    return replace(
        scene,
        positions=scene.positions[keep],
        masks=scene.masks[keep],
        attributes=chosen,
        chunk_anchors=None,
        position_forms=None,
    )


# --- checks -----------------------------------------------------------------------------------------------------------


def check_types(value: object, kind: Any = Scene, path: str = "scene") -> None:
    """Raises TypeError for a field whose type is not that of Scene or of the classes of its fields.

    An int may be any integer, a float any number, and a tuple a list. check_shapes compares the dtypes of arrays.

    Args:
        value: the scene, or a part of it.
        kind: the required type, as an annotation.
        path: its name.
    """
    origin, inner = _class_of(kind), get_args(kind)
    if origin is UnionType:
        if value is None and NoneType in inner:
            return
        origin, inner = _class_of(inner[0]), get_args(inner[0])
    if not isinstance(value, _ACCEPTED.get(origin, origin)):
        raise TypeError(f"{path} is {value!r:.60}, but must be {getattr(origin, '__name__', origin)}")
    if hasattr(origin, "__dataclass_fields__"):
        for name, hint in _hints(origin).items():
            check_types(getattr(value, name), hint, f"{path}.{name}")
    elif isinstance(value, dict):
        for key, item in value.items():
            check_types(item, inner[1], f"{path}[{key!r:.60}]")
    elif isinstance(value, tuple | list):
        of_each = len(inner) < 2 or inner[1] is ...
        if not of_each and len(value) != len(inner):
            raise ValueError(f"{path} must have {len(inner)} values, but has {len(value)}")
        for i, item in enumerate(value):
            check_types(item, inner[0] if of_each else inner[i], f"{path}[{i}]")


def _class_of(kind: Any) -> Any:
    """Returns the class of an annotation, such as ndarray for NDArray[float32]."""
    origin = get_origin(kind) or kind
    # From NumPy 2.5 on, NDArray is the name of an alias.
    return _class_of(origin.__value__) if hasattr(origin, "__value__") else origin


# The accepted types for the type of an annotation.
_ACCEPTED: dict[Any, Any] = {
    int: int | np.integer,
    float: int | float | np.integer | np.floating,
    tuple: tuple | list,
    list: tuple | list,
}


@cache
def _hints(kind: Any) -> dict[str, Any]:
    """Returns the annotations of a dataclass's fields, as types."""
    return get_type_hints(kind)


def check_shapes(scene: Scene) -> None:
    """Raises ValueError for a scene that violates the description of Scene.

    It checks the shapes and dtypes of all arrays, the names and layers of the networks, cell_shift, chunk_size, and the
    forms of positions. It refuses plane symbols of -32768, and masked offsets that are not 0. The types and the header
    have been checked.
    """
    d, n, a = scene.dimensions, scene.anchor_count, scene.attributes
    wanted: dict[str, tuple[NDArray[Any], tuple[int, ...], type]] = {
        "planes": (scene.planes, (PLANES, d.plane_channels, d.plane_size, d.plane_size), np.int16),
        "carm_shift": (scene.carm_shift, (d.carm_inputs,), np.uint8),
        "mask_model": (scene.mask_model, (mask_contexts(d.offset_count),), np.uint16),
        "positions": (scene.positions, (n, 3), np.float16),
        "masks": (scene.masks, (n, d.offset_count), np.bool_),
        "features": (a.features, (n, d.features), np.int32),
        "scalings": (a.scalings, (n, SCALINGS), np.int32),
        "offsets": (a.offsets, (n, d.offset_count, 3), np.int32),
        "steps": (a.steps, (n, 3), np.uint8),
    }
    if scene.weight_scales is not None:
        wanted["weight_scales"] = (scene.weight_scales, (len(layers_of(d)), 3), np.uint8)
        if scene.weight_forms is not None:
            wanted["weight_forms"] = (scene.weight_forms, (len(layers_of(d)),), np.uint8)
    if scene.frame is not None:
        for name, values in vars(scene.frame).items():
            wanted[f"frame.{name}"] = (values, (3, 3) if name == "matrix" else (3,), np.int64)
    if scene.position_model is not None:
        wanted["position_model"] = (scene.position_model.frequency, (POSITION_MODELS, HALVES), np.uint16)
    if list(scene.networks) != list(d.network_shapes()):
        raise ValueError(f"networks are {list(scene.networks)}, but the dimensions require {list(d.network_shapes())}")
    for name, shapes in d.network_shapes().items():
        if len(scene.networks[name]) != len(shapes):
            raise ValueError(
                f"network {name} has {len(scene.networks[name])} layers, but the dimensions require {len(shapes)}"
            )
        for i, ((weight, bias), (out, fan_in)) in enumerate(zip(scene.networks[name], shapes, strict=True)):
            wanted[f"{name}.{i}.weight"] = (weight, (out, fan_in), np.float32)
            wanted[f"{name}.{i}.bias"] = (bias, (out,), np.float32)
    for name, (array, shape, dtype) in wanted.items():
        if array.shape != shape or array.dtype != dtype:
            raise ValueError(f"{name} is {array.dtype}{list(array.shape)}, but must be {np.dtype(dtype)}{list(shape)}")
    if scene.position_model is not None and not 0 <= scene.position_model.cell_shift <= CELL_INDEX:
        raise ValueError(
            f"cell_shift is {scene.position_model.cell_shift}, but must be 0 to {CELL_INDEX} (SPEC.md 6.10)"
        )
    if scene.chunk_size < 1:
        raise ValueError(f"chunk_size is {scene.chunk_size}, but must be at least 1 (SPEC.md 11.1)")
    if (scene.frame is not None) != d.has_frame:
        raise ValueError("a frame is required exactly if there are planes or frequencies (SPEC.md 6.6)")
    if scene.chunk_anchors is not None and (sum(scene.chunk_anchors) != n or min(scene.chunk_anchors, default=1) < 1):
        raise ValueError("the chunks do not hold all anchors, or one of them is empty (SPEC.md 6.10)")
    if scene.position_forms is not None and len(scene.position_forms) != len(scene.chunks):
        raise ValueError("the number of position forms is not the number of chunks (SPEC.md 5.14)")
    # SPEC 5.12: without a model no positions are packed.
    forms = (RAW,) if scene.position_model is None else (RAW, PACKED)
    wrong = next((form for form in scene.position_forms or () if form not in forms), None)
    if wrong is not None:
        allowed = " or ".join(map(str, forms))
        raise ValueError(f"a form of positions is {wrong}, but must be {allowed} (0 raw, 1 packed) (SPEC.md 5.14)")
    if np.abs(scene.planes.astype(np.int32)).max(initial=0) > PLANE_SYMBOL_MAX:
        raise ValueError("a plane symbol is -32768 (SPEC.md 6.9)")
    if a.offsets[~scene.masks].any():
        raise ValueError("a masked offset is not 0 (SPEC.md 6.13)")
