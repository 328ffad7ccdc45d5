"""Reader of scene folders."""

# safetensors and the encoder are imported where they are used, so that a decode that fails does not wait for them.
# ruff: noqa: PLC0415

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from msgspec.structs import astuple
from numpy.typing import NDArray

from ..bitstream.ancillary import is_safe_to_copy
from ..bitstream.attributes import ATTRIBUTE_SYMBOL_MAX, KINDS, SCALINGS, Attributes, zero_attributes
from ..bitstream.dimensions import Dimensions, layers_of, mask_contexts
from ..bitstream.frame import Frame
from ..bitstream.header import LANES_LOG2_MAX, PositionGrid, RenderInfo
from ..bitstream.limits import PROFILES, dimension_fault
from ..bitstream.planes import PLANE_SYMBOL_MAX, PLANES
from ..bitstream.positions import PositionModel
from ..bitstream.reconstruction import digest, reconstruct
from ..bitstream.scene import Ancillary, Scene
from ..bitstream.tables import STEP_LENGTH
from ..files.text import printable
from .arrays import Wanted, check_arrays, read_arrays, read_networks
from .document import FolderDocument, SceneFile, single
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
from .ply import PlyColumns, ply_values, read_cloud

AGAIN = "restore it, or decode again"


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
        (PLY_FILE, AGAIN),
        (NETWORKS_FILE, AGAIN),
        (PLANES_FILE, AGAIN),
    ):
        if not there(path / name, advice):
            raise SceneFolderError(path / name, "the file is missing", advice)
    document = FolderDocument(path / SCENE_FILE, SceneFile)
    bare = _read_document(document, path)
    if not there(path / CODED_FILE, f"restore it, or remove it so that encode quantises {PLY_FILE} again"):
        return _without_unsafe(_requantise(bare, path))
    scene = _read_coded(bare, document, path)
    _compare_ply(scene, path)
    _compare_digest(scene, document)
    unchanged = document.values.fingerprint == fingerprint(document.root)
    return scene if unchanged else _without_unsafe(scene)


# SPEC [E12.1-2], [E12.1-3]
def _without_unsafe(scene: Scene) -> Scene:
    """Returns a changed scene without the ancillary sections that are not safe to copy."""
    return replace(scene, ancillary=tuple(a for a in scene.ancillary if is_safe_to_copy(a.type)))


def _read_dimensions(doc: FolderDocument[SceneFile], render_model: int) -> tuple[Dimensions, int]:
    names = {p.name: number for number, p in PROFILES.items()}
    profile = doc.values.profile
    if profile not in names:
        raise doc.fault("profile", f"is {printable(profile, 60)!r}: one of {', '.join(names)} is required")
    fault = dimension_fault(PROFILES[names[profile]], doc.values.dimensions, render_model)
    if fault:
        field, value, allowed = fault
        raise doc.fault(f"dimensions.{field}", f"is {value}, but must be {allowed}")
    # msgspec leaves a default to the class: vars() of the result must have it, too.
    return replace(doc.values.dimensions), names[profile]


def _read_document(doc: FolderDocument[SceneFile], path: Path) -> Scene:
    """Returns the scene without anchors, which are in coded.safetensors."""
    values, render = doc.values, RenderInfo(*single(astuple(doc.values.render)))
    d, profile = _read_dimensions(doc, render.render_model)
    if d.has_frame and values.frame is None:
        raise doc.fault("frame", "is missing")
    low, high = PROFILES[profile].chunk_size
    if not low <= values.chunk_size <= high:
        raise doc.fault("chunk_size", f"is {values.chunk_size}: an integer from {low} to {high} is required")
    if not all(0 <= log2 <= LANES_LOG2_MAX for log2 in vars(values.lanes).values()):
        raise doc.fault("lanes", f"are {vars(values.lanes)}: integers from 0 to {LANES_LOG2_MAX} are required")
    shape = (PLANES, d.plane_channels, d.plane_size, d.plane_size)
    planes = _arrays(path / PLANES_FILE, {"planes": (shape, np.int16)})["planes"]
    if planes.min(initial=0) < -PLANE_SYMBOL_MAX:
        raise SceneFolderError(
            path / PLANES_FILE, "a plane symbol is -32768", f"keep symbols within +-{PLANE_SYMBOL_MAX}"
        )
    weights = path / NETWORKS_FILE
    layers, scales, forms = len(layers_of(d)), None, None
    if values.weight_scales is not None:
        scales = np.array(doc.sized("weight_scales", layers), np.uint8)
        if values.weight_forms is not None:
            forms = np.array(doc.sized("weight_forms", layers), np.uint8)
    return Scene(
        profile=profile,
        dimensions=d,
        chunk_size=values.chunk_size,
        lanes=values.lanes,
        base_step=single(values.base_step),
        grid=PositionGrid(*astuple(values.grid)),
        render=render,
        frame=Frame(*(np.array(v, np.int64) for v in astuple(values.frame))) if d.has_frame and values.frame else None,
        plane_shift=values.plane_shift,
        carm_shift=np.array(doc.sized("carm_shift", d.carm_inputs), np.uint8),
        networks=read_networks(weights, read_arrays(weights, AGAIN), d.network_shapes(), AGAIN),
        planes=planes,
        mask_model=np.array(doc.sized("mask_model", mask_contexts(d.offset_count)), np.uint16),
        positions=np.zeros((0, 3), np.float16),
        masks=np.zeros((0, d.offset_count), bool),
        attributes=zero_attributes(d, 0),
        ancillary=_read_ancillary(doc, path),
        position_model=_read_position_model(doc),
        weight_scales=scales,
        weight_forms=forms,
        minor=values.minor,
        later=bytes(values.later),
    )


def _read_chunks(doc: FolderDocument[SceneFile], n: int) -> tuple[tuple[int, ...] | None, tuple[int, ...] | None]:
    """Returns the anchor count and the position form of each chunk, or None for the encoder's choice. n: N."""
    anchors = doc.values.chunk_anchors
    if anchors is None:
        return None, None
    if sum(anchors) != n:
        raise doc.fault("chunk_anchors", f"adds up to {sum(anchors)}, but anchor_count is {n}")
    forms = doc.values.position_forms
    return tuple(anchors), None if forms is None else tuple(doc.sized("position_forms", len(anchors)))


def _read_position_model(doc: FolderDocument[SceneFile]) -> PositionModel | None:
    """Returns the model of packed positions (SPEC 5.15), or None if positions are not packed."""
    fields = doc.values.position_model
    if fields is None:
        return None
    model = PositionModel(fields.cell_shift, np.array(fields.frequency, np.uint16))
    fault = model.fault()
    if fault is not None:
        raise doc.fault(f"position_model.frequency[{fault}]", "is not a model (SPEC.md 6.10)")
    return model


def _read_ancillary(doc: FolderDocument[SceneFile], path: Path) -> tuple[Ancillary, ...]:
    sections: list[Ancillary] = []
    for i, entry in enumerate(doc.values.ancillary):
        kind = entry.type.encode()
        # Only the expected name is allowed, so that scene.json cannot point outside the folder.
        name = ancillary_name(i, kind)
        if entry.file != name:
            raise doc.fault(f"ancillary[{i}].file", f"is {printable(entry.file, 60)!r}, but must be {name!r}")
        advice = f'restore it, or delete its entry in "ancillary" of {SCENE_FILE}'
        if not there(path / name, advice):
            raise SceneFolderError(path / name, "the file is missing", advice)
        sections.append(Ancillary(kind, entry.mode, (path / name).read_bytes(), entry.after))
    return tuple(sections)


def _arrays(file: Path, wanted: Wanted) -> dict[str, NDArray[Any]]:
    """Returns the arrays of a file by name. Raises SceneFolderError, as check_arrays."""
    arrays = read_arrays(file, AGAIN)
    check_arrays(file, arrays, wanted, AGAIN)
    return arrays


def _read_coded(bare: Scene, doc: FolderDocument[SceneFile], path: Path) -> Scene:
    d, file = bare.dimensions, path / CODED_FILE
    if "anchor_count" not in doc.root:
        raise doc.fault("anchor_count", "is missing")
    n = doc.values.anchor_count
    arrays = _arrays(
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
    columns = PlyColumns(file)
    if columns.count != scene.anchor_count:
        problem = f"it has {columns.count} anchors, but {CODED_FILE} has {scene.anchor_count}"
        raise SceneFolderError(file, problem, advice)
    for stem, wanted in ply_values(reconstruct(scene), scene.masks).items():
        names = columns.names(stem)
        if not names and stem == "f_mask_":
            values = np.ones_like(wanted)
        else:
            columns.check_number(stem, names, wanted.shape[1], advice)
            values = columns.array(names)
        differs = values.view(np.uint32) != np.ascontiguousarray(wanted).view(np.uint32)
        if differs.any():
            anchor, column = (int(i) for i in np.argwhere(differs)[0])
            name = names[column] if names else f"f_mask_{column}"
            problem = (
                f"{name} of anchor {anchor} is {values[anchor, column]}, {CODED_FILE} gives {wanted[anchor, column]}"
            )
            raise SceneFolderError(file, problem, advice)


def _compare_digest(scene: Scene, doc: FolderDocument[SceneFile]) -> None:
    """Raises SceneFolderError if the digest in scene.json is not the scene's. Without a digest, nothing is checked."""
    stated = doc.values.digest
    if stated is None:
        return
    whole, parts = digest(scene)
    for name, value in {**parts, "whole": whole}.items():
        if stated.get(name) != value:
            problem = f'"digest.{name}" does not fit the folder\'s {"files" if name == "whole" else name}'
            raise SceneFolderError(doc.file, problem, 'decode again, or delete "digest" if the change is meant')


def _requantise(bare: Scene, path: Path) -> Scene:
    """Returns the scene of point_cloud.ply, quantised with the networks, planes, frame and grid of the folder."""
    from ..encoder.quantise import quantise

    d, file = bare.dimensions, path / PLY_FILE
    cloud = read_cloud(file)
    for name, count, wanted in (
        ("offsets", cloud.masks.shape[1], d.offset_count),
        ("features", cloud.features.shape[1], d.features),
    ):
        if count != wanted:
            problem = f"its anchors have {count} {name}, but {SCENE_FILE} states {wanted}"
            raise SceneFolderError(file, problem, "use the point cloud that the networks fit")
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
        problem = f"it cannot be quantised ({error})"
        raise SceneFolderError(file, problem, f"correct the values, or the grid and steps in {SCENE_FILE}") from None
    return replace(scene, ancillary=bare.ancillary)
