"""Writes a scene folder."""

# safetensors is imported where it is used. A decode that fails should not wait for it.
# ruff: noqa: PLC0415

from __future__ import annotations

import json
import re
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..bitstream.attributes import KINDS
from ..bitstream.errors import BitstreamError
from ..bitstream.header import MAJOR
from ..bitstream.limits import PROFILES
from ..bitstream.positions import PositionModel
from ..bitstream.reconstruction import digest, reconstruct
from ..bitstream.scene import Scene
from ..files.stage import new_file
from .layout import CODED_FILE, FORMAT, NETWORKS_FILE, PLANES_FILE, PLY_FILE, SCENE_FILE, ancillary_name
from .ply import write_cloud
from .replace import replace_scene


def write_folder(scene: Scene, path: str | Path, damage: dict[int, BitstreamError] | None = None) -> None:
    """Writes a scene folder. damage: the damage of a Parsed, which is noted in scene.json.

    The folder has the whole scene then, or is as it was (replace_scene). Raises SceneFolderError if `path` is a file,
    or a directory with something else in it.
    """
    replace_scene(Path(path), lambda folder: _write_files(scene, folder, damage or {}))


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
    _put(path / NETWORKS_FILE, save(networks))
    _put(path / PLANES_FILE, save({"planes": np.ascontiguousarray(scene.planes)}))
    coded: dict[str, NDArray] = {
        "positions": scene.positions.view(np.uint16),
        "masks": scene.masks.astype(np.uint8),
        "steps": a.steps,
    }
    coded |= {kind: getattr(a, kind) for kind in KINDS}
    _put(path / CODED_FILE, save({name: np.ascontiguousarray(value) for name, value in coded.items()}))
    for number, section in enumerate(scene.ancillary):
        _put(path / ancillary_name(number, section.type), section.content)
    _put(path / SCENE_FILE, _json_text(_scene_document(scene, damage)).encode())


def _put(path: Path, content: bytes) -> None:
    with new_file(path) as file:
        file.write(content)


def _short(value: Any) -> Any:
    """Returns a value for JSON. A float becomes the one with the shortest text that reads back as the same float32.

    Tuples become lists. Other values stay as they are.
    """
    if isinstance(value, tuple):
        return [_short(v) for v in value]
    return float(str(np.float32(value))) if isinstance(value, float) else value


def _scene_document(scene: Scene, damage: dict[int, BitstreamError]) -> dict[str, Any]:
    whole, parts = digest(scene)
    document = {
        "format": FORMAT,
        "version": MAJOR,
        "profile": PROFILES[scene.profile].name,
        "anchor_count": scene.anchor_count,
        "dimensions": vars(scene.dimensions),
        "chunk_size": scene.chunk_size,
        "lanes": vars(scene.lanes),
        "base_step": _short(scene.base_step),
        "grid": vars(scene.grid),
        "render": {name: _short(value) for name, value in vars(scene.render).items()},
        "frame": scene.frame and {f.name: getattr(scene.frame, f.name).tolist() for f in fields(scene.frame)},
        "plane_shift": scene.plane_shift,
        "carm_shift": scene.carm_shift.tolist(),
        "mask_model": scene.mask_model.tolist(),
        **_position_document(scene.position_model),
        **({} if scene.weight_scales is None else {"weight_scales": scene.weight_scales.tolist()}),
        **_coding_document(scene),
        "ancillary": [
            {"type": a.type.decode("ascii"), "mode": a.mode, "after": a.after, "file": ancillary_name(number, a.type)}
            for number, a in enumerate(scene.ancillary)
        ],
        "digest": {"whole": whole, **parts},
    }
    if damage:
        document["dropped_chunks"] = [
            {"chunk": number, **json.loads(error.to_json())} for number, error in sorted(damage.items())
        ]
    return document


def _position_document(model: PositionModel | None) -> dict[str, Any]:
    """Returns what packed positions were coded with. With it, the folder gives the same file again."""
    return (
        {}
        if model is None
        else {"position_model": {"cell_shift": model.cell_shift, "frequency": model.frequency.tolist()}}
    )


def _coding_document(scene: Scene) -> dict[str, Any]:
    """Returns the coding parameters that an encoder chooses by itself if they are not there."""
    found: dict[str, Any] = {}
    if scene.chunk_anchors is not None:
        found["chunk_anchors"] = list(scene.chunk_anchors)
    if scene.position_forms is not None:
        found["position_forms"] = list(scene.position_forms)
    if scene.weight_forms is not None:
        found["weight_forms"] = scene.weight_forms.tolist()
    if scene.minor or scene.later:
        found |= {"minor": scene.minor, "later": list(scene.later)}
    return found


def _json_text(document: dict[str, Any]) -> str:
    """Returns indented JSON with each list of numbers on one line."""
    text = json.dumps(document, indent=2, allow_nan=False)
    return (
        re.sub(r"\[[^\[\]{}]*\]", lambda m: " ".join(m.group().split()).replace("[ ", "[").replace(" ]", "]"), text)
        + "\n"
    )
