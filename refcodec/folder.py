"""The scene folder: what `decode` writes and `encode` reads, in formats that other programs know.

scene.json              what the header, the frame and the small tables say, and the digest
point_cloud.ply         the reconstruction, in the layout of Scaffold-GS checkpoints
networks.safetensors    fp32 weights and biases
planes.safetensors      the planes' symbols
coded.safetensors       fp16 positions, masks, attribute symbols and step indices
extension_XX.bin        the ancillary section of type XX

With coded.safetensors a folder is encoded exactly. Without it, `encode` quantises point_cloud.ply anew with the folder's networks,
planes, frame and grid.
"""

# plyfile and safetensors are imported where they are used: a decode that fails should not wait for them.
# ruff: noqa: PLC0415

from __future__ import annotations

import contextlib
import json
import re
import shutil
from collections.abc import Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from .attributes import ATTRIBUTE_SYMBOL_MAX, KINDS, SCALINGS, Attributes
from .codec import (
    FRAME_RANGE_BOUND,
    FRAME_SHIFT_MAX,
    MATRIX_BOUND,
    TRANSLATION_BOUND,
)
from .container import (
    BASE_STEP_MAX,
    BASE_STEP_MIN,
    LANES_LOG2_MAX,
    ORIGIN_BOUND,
    SCALE_EXPONENT_MAX,
    VERSION,
)
from .errors import BitstreamError
from .geometry import Frame
from .limits import PROFILES, dimension_fault
from .masks import context_count
from .networks import Layer
from .planes import PLANE_SYMBOL_MAX, PLANES
from .positions import CELL_INDEX, HALVES, POSITION_MODELS, PositionModel
from .reconstruction import Reconstruction, digest, reconstruct
from .scene import Dimensions, Lanes, PositionGrid, RenderInfo, Scene
from .tables import STEP_LENGTH, TOTAL
from .weights import CARM_SHIFT_MAX, PLANE_SHIFT_MAX, layers_of

if TYPE_CHECKING:
    from .quantise import AnchorCloud

SCENE_FILE = "scene.json"
PLY_FILE = "point_cloud.ply"
NETWORKS_FILE = "networks.safetensors"
PLANES_FILE = "planes.safetensors"
CODED_FILE = "coded.safetensors"
EXTENSION_FILE = re.compile(r"extension_[0-9a-f]{2}\.bin")
# Files are written here, inside the folder, and moved out when all of them are whole.
INCOMING = ".c3gs-incoming"

FORMAT = "C3GS scene"
# HAC and CAT-3DGS store a mask as a logit and keep an offset whose sigmoid passes 0.01.
MASK_LOGIT_MIN = float(np.log(0.01 / 0.99))

_I32 = (-(1 << 31), (1 << 31) - 1)


class SceneFolderError(ValueError):
    """A scene folder, or a file in it, that cannot be used: which file, what is wrong, what to do."""

    def __init__(self, file: Path | str, problem: str, advice: str) -> None:
        self.file, self.problem, self.advice = str(file), problem, advice
        super().__init__(f"{file}: {problem}; {advice}")


# --- writing ----------------------------------------------------------------------------------------------------------


def is_free(path: Path) -> bool:
    """Whether write_folder may write there: nothing yet, an empty directory, or a scene folder."""
    if not path.exists():
        return True
    return path.is_dir() and ((path / SCENE_FILE).is_file() or all(p.name == INCOMING for p in path.iterdir()))


def write_folder(scene: Scene, path: str | Path, damage: dict[int, BitstreamError] | None = None) -> None:
    """Writes a scene folder; damage (of codec.parse) is noted in scene.json.

    An interrupted write leaves the folder as it was, or without scene.json: never a mixture that reads as whole.
    Raises SceneFolderError if `path` is a file, or a directory with something else in it.
    """
    path = Path(path)
    if not is_free(path):
        raise SceneFolderError(path, "it exists and is not a scene folder", "choose another folder, or empty this one")
    made = not path.exists()
    incoming = path / INCOMING
    try:
        path.mkdir(parents=True, exist_ok=True)
        shutil.rmtree(incoming, ignore_errors=True)
        incoming.mkdir()
        _write_files(scene, incoming, damage or {})
        (path / SCENE_FILE).unlink(missing_ok=True)
        for old in path.iterdir():
            if old.name in (PLY_FILE, NETWORKS_FILE, PLANES_FILE, CODED_FILE) or EXTENSION_FILE.fullmatch(old.name):
                old.unlink()
        # scene.json comes last: without it the folder does not read as a scene.
        for new in sorted(incoming.iterdir(), key=lambda p: p.name == SCENE_FILE):
            new.replace(path / new.name)
    finally:
        shutil.rmtree(incoming, ignore_errors=True)
        if made and path.is_dir() and not any(path.iterdir()):
            path.rmdir()


def _write_files(scene: Scene, path: Path, damage: dict[int, BitstreamError]) -> None:
    from safetensors.numpy import save

    a = scene.attributes
    write_cloud(reconstruct(scene), scene.masks, path / PLY_FILE)
    networks = {
        f"{name}.{index}.{part}": np.ascontiguousarray(value)
        for name, layers in scene.networks.items()
        for index, layer in enumerate(layers)
        for part, value in zip(("weight", "bias"), layer, strict=True)
    }
    (path / NETWORKS_FILE).write_bytes(save(networks))
    (path / PLANES_FILE).write_bytes(save({"planes": np.ascontiguousarray(scene.planes)}))
    coded: dict[str, NDArray] = {"positions": scene.positions.view(np.uint16), "masks": scene.masks.astype(np.uint8), "steps": a.steps}
    coded |= {kind: getattr(a, kind) for kind in KINDS}
    (path / CODED_FILE).write_bytes(save({name: np.ascontiguousarray(value) for name, value in coded.items()}))
    for kind, _, content in scene.extensions:
        (path / extension_name(kind)).write_bytes(content)
    (path / SCENE_FILE).write_text(_json_text(_scene_document(scene, damage)), encoding="utf-8")


def extension_name(kind: int) -> str:
    """The file that holds an ancillary section."""
    return f"extension_{kind:02x}.bin"


def _short(value: Any) -> Any:
    """Floats, alone or in a tuple, as those whose shortest text reads back as the same float32; the rest as it is."""
    if isinstance(value, tuple):
        return [_short(v) for v in value]
    return float(str(np.float32(value))) if isinstance(value, float) else value


def _scene_document(scene: Scene, damage: dict[int, BitstreamError]) -> dict[str, Any]:
    whole, parts = digest(scene)
    document = {
        "format": FORMAT,
        "version": VERSION,
        "profile": PROFILES[scene.profile].name,
        "anchor_count": scene.anchor_count,
        "dimensions": vars(scene.dimensions),
        "chunk_size": scene.chunk_size,
        "lanes": vars(scene.lanes),
        "base_step": _short(scene.base_step),
        "grid": vars(scene.grid),
        "render": {name: _short(value) for name, value in vars(scene.render).items()},
        "frame": {f.name: getattr(scene.frame, f.name).tolist() for f in fields(scene.frame)},
        "plane_shift": scene.plane_shift,
        "carm_shift": scene.carm_shift.tolist(),
        "mask_model": scene.mask_model.tolist(),
        **_position_document(scene.position_model),
        **({} if scene.weight_scales is None else {"weight_scales": scene.weight_scales.tolist()}),
        "extensions": [{"type": kind, "mode": mode, "file": extension_name(kind)} for kind, mode, _ in scene.extensions],
        "digest": {"whole": whole, **parts},
    }
    if damage:
        document["dropped_chunks"] = [{"chunk": number, **json.loads(error.to_json())} for number, error in sorted(damage.items())]
    return document


def _position_document(model: PositionModel | None) -> dict[str, Any]:
    """What packed positions were coded with, so that a folder gives its file again."""
    return {} if model is None else {"position_model": {"cell_shift": model.cell_shift, "frequency": model.frequency.tolist()}}


def _json_text(document: dict[str, Any]) -> str:
    """Indented JSON with each list of numbers on one line."""
    text = json.dumps(document, indent=2, allow_nan=False)
    return re.sub(r"\[[^\[\]{}]*\]", lambda m: " ".join(m.group().split()).replace("[ ", "[").replace(" ]", "]"), text) + "\n"


def ply_properties(offset_count: int, features: int) -> list[str]:
    """The properties of a Scaffold-GS point cloud with masks, in file order."""
    return [
        *("x", "y", "z", "nx", "ny", "nz"),
        *(f"f_offset_{i}" for i in range(3 * offset_count)),
        *(f"f_mask_{i}" for i in range(offset_count)),
        *(f"f_anchor_feat_{i}" for i in range(features)),
        "opacity",
        *(f"scale_{i}" for i in range(SCALINGS)),
        *(f"rot_{i}" for i in range(4)),
    ]


def _ply_values(r: Reconstruction, masks: NDArray[np.bool_]) -> dict[str, NDArray]:
    """The columns of the PLY that say something, by the stem of their properties; float32 [N, columns]."""
    return {
        "xyz": r.positions,
        # Axis-major: property axis * K + k.
        "f_offset_": r.offsets.transpose(0, 2, 1).reshape(len(masks), 3 * masks.shape[1]),
        "f_mask_": masks.astype(np.float32),
        "f_anchor_feat_": r.features,
        "scale_": r.scalings,
    }


def write_cloud(r: Reconstruction, masks: NDArray[np.bool_], path: str | Path) -> None:
    """Anchors as a Scaffold-GS point cloud, binary little-endian float32. masks: bool [N, K]."""
    from plyfile import PlyData, PlyElement

    n, values = len(masks), _ply_values(r, masks)
    names = ply_properties(masks.shape[1], r.features.shape[1])
    rotation = np.broadcast_to(np.array([1, 0, 0, 0], np.float32), (n, 4))
    zeros = np.zeros((n, 3), np.float32)
    columns = [
        *(values["xyz"], zeros, values["f_offset_"], values["f_mask_"], values["f_anchor_feat_"]),
        *(zeros[:, :1], values["scale_"], rotation),
    ]
    table = np.concatenate(columns, axis=1).astype("<f4").view([(name, "<f4") for name in names]).reshape(n)
    PlyData([PlyElement.describe(table, "vertex")], byte_order="<").write(str(path))


# --- reading ----------------------------------------------------------------------------------------------------------


def read_folder(path: str | Path) -> Scene:
    """The scene of a folder. Raises SceneFolderError for whatever is wrong in it.

    Without coded.safetensors, point_cloud.ply is quantised.
    """
    path = Path(path)
    if not path.is_dir():
        raise SceneFolderError(path, "there is no such folder", "give a folder that `refcodec decode` or `refcodec fit` wrote")
    for name, advice in (
        (SCENE_FILE, "it is not a scene folder, or its writing was interrupted: decode or fit again"),
        (PLY_FILE, "restore it, or decode again"),
        (NETWORKS_FILE, "restore it, or decode again"),
        (PLANES_FILE, "restore it, or decode again"),
    ):
        if not (path / name).is_file():
            raise SceneFolderError(path / name, "the file is missing", advice)
    document = _Document(path / SCENE_FILE)
    d, profile = _read_dimensions(document)
    bare = _read_document(document, d, profile, path)
    if not (path / CODED_FILE).is_file():
        return _requantise(bare, path)
    scene = _read_coded(bare, document, path)
    _compare_ply(scene, path)
    _compare_digest(scene, document)
    return scene


class _Document:
    """scene.json, field by field, each checked as it is read. Fields are named by dotted paths."""

    def __init__(self, file: Path) -> None:
        self.file = file
        try:
            self.root = json.loads(file.read_text(encoding="utf-8"))
        except (ValueError, RecursionError) as error:
            raise SceneFolderError(file, f"it is not JSON ({error})", "restore it, or decode again") from None
        if not isinstance(self.root, dict) or self.root.get("format") != FORMAT:
            raise SceneFolderError(file, f'its "format" is not "{FORMAT}"', "give a folder that `refcodec decode` or `refcodec fit` wrote")
        self.integer("version", VERSION, VERSION)

    def fault(self, name: str, problem: str) -> SceneFolderError:
        return SceneFolderError(self.file, f'"{name}" {problem}', "correct the field, or decode again")

    def value(self, name: str) -> Any:
        found = self.root
        for key, index in re.findall(r"(\w+)|\[(\d+)\]", name):
            if isinstance(found, dict) and key in found:
                found = found[key]
            elif isinstance(found, list) and index and int(index) < len(found):
                found = found[int(index)]
            else:
                raise self.fault(name, "is missing")
        return found

    def _checked(self, name: str, value: Any, low: int, high: int) -> int:
        if not isinstance(value, int) or isinstance(value, bool) or not low <= value <= high:
            raise self.fault(name, f"is {value!r}, an integer from {low} to {high} is required")
        return value

    def integer(self, name: str, low: int, high: int) -> int:
        return self._checked(name, self.value(name), low, high)

    def _list(self, name: str, count: int | None) -> list[Any]:
        values = self.value(name)
        if not isinstance(values, list) or (count is not None and len(values) != count):
            raise self.fault(name, f"is not a list{'' if count is None else f' of {count}'}")
        return values

    def integers(self, name: str, count: int | None, low: int, high: int) -> list[int]:
        return [self._checked(f"{name}[{i}]", v, low, high) for i, v in enumerate(self._list(name, count))]

    def _float(self, name: str, value: Any) -> float:
        """A finite float32."""
        number = np.float32(np.nan)
        if isinstance(value, int | float) and not isinstance(value, bool):
            with np.errstate(over="ignore"), contextlib.suppress(OverflowError):
                number = np.float32(value)
        if not np.isfinite(number):
            raise self.fault(name, f"is {value!r}, a finite number is required")
        return float(number)

    def float(self, name: str) -> float:
        return self._float(name, self.value(name))

    def floats(self, name: str, count: int) -> list[Any]:
        return [self._float(f"{name}[{i}]", v) for i, v in enumerate(self._list(name, count))]


def _read_dimensions(doc: _Document) -> tuple[Dimensions, int]:
    names = {p.name: number for number, p in PROFILES.items()}
    profile = doc.value("profile")
    if not isinstance(profile, str) or profile not in names:
        raise doc.fault("profile", f"is {profile!r}, one of {', '.join(names)} is required")

    def one(name: str, high: int = 255) -> int:
        return doc.integer(f"dimensions.{name}", 0, high)

    def several(name: str) -> tuple[int, ...]:
        return tuple(doc.integers(f"dimensions.{name}", None, 0, 255))

    d = Dimensions(
        one("offset_count"),
        several("slices"),
        one("plane_channels"),
        one("frequency_count"),
        one("plane_size", 65535),
        several("hyper_width"),
        several("sarm_width"),
        several("carm_width"),
        one("render_width"),
    )
    fault = dimension_fault(PROFILES[names[profile]], d)
    if fault:
        raise doc.fault("dimensions", f"do not fit the profile: {fault[1]}")
    return d, names[profile]


def _read_document(doc: _Document, d: Dimensions, profile: int, path: Path) -> Scene:
    """All of the scene but what coded.safetensors holds; it has no anchors."""
    base_step = doc.floats("base_step", 3)
    if not all(BASE_STEP_MIN <= step <= BASE_STEP_MAX for step in base_step):
        raise doc.fault("base_step", f"is {base_step}, {BASE_STEP_MIN} to {BASE_STEP_MAX} is allowed")
    origin = doc.integers("grid.origin", 3, 1 - ORIGIN_BOUND, ORIGIN_BOUND - 1)
    grid = PositionGrid(
        (origin[0], origin[1], origin[2]),
        doc.integer("grid.scale_mantissa", 1, 65535),
        doc.integer("grid.scale_exponent", -SCALE_EXPONENT_MAX, SCALE_EXPONENT_MAX),
    )
    lanes = Lanes(*(doc.integer(f"lanes.{name}", 0, LANES_LOG2_MAX) for name in ("plane", "mask", "attribute")))
    frame = Frame(
        np.array([doc.integers(f"frame.matrix[{i}]", 3, 1 - MATRIX_BOUND, MATRIX_BOUND - 1) for i in range(3)], dtype=np.int64),
        np.array(doc.integers("frame.translation", 3, 1 - TRANSLATION_BOUND, TRANSLATION_BOUND - 1), dtype=np.int64),
        np.array(doc.integers("frame.shift", 3, 0, FRAME_SHIFT_MAX), dtype=np.int64),
        np.array(doc.integers("frame.low", 3, -FRAME_RANGE_BOUND, FRAME_RANGE_BOUND - 1), dtype=np.int64),
        np.array(doc.integers("frame.high", 3, -FRAME_RANGE_BOUND, FRAME_RANGE_BOUND), dtype=np.int64),
    )
    planes = _tensors(path / PLANES_FILE, {"planes": ((PLANES, d.plane_channels, d.plane_size, d.plane_size), np.int16)})["planes"]
    if planes.min(initial=0) < -PLANE_SYMBOL_MAX:
        raise SceneFolderError(path / PLANES_FILE, "a plane symbol is -32768", f"keep symbols within +-{PLANE_SYMBOL_MAX}")
    return Scene(
        profile,
        d,
        doc.integer("chunk_size", *PROFILES[profile].chunk_size),
        lanes,
        (base_step[0], base_step[1], base_step[2]),
        grid,
        _read_render(doc),
        frame,
        doc.integer("plane_shift", 0, PLANE_SHIFT_MAX),
        np.array(doc.integers("carm_shift", d.carm_inputs, 0, CARM_SHIFT_MAX), dtype=np.uint8),
        _read_networks(d, path / NETWORKS_FILE),
        planes,
        np.array(doc.integers("mask_model", context_count(d.offset_count), 1, TOTAL - 1), dtype=np.uint16),
        np.zeros((0, 3), np.float16),
        np.zeros((0, d.offset_count), bool),
        Attributes(
            np.zeros((0, d.features), np.int32),
            np.zeros((0, SCALINGS), np.int32),
            np.zeros((0, d.offset_count, 3), np.int32),
            np.zeros((0, 3), np.uint8),
        ),
        _read_extensions(doc, path),
        _read_position_model(doc),
        _read_weight_scales(doc, d),
    )


def _read_weight_scales(doc: _Document, d: Dimensions) -> NDArray[np.uint8] | None:
    """SPEC 5.16, if the folder says that weights are packed."""
    if "weight_scales" not in doc.root:
        return None
    rows = [doc.integers(f"weight_scales[{i}]", 3, 0, 255) for i in range(len(layers_of(d)))]
    return np.array(rows, dtype=np.uint8)


def _read_position_model(doc: _Document) -> PositionModel | None:
    """SPEC 5.15, if the folder says that positions are packed."""
    if "position_model" not in doc.root:
        return None
    frequency = [doc.integers(f"position_model.frequency[{i}]", HALVES, 0, TOTAL) for i in range(POSITION_MODELS)]
    model = PositionModel(doc.integer("position_model.cell_shift", 0, CELL_INDEX), np.array(frequency, dtype=np.uint16))
    fault = model.fault()
    if fault is not None:
        raise doc.fault(f"position_model.frequency[{fault}]", "is not a model (SPEC.md 6.10)")
    return model


def _read_render(doc: _Document) -> RenderInfo:
    def vector(name: str, count: int) -> Any:
        return tuple(doc.floats(f"render.{name}", count))

    background = doc.integers("render.background", 3, 0, 255)
    return RenderInfo(
        (background[0], background[1], background[2]),
        doc.integer("render.up_axis", 0, 5),
        doc.float("render.near_plane"),
        doc.float("render.distance_unit"),
        doc.float("render.alpha_max"),
        doc.float("render.low_pass"),
        doc.integer("render.camera_width", 1, 65535),
        doc.integer("render.camera_height", 1, 65535),
        vector("camera_focal", 2),
        vector("camera_rotation", 4),
        vector("camera_translation", 3),
    )


def _read_extensions(doc: _Document, path: Path) -> tuple[tuple[int, int, bytes], ...]:
    entries = doc.value("extensions")
    if not isinstance(entries, list) or not all(isinstance(e, dict) for e in entries):
        raise doc.fault("extensions", "is not a list of objects")
    found: list[tuple[int, int, bytes]] = []
    for i in range(len(entries)):
        at = f"extensions[{i}]"
        kind = doc.integer(f"{at}.type", found[-1][0] + 1 if found else 1, 127)
        # A name of our own making: scene.json cannot point outside the folder.
        if doc.value(f"{at}.file") != extension_name(kind):
            raise doc.fault(f"{at}.file", f"is {doc.value(f'{at}.file')!r}, {extension_name(kind)!r} is required")
        if not (path / extension_name(kind)).is_file():
            raise SceneFolderError(
                path / extension_name(kind), "the file is missing", f'restore it, or delete its entry in "extensions" of {SCENE_FILE}'
            )
        found.append((kind, doc.integer(f"{at}.mode", 0, 255), (path / extension_name(kind)).read_bytes()))
    return tuple(found)


def _tensors(file: Path, wanted: dict[str, tuple[tuple[int, ...], type[np.generic]]]) -> dict[str, NDArray]:
    """The arrays of a safetensors file: exactly the wanted ones, of the wanted shapes and types."""
    from safetensors import SafetensorError
    from safetensors.numpy import load_file

    try:
        arrays = load_file(file)
    # A type that NumPy lacks is a KeyError or TypeError of the safetensors package.
    except (SafetensorError, ValueError, KeyError, TypeError, OSError) as error:
        raise SceneFolderError(file, f"it cannot be read ({error})", "restore it, or decode again") from None
    for name in sorted(wanted.keys() | arrays.keys()):
        if name not in arrays:
            raise SceneFolderError(file, f"the array {name} is missing", "restore it, or decode again")
        if name not in wanted:
            raise SceneFolderError(file, f"the array {name} is not known", f"remove it, or correct the dimensions in {SCENE_FILE}")
        (shape, dtype), array = wanted[name], arrays[name]
        if array.shape != shape or array.dtype != dtype:
            problem = f"{name} is {array.dtype}{list(array.shape)}, {np.dtype(dtype)}{list(shape)} is required"
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
        name: [(arrays[f"{name}.{i}.weight"], arrays[f"{name}.{i}.bias"]) for i in range(len(layers))] for name, layers in shapes.items()
    }


def _read_coded(bare: Scene, doc: _Document, path: Path) -> Scene:
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
    advice = f"restore it, or delete it so that encode quantises {PLY_FILE} anew"
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
    return replace(bare, positions=bits.view(np.float16), masks=masks, attributes=attributes)


def _compare_ply(scene: Scene, path: Path) -> None:
    """Refuses a PLY that is not the reconstruction of coded.safetensors: encoding would silently leave the edit out."""
    file = path / PLY_FILE
    advice = f"if {PLY_FILE} is the one to encode, delete {CODED_FILE} so that encode quantises it anew; otherwise decode again"
    columns = _Columns(file)
    if columns.count != scene.anchor_count:
        raise SceneFolderError(file, f"it has {columns.count} anchors, {CODED_FILE} has {scene.anchor_count}", advice)
    for stem, wanted in _ply_values(reconstruct(scene), scene.masks).items():
        names = columns.names(stem)
        if not names and stem == "f_mask_":
            found = np.ones_like(wanted)
        elif len(names) != wanted.shape[1]:
            raise SceneFolderError(file, f"it has {len(names)} properties {stem}*, {wanted.shape[1]} are required", advice)
        else:
            found = columns.array(names)
        differs = found.view(np.uint32) != np.ascontiguousarray(wanted).view(np.uint32)
        if differs.any():
            anchor, column = (int(i) for i in np.argwhere(differs)[0])
            name = names[column] if names else f"f_mask_{column}"
            problem = f"{name} of anchor {anchor} is {found[anchor, column]}, {CODED_FILE} gives {wanted[anchor, column]}"
            raise SceneFolderError(file, problem, advice)


def _compare_digest(scene: Scene, doc: _Document) -> None:
    """Refuses arrays that are not those that the digest was made of; a folder without a digest is not checked."""
    if "digest" not in doc.root:
        return
    whole, parts = digest(scene)
    for name, value in {**parts, "whole": whole}.items():
        if doc.value(f"digest.{name}") != value:
            problem = f'"digest.{name}" does not fit the folder\'s {"files" if name == "whole" else name}'
            raise SceneFolderError(doc.file, problem, 'decode again, or delete "digest" if the change is meant')


def _requantise(bare: Scene, path: Path) -> Scene:
    """The scene of a folder without coded.safetensors: point_cloud.ply, quantised with all that the folder gives."""
    from .quantise import quantise

    d, file = bare.dimensions, path / PLY_FILE
    cloud = read_cloud(file)
    for name, found, wanted in (("offsets", cloud.masks.shape[1], d.offset_count), ("features", cloud.features.shape[1], d.features)):
        if found != wanted:
            raise SceneFolderError(
                file, f"its anchors have {found} {name}, {SCENE_FILE} says {wanted}", "use the point cloud that the networks fit"
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
    return replace(scene, extensions=bare.extensions)


# --- point clouds -----------------------------------------------------------------------------------------------------


class _Columns:
    """The vertex properties of a PLY file as float32 columns."""

    def __init__(self, file: Path) -> None:
        from plyfile import PlyData

        self.file = file
        try:
            self.data = PlyData.read(str(file))["vertex"].data
        except KeyError:
            raise SceneFolderError(file, "it has no vertices", "give a point cloud in the layout of Scaffold-GS") from None
        # plyfile answers bad bytes with many types; whatever it is, the file cannot be read.
        except Exception as error:
            raise SceneFolderError(file, f"it is not a readable PLY file ({error})", "export the point cloud again") from None
        self.count = len(self.data)

    def names(self, stem: str) -> list[str]:
        """The properties of a stem in the order of their numbers; "xyz" stands for x, y and z."""
        known = self.data.dtype.names
        if stem == "xyz":
            return [name for name in ("x", "y", "z") if name in known]
        numbered = [name for name in known if re.fullmatch(re.escape(stem) + r"\d+", name)]
        numbered.sort(key=lambda name: int(name[len(stem) :]))
        if [name[len(stem) :] for name in numbered] != [str(i) for i in range(len(numbered))]:
            raise SceneFolderError(self.file, f"the properties {stem}* are not numbered from 0", "export the point cloud again")
        return numbered

    def array(self, names: Sequence[str]) -> NDArray[np.float32]:
        """Some properties as float32 [N, columns]."""
        out = np.empty((self.count, len(names)), np.float32)
        for i, name in enumerate(names):
            if self.data.dtype[name].kind not in "fiu":
                raise SceneFolderError(self.file, f"the property {name} is a list", "export the point cloud again")
            out[:, i] = self.data[name]
        return out


def read_cloud(path: str | Path) -> AnchorCloud:
    """A trained Scaffold-GS, HAC or CAT-3DGS point_cloud.ply, or that of a scene folder, as an AnchorCloud.

    Masks: where f_mask_* holds nothing but 0 and 1 it is the mask; otherwise it holds the logits of HAC and CAT-3DGS, and an offset
    is kept where their sigmoid is above 0.01 (CAT-3DGS also weighs it with view counts, which the file does not have). Without
    f_mask_* every offset is kept. Raises SceneFolderError.
    """
    from .quantise import AnchorCloud

    file = Path(path)
    if not file.is_file():
        raise SceneFolderError(file, "there is no such file", "give a point_cloud.ply in the layout of Scaffold-GS")
    columns = _Columns(file)
    advice = "give a point_cloud.ply in the layout of Scaffold-GS"
    names = {stem: columns.names(stem) for stem in ("xyz", "f_offset_", "f_mask_", "f_anchor_feat_", "scale_")}
    count = len(names["f_offset_"]) // 3
    for stem, wanted in (("xyz", 3), ("f_offset_", 3 * max(count, 1)), ("scale_", SCALINGS)):
        if len(names[stem]) != wanted:
            raise SceneFolderError(file, f"it has {len(names[stem])} properties {stem}*, {wanted} are required", advice)
    if len(names["f_mask_"]) not in (0, count):
        raise SceneFolderError(file, f"it has {len(names['f_mask_'])} properties f_mask_*, {count} are required", advice)
    if not names["f_anchor_feat_"]:
        raise SceneFolderError(file, "it has no properties f_anchor_feat_*", advice)
    arrays = {stem: columns.array(n) for stem, n in names.items()}
    for stem, array in arrays.items():
        if not np.isfinite(array).all():
            raise SceneFolderError(file, f"a value of {stem} is NaN or infinite", "remove that anchor, or export the point cloud again")
    mask = arrays["f_mask_"]
    binary = bool(((mask == 0) | (mask == 1)).all())
    return AnchorCloud(
        positions=arrays["xyz"],
        features=arrays["f_anchor_feat_"],
        scalings=arrays["scale_"],
        offsets=np.ascontiguousarray(arrays["f_offset_"].reshape(columns.count, 3, count).transpose(0, 2, 1)),
        masks=(mask > (0 if binary else MASK_LOGIT_MIN)) if names["f_mask_"] else np.ones((columns.count, count), bool),
    )
