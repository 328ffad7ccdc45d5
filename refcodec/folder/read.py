"""Reader of scene folders."""

# safetensors and the encoder are imported where they are used, so that a decode that fails does not wait for them.
# ruff: noqa: PLC0415

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..bitstream.ancillary import is_safe_to_copy
from ..bitstream.attributes import ATTRIBUTE_SYMBOL_MAX, KINDS, SCALINGS, Attributes, zero_attributes
from ..bitstream.dimensions import Dimensions, layers_of, mask_contexts
from ..bitstream.frame import FRAME_RANGE_BOUND, FRAME_SHIFT_MAX, MATRIX_BOUND, TRANSLATION_BOUND, Frame
from ..bitstream.header import (
    BASE_STEP_MAX,
    BASE_STEP_MIN,
    LANES_LOG2_MAX,
    MAJOR,
    ORIGIN_BOUND,
    SCALE_EXPONENT_MAX,
    Lanes,
    PositionGrid,
    RenderInfo,
)
from ..bitstream.limits import PROFILES, dimension_fault
from ..bitstream.networks import Layer
from ..bitstream.planes import PLANE_SYMBOL_MAX, PLANES
from ..bitstream.positions import CELL_INDEX, HALVES, POSITION_MODELS, PositionModel
from ..bitstream.reconstruction import digest, reconstruct
from ..bitstream.scene import Ancillary, Scene
from ..bitstream.tables import STEP_LENGTH, TOTAL
from ..bitstream.weights import CARM_SHIFT_MAX, PLANE_SHIFT_MAX
from .arrays import read_arrays
from .document import Document
from .layout import (
    CODED_FILE,
    NETWORKS_FILE,
    PLANES_FILE,
    PLY_FILE,
    SCENE_FILE,
    SceneFolderError,
    ancillary_name,
    fingerprint,
    there,
)
from .ply import Columns, ply_values, read_cloud


def read_folder(path: str | Path) -> Scene:
    """Returns the scene of a folder. Raises SceneFolderError for any fault in it.

    With coded.safetensors the scene is exactly the written one. Without it, point_cloud.ply is quantised again.
    """
    path = Path(path)
    if not path.is_dir():
        raise SceneFolderError(
            path, "there is no such folder", "give a folder that `refcodec decode` or `refcodec fit` wrote"
        )
    for name, advice in (
        (SCENE_FILE, "it is not a scene folder, or its writing was interrupted: decode or fit again"),
        (PLY_FILE, "restore it, or decode again"),
        (NETWORKS_FILE, "restore it, or decode again"),
        (PLANES_FILE, "restore it, or decode again"),
    ):
        if not there(path / name, advice):
            raise SceneFolderError(path / name, "the file is missing", advice)
    document = Document(path / SCENE_FILE)
    document.integer("version", MAJOR, MAJOR)
    render = read_render(document)
    d, profile = _read_dimensions(document, render.render_model)
    bare = _read_document(document, d, profile, render, path)
    if not there(path / CODED_FILE, f"restore it, or remove it so that encode quantises {PLY_FILE} again"):
        return _without_unsafe(_requantise(bare, path))
    scene = _read_coded(bare, document, path)
    _compare_ply(scene, path)
    _compare_digest(scene, document)
    unchanged = document.root.get("fingerprint") == fingerprint(document.root)
    return scene if unchanged else _without_unsafe(scene)


# SPEC [E12.1-2], [E12.1-3]
def _without_unsafe(scene: Scene) -> Scene:
    """Returns a changed scene without the ancillary sections that are not safe to copy."""
    return replace(scene, ancillary=tuple(a for a in scene.ancillary if is_safe_to_copy(a.type)))


def _read_dimensions(doc: Document, render_model: int) -> tuple[Dimensions, int]:
    names = {p.name: number for number, p in PROFILES.items()}
    profile = doc.value("profile")
    if not isinstance(profile, str) or profile not in names:
        raise doc.fault("profile", f"is {profile!r}, one of {', '.join(names)} is required")

    def one(name: str) -> int:
        return doc.integer(f"dimensions.{name}", 0, 65535)

    def several(name: str) -> tuple[int, ...]:
        return tuple(doc.integers(f"dimensions.{name}", None, 0, 65535))

    d = Dimensions(
        one("offset_count"),
        several("slices"),
        one("plane_channels"),
        one("frequency_count"),
        one("plane_size"),
        several("hyper_width"),
        several("sarm_width"),
        several("carm_width"),
        one("render_width"),
        one("view_inputs"),
        one("colour_outputs"),
    )
    fault = dimension_fault(PROFILES[names[profile]], d, render_model)
    if fault:
        raise doc.fault("dimensions", f"do not fit the profile: {fault[1]}")
    return d, names[profile]


def _read_document(doc: Document, d: Dimensions, profile: int, render: RenderInfo, path: Path) -> Scene:
    """Returns the scene without anchors, which are in coded.safetensors.

    SPEC 15.3: the minor version and unknown header bytes are those of the source.
    """
    base_step = doc.floats("base_step", 3)
    if not all(BASE_STEP_MIN <= step <= BASE_STEP_MAX for step in base_step):
        raise doc.fault("base_step", f"is {base_step}, but must be {BASE_STEP_MIN} to {BASE_STEP_MAX}")
    origin = doc.integers("grid.origin", 3, 1 - ORIGIN_BOUND, ORIGIN_BOUND - 1)
    grid = PositionGrid(
        (origin[0], origin[1], origin[2]),
        doc.integer("grid.scale_mantissa", 1, 65535),
        doc.integer("grid.scale_exponent", -SCALE_EXPONENT_MAX, SCALE_EXPONENT_MAX),
    )
    lanes = Lanes(*(doc.integer(f"lanes.{name}", 0, LANES_LOG2_MAX) for name in ("plane", "mask", "attribute")))
    frame = _read_frame(doc) if d.has_frame else None
    planes = _tensors(
        path / PLANES_FILE, {"planes": ((PLANES, d.plane_channels, d.plane_size, d.plane_size), np.int16)}
    )["planes"]
    if planes.min(initial=0) < -PLANE_SYMBOL_MAX:
        raise SceneFolderError(
            path / PLANES_FILE, "a plane symbol is -32768", f"keep symbols within +-{PLANE_SYMBOL_MAX}"
        )
    return Scene(
        profile=profile,
        dimensions=d,
        chunk_size=doc.integer("chunk_size", *PROFILES[profile].chunk_size),
        lanes=lanes,
        base_step=(base_step[0], base_step[1], base_step[2]),
        grid=grid,
        render=render,
        frame=frame,
        plane_shift=doc.integer("plane_shift", 0, PLANE_SHIFT_MAX),
        carm_shift=np.array(doc.integers("carm_shift", d.carm_inputs, 0, CARM_SHIFT_MAX), dtype=np.uint8),
        networks=_read_networks(d, path / NETWORKS_FILE),
        planes=planes,
        mask_model=np.array(doc.integers("mask_model", mask_contexts(d.offset_count), 1, TOTAL - 1), dtype=np.uint16),
        positions=np.zeros((0, 3), np.float16),
        masks=np.zeros((0, d.offset_count), bool),
        attributes=zero_attributes(d, 0),
        ancillary=_read_ancillary(doc, path),
        position_model=_read_position_model(doc),
        weight_scales=_read_weight_scales(doc, d),
        weight_forms=_read_weight_forms(doc, d),
        minor=doc.integer("minor", 0, 65535) if "minor" in doc.root else 0,
        later=bytes(doc.integers("later", None, 0, 255)) if "later" in doc.root else b"",
    )


def _read_frame(doc: Document) -> Frame:
    """Returns the frame (SPEC 5.7)."""
    return Frame(
        np.array(
            [doc.integers(f"frame.matrix[{i}]", 3, 1 - MATRIX_BOUND, MATRIX_BOUND - 1) for i in range(3)],
            dtype=np.int64,
        ),
        np.array(doc.integers("frame.translation", 3, 1 - TRANSLATION_BOUND, TRANSLATION_BOUND - 1), dtype=np.int64),
        np.array(doc.integers("frame.shift", 3, 0, FRAME_SHIFT_MAX), dtype=np.int64),
        np.array(doc.integers("frame.low", 3, -FRAME_RANGE_BOUND, FRAME_RANGE_BOUND - 1), dtype=np.int64),
        np.array(doc.integers("frame.high", 3, -FRAME_RANGE_BOUND, FRAME_RANGE_BOUND), dtype=np.int64),
    )


def _read_weight_scales(doc: Document, d: Dimensions) -> NDArray[np.uint8] | None:
    """Returns the scale indices of packed weights (SPEC 5.9), uint8 [layers, 3]; None if weights are not packed."""
    if "weight_scales" not in doc.root:
        return None
    rows = [doc.integers(f"weight_scales[{i}]", 3, 0, 255) for i in range(len(layers_of(d)))]
    return np.array(rows, dtype=np.uint8)


def _read_weight_forms(doc: Document, d: Dimensions) -> NDArray[np.uint8] | None:
    """Returns the forms of packed weights (SPEC 5.9), uint8 [layers], or None if the encoder chooses them."""
    if "weight_forms" not in doc.root or "weight_scales" not in doc.root:
        return None
    return np.array(doc.integers("weight_forms", len(layers_of(d)), 0, 1), dtype=np.uint8)


def _read_chunks(doc: Document, n: int) -> tuple[tuple[int, ...] | None, tuple[int, ...] | None]:
    """Returns the anchor count and the position form of each chunk, or None for the encoder's choice. n: N."""
    anchors = forms = None
    if "chunk_anchors" in doc.root:
        anchors = tuple(doc.integers("chunk_anchors", None, 1, max(n, 1)))
        if sum(anchors) != n:
            raise doc.fault("chunk_anchors", f"adds up to {sum(anchors)}, but anchor_count is {n}")
        if "position_forms" in doc.root:
            forms = tuple(doc.integers("position_forms", len(anchors), 0, 1))
    return anchors, forms


def _read_position_model(doc: Document) -> PositionModel | None:
    """Returns the model of packed positions (SPEC 5.15), or None if positions are not packed."""
    if "position_model" not in doc.root:
        return None
    frequency = [doc.integers(f"position_model.frequency[{i}]", HALVES, 0, TOTAL) for i in range(POSITION_MODELS)]
    model = PositionModel(doc.integer("position_model.cell_shift", 0, CELL_INDEX), np.array(frequency, dtype=np.uint16))
    fault = model.fault()
    if fault is not None:
        raise doc.fault(f"position_model.frequency[{fault}]", "is not a model (SPEC.md 6.10)")
    return model


_CODE_POINTS = ("colour_primaries", "transfer_characteristics", "render_model")


def read_render(doc: Document) -> RenderInfo:
    """SPEC [R6.5-1]: returns the render information of a document, under "render". Raises SceneFolderError."""

    def scalar(name: str, right: Callable[[float], bool], allowed: str) -> float:
        value = doc.float(f"render.{name}")
        if not right(value):
            raise doc.fault(f"render.{name}", f"is {value}, {allowed} is required")
        return value

    background = doc.integers("render.background", 3, 0, 255)
    return RenderInfo(
        (background[0], background[1], background[2]),
        doc.integer("render.up_axis", 0, 5),
        scalar("near_plane", lambda x: x > 0, "a number above 0"),
        scalar("distance_unit", lambda x: x > 0, "a number above 0"),
        scalar("alpha_max", lambda x: 0 < x <= 1, "a number above 0 and at most 1"),
        scalar("low_pass", lambda x: x >= 0, "a number of at least 0"),
        *(doc.integer(f"render.{name}", 0, 255) for name in _CODE_POINTS),
    )


def _read_ancillary(doc: Document, path: Path) -> tuple[Ancillary, ...]:
    entries = doc.value("ancillary")
    if not isinstance(entries, list) or not all(isinstance(e, dict) for e in entries):
        raise doc.fault("ancillary", "is not a list of objects")
    found: list[Ancillary] = []
    for i in range(len(entries)):
        at = f"ancillary[{i}]"
        text = doc.value(f"{at}.type")
        if not isinstance(text, str) or not re.fullmatch("[a-z][A-Za-z]{3}", text):
            raise doc.fault(f"{at}.type", f"is {text!r}, but must be four letters, the first one in lower case")
        kind = text.encode()
        # Only the expected name is allowed, so that scene.json cannot point outside the folder.
        name = ancillary_name(i, kind)
        if doc.value(f"{at}.file") != name:
            raise doc.fault(f"{at}.file", f"is {doc.value(f'{at}.file')!r}, but must be {name!r}")
        advice = f'restore it, or delete its entry in "ancillary" of {SCENE_FILE}'
        if not there(path / name, advice):
            raise SceneFolderError(path / name, "the file is missing", advice)
        mode, after = doc.integer(f"{at}.mode", 0, 255), doc.integer(f"{at}.after", 0, 5)
        found.append(Ancillary(kind, mode, (path / name).read_bytes(), after))
    return tuple(found)


def _tensors(file: Path, wanted: dict[str, tuple[tuple[int, ...], type[np.generic]]]) -> dict[str, NDArray[Any]]:
    """Returns the arrays of a safetensors file by name. wanted: the shape and the dtype of each.

    Raises SceneFolderError if the file has other arrays, or one of another shape or dtype.
    """
    arrays = read_arrays(file, "restore it, or decode again")
    for name in sorted(wanted.keys() | arrays.keys()):
        if name not in arrays:
            raise SceneFolderError(file, f"the array {name} is missing", "restore it, or decode again")
        if name not in wanted:
            raise SceneFolderError(
                file, f"the array {name} is not known", f"remove it, or correct the dimensions in {SCENE_FILE}"
            )
        (shape, dtype), array = wanted[name], arrays[name]
        if array.shape != shape or array.dtype != dtype:
            problem = f"{name} is {array.dtype}{list(array.shape)}, but must be {np.dtype(dtype)}{list(shape)}"
            raise SceneFolderError(file, problem, f"correct the array, or the numbers in {SCENE_FILE}")
    return arrays


def _read_networks(d: Dimensions, file: Path) -> dict[str, list[Layer]]:
    shapes = d.network_shapes()
    wanted: dict[str, tuple[tuple[int, ...], type[np.generic]]] = {}
    for name, layers in shapes.items():
        for index, (out, fan_in) in enumerate(layers):
            wanted[f"{name}.{index}.weight"] = ((out, fan_in), np.float32)
            wanted[f"{name}.{index}.bias"] = ((out,), np.float32)
    arrays = _tensors(file, wanted)
    for name, array in arrays.items():
        if not np.isfinite(array).all():
            raise SceneFolderError(file, f"{name} has a NaN or an infinity", "train or export the networks again")
    return {
        name: [(arrays[f"{name}.{i}.weight"], arrays[f"{name}.{i}.bias"]) for i in range(len(layers))]
        for name, layers in shapes.items()
    }


def _read_coded(bare: Scene, doc: Document, path: Path) -> Scene:
    d, file = bare.dimensions, path / CODED_FILE
    n = doc.integer("anchor_count", 0, (1 << 32) - 1)
    arrays = _tensors(
        file,
        {
            "positions": ((n, 3), np.uint16),
            "masks": ((n, d.offset_count), np.uint8),
            "features": ((n, d.features), np.int32),
            "scalings": ((n, SCALINGS), np.int32),
            "offsets": ((n, d.offset_count, 3), np.int32),
            "steps": ((n, 3), np.uint8),
        },
    )
    advice = f"restore it, or delete it so that encode quantises {PLY_FILE} again"
    bits = arrays["positions"]
    if (((bits & 0x7C00) == 0x7C00) | (bits == 0x8000)).any():
        raise SceneFolderError(file, "a position is NaN, infinite or -0", advice)
    if arrays["masks"].max(initial=0) > 1:
        raise SceneFolderError(file, "a mask is neither 0 nor 1", advice)
    masks = arrays["masks"].astype(bool)
    for kind in KINDS:
        low, high = int(arrays[kind].min(initial=0)), int(arrays[kind].max(initial=0))
        if max(-low, high) > ATTRIBUTE_SYMBOL_MAX:
            raise SceneFolderError(file, f"a symbol of {kind} is outside +-{ATTRIBUTE_SYMBOL_MAX}", advice)
    if arrays["steps"].max(initial=0) >= STEP_LENGTH:
        raise SceneFolderError(file, f"a step index is above {STEP_LENGTH - 1}", advice)
    if arrays["offsets"][~masks].any():
        raise SceneFolderError(file, "an offset that its mask drops is not 0", advice)
    attributes = Attributes(arrays["features"], arrays["scalings"], arrays["offsets"], arrays["steps"])
    anchors, forms = _read_chunks(doc, n)
    return replace(
        bare,
        positions=bits.view(np.float16),
        masks=masks,
        attributes=attributes,
        chunk_anchors=anchors,
        position_forms=forms,
    )


def _compare_ply(scene: Scene, path: Path) -> None:
    """Raises SceneFolderError if the PLY file differs from the reconstruction of coded.safetensors.

    A different file was edited, and encoding would silently ignore the edit.
    """
    file = path / PLY_FILE
    advice = f"to encode {PLY_FILE} as it is now, delete {CODED_FILE}; to undo the change, decode again"
    columns = Columns(file)
    if columns.count != scene.anchor_count:
        raise SceneFolderError(
            file, f"it has {columns.count} anchors, but {CODED_FILE} has {scene.anchor_count}", advice
        )
    for stem, wanted in ply_values(reconstruct(scene), scene.masks).items():
        names = columns.names(stem)
        if not names and stem == "f_mask_":
            found = np.ones_like(wanted)
        elif len(names) != wanted.shape[1]:
            raise SceneFolderError(
                file, f"it has {len(names)} properties {stem}*, but must have {wanted.shape[1]}", advice
            )
        else:
            found = columns.array(names)
        differs = found.view(np.uint32) != np.ascontiguousarray(wanted).view(np.uint32)
        if differs.any():
            anchor, column = (int(i) for i in np.argwhere(differs)[0])
            name = names[column] if names else f"f_mask_{column}"
            problem = (
                f"{name} of anchor {anchor} is {found[anchor, column]}, {CODED_FILE} gives {wanted[anchor, column]}"
            )
            raise SceneFolderError(file, problem, advice)


def _compare_digest(scene: Scene, doc: Document) -> None:
    """Raises SceneFolderError if the digest in scene.json is not the scene's. Without a digest, nothing is checked."""
    if "digest" not in doc.root:
        return
    whole, parts = digest(scene)
    for name, value in {**parts, "whole": whole}.items():
        if doc.value(f"digest.{name}") != value:
            problem = f'"digest.{name}" does not fit the folder\'s {"files" if name == "whole" else name}'
            raise SceneFolderError(doc.file, problem, 'decode again, or delete "digest" if the change is meant')


def _requantise(bare: Scene, path: Path) -> Scene:
    """Returns the scene of point_cloud.ply, quantised with the networks, planes, frame and grid of the folder."""
    from ..encoder.quantise import quantise

    d, file = bare.dimensions, path / PLY_FILE
    cloud = read_cloud(file)
    for name, found, wanted in (
        ("offsets", cloud.masks.shape[1], d.offset_count),
        ("features", cloud.features.shape[1], d.features),
    ):
        if found != wanted:
            raise SceneFolderError(
                file,
                f"its anchors have {found} {name}, but {SCENE_FILE} states {wanted}",
                "use the point cloud that the networks fit",
            )
    try:
        scene = quantise(
            cloud,
            dimensions=d,
            networks=bare.networks,
            frame=bare.frame,
            grid=bare.grid,
            planes=bare.planes,
            plane_shift=bare.plane_shift,
            carm_shift=bare.carm_shift,
            base_step=bare.base_step,
            render=bare.render,
            lanes=bare.lanes,
            profile=bare.profile,
            chunk_size=bare.chunk_size,
        )
    except ValueError as error:
        raise SceneFolderError(
            file,
            f"it cannot be quantised ({error})",
            f"correct the values, or the grid and steps in {SCENE_FILE}",
        ) from None
    return replace(scene, ancillary=bare.ancillary)
