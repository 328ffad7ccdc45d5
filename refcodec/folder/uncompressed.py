"""The folder of a trained Scaffold-GS before quantisation, for comparison with coded scenes.

point_cloud.ply         anchors, in the Scaffold-GS checkpoint layout, world units
networks.safetensors    fp32 weights and biases of the three rendering networks, in the shapes of SPEC.md 5.8
render.json             the render information of SPEC.md 5.5, the cameras as in 5.17, the first one of which is the
                        default view, and the edge of the voxels whose corners are the anchors, if it is known
"""

# safetensors is imported where it is used, so that the other commands start fast.
# ruff: noqa: PLC0415

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..bitstream.cameras import NamedCamera
from ..bitstream.dimensions import RENDERING
from ..bitstream.header import RenderInfo
from ..bitstream.networks import Layer
from ..bitstream.reconstruction import Reconstruction
from ..files.stage import new_file
from .arrays import read_arrays
from .document import Document
from .layout import NETWORKS_FILE, PLY_FILE, RENDER_FILE, UNCOMPRESSED, SceneFolderError, replace_scene, there
from .ply import read_cloud, write_cloud

AGAIN = "train it again"
# SPEC 5.17 counts cameras in 16 bits.
CAMERAS_MAX = (1 << 16) - 1


@dataclass(frozen=True, eq=False)
class Uncompressed:
    """A trained Scaffold-GS.

    values: the float32 attributes. masks: bool [N, K]. networks: the three rendering networks of SPEC 14.3, by name.
    cameras: the first one is the default view. voxel: the edge of the position lattice, world units, or None if it is
    not known.
    """

    values: Reconstruction
    masks: NDArray[np.bool_]
    networks: dict[str, list[Layer]]
    render: RenderInfo
    cameras: tuple[NamedCamera, ...] = ()
    voxel: float | None = None

    @property
    def anchor_count(self) -> int:
        """N, the number of anchors."""
        return len(self.values.positions)

    def sizes(self) -> dict[str, int]:
        """Returns the bytes of the float32 numbers, by the part of a coded file: positions, attributes, weights."""
        v = self.values
        weights = sum(array.size for layers in self.networks.values() for layer in layers for array in layer)
        return {
            "positions": 4 * v.positions.size,
            "attributes": 4 * (v.features.size + v.scalings.size + v.offsets.size),
            "weights": 4 * weights,
        }


def _read_networks(file: Path, offsets: int, features: int) -> dict[str, list[Layer]]:
    """Returns the rendering networks of a file (SPEC 14.3). offsets: K. features: F. Raises SceneFolderError."""
    arrays = read_arrays(file, AGAIN)
    outputs = dict(zip(RENDERING, (offsets, 7 * offsets, 3 * offsets), strict=True))
    networks: dict[str, list[Layer]] = {}
    for name, out in outputs.items():
        # The hidden layer may have any width.
        hidden = len(arrays.get(f"{name}.0.bias", ())) if arrays.get(f"{name}.0.bias", np.zeros(0)).ndim == 1 else 0
        layers = []
        for i, shape in enumerate(((hidden, features + 4), (out, hidden))):
            found = [arrays.get(f"{name}.{i}.{part}") for part in ("weight", "bias")]
            for part, array, wanted in zip(("weight", "bias"), found, (shape, shape[:1]), strict=True):
                if array is None or array.shape != wanted or array.dtype != np.float32 or not np.isfinite(array).all():
                    problem = f"{name}.{i}.{part} is missing, or not finite float32 numbers {list(wanted)}"
                    raise SceneFolderError(file, problem, AGAIN)
            layers.append((found[0], found[1]))
        networks[name] = layers  # type: ignore[assignment]
    return networks


def is_uncompressed(path: Path) -> bool:
    """Whether a folder holds an uncompressed scene. Raises SceneFolderError if its render.json is not a file."""
    return there(path / RENDER_FILE, "restore it, or remove it if the folder holds a coded scene")


def write_uncompressed(scene: Uncompressed, path: Path) -> None:
    """Writes the folder as a whole, or leaves it as it was. Errors: as for replace_scene."""
    replace_scene(path, lambda folder: _write_files(scene, folder))


def _write_files(scene: Uncompressed, path: Path) -> None:
    from safetensors.numpy import save

    write_cloud(scene.values, scene.masks, path / PLY_FILE)
    networks = {
        f"{name}.{index}.{part}": np.ascontiguousarray(value)
        for name in RENDERING
        for index, layer in enumerate(scene.networks[name])
        for part, value in zip(("weight", "bias"), layer, strict=True)
    }
    with new_file(path / NETWORKS_FILE) as file:
        file.write(save(networks))
    with new_file(path / RENDER_FILE) as file:
        file.write(render_document(scene.render, scene.cameras, scene.voxel))


def render_document(render: RenderInfo, cameras: Sequence[NamedCamera], voxel: float | None) -> bytes:
    """Returns render.json."""
    stated = [vars(camera) for camera in cameras]
    document: dict[str, Any] = {"format": UNCOMPRESSED, "render": vars(render), "cameras": stated}
    if voxel is not None:
        document["voxel"] = voxel
    return (json.dumps(document, indent=2) + "\n").encode()


def read_render_document(file: Path) -> tuple[RenderInfo, tuple[NamedCamera, ...], float | None]:
    """Returns the render information, the cameras and the voxel of a render.json. Raises SceneFolderError."""
    from .read import read_render

    document = Document(file, UNCOMPRESSED, AGAIN)
    render, cameras = read_render(document), _read_cameras(document)
    voxel = document.float("voxel") if "voxel" in document.root else None
    if voxel is not None and voxel <= 0:
        raise document.fault("voxel", f"is {voxel}, but must be a number above 0")
    return render, cameras, voxel


def _read_cameras(doc: Document) -> tuple[NamedCamera, ...]:
    """Returns the cameras. Earlier folders have one, named "camera". Raises SceneFolderError."""
    if "camera" in doc.root:
        return (_read_camera(doc, "camera"),)
    listed = doc.value("cameras")
    if not isinstance(listed, list) or len(listed) > CAMERAS_MAX:
        raise doc.fault("cameras", f"is not a list of at most {CAMERAS_MAX} cameras")
    found = tuple(_read_camera(doc, f"cameras[{number}]") for number in range(len(listed)))
    if len({camera.name for camera in found}) < len(found):
        raise doc.fault("cameras", "has two cameras with the same name; names must differ")
    return found


def _read_camera(doc: Document, at: str) -> NamedCamera:
    """Returns the camera of a field. Raises SceneFolderError."""

    def vector(name: str, count: int) -> Any:
        return tuple(doc.floats(f"{at}.{name}", count))

    name = doc.value(f"{at}.name")
    if not isinstance(name, str):
        raise doc.fault(f"{at}.name", "is not text")
    camera = NamedCamera(
        name,
        doc.integer(f"{at}.width", 1, (1 << 32) - 1),
        doc.integer(f"{at}.height", 1, (1 << 32) - 1),
        vector("focal", 2),
        vector("principal_point", 2),
        vector("rotation", 4),
        vector("translation", 3),
    )
    fault = camera.fault()
    if fault:
        raise doc.fault(at, f"is not allowed: {fault}")
    return camera


def read_uncompressed(path: Path) -> Uncompressed:
    """Returns the scene of a folder. Raises SceneFolderError if one of its files is missing or cannot be read."""
    cloud = read_cloud(path / PLY_FILE)
    render, cameras, voxel = read_render_document(path / RENDER_FILE)
    networks = _read_networks(path / NETWORKS_FILE, cloud.masks.shape[1], cloud.features.shape[1])
    return Uncompressed(
        Reconstruction(
            cloud.positions,
            cloud.features,
            cloud.scalings,
            np.where(cloud.masks[:, :, None], cloud.offsets, np.float32(0)),
        ),
        cloud.masks,
        networks,
        render,
        cameras,
        voxel,
    )
