"""The folder of a trained Scaffold-GS before quantisation, for comparison with coded scenes.

point_cloud.ply         anchors, in the Scaffold-GS checkpoint layout, world units
networks.safetensors    fp32 weights and biases of the three rendering networks, in the shapes of SPEC.md 5.8
render.json             the render information of SPEC.md 5.5, the cameras as in 5.17, the first one of which is the
                        default view, and the edge of the voxels whose corners are the anchors, if it is known
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from msgspec.structs import astuple
from numpy.typing import NDArray

from ..bitstream.cameras import NamedCamera
from ..bitstream.dimensions import RENDERING
from ..bitstream.header import RenderInfo
from ..bitstream.networks import Layer
from ..bitstream.reconstruction import Reconstruction
from ..files.stage import new_file
from .arrays import read_arrays, read_networks, write_networks
from .document import FolderDocument, RenderFile, single
from .layout import NETWORKS_FILE, PLY_FILE, RENDER_FILE, UNCOMPRESSED, replace_scene, there
from .ply import read_cloud, write_cloud

AGAIN = "train it again"


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
    arrays, shapes = read_arrays(file, AGAIN), {}
    for name, out in zip(RENDERING, (offsets, 7 * offsets, 3 * offsets), strict=True):
        # The hidden layer may have any width.
        hidden = arrays[f"{name}.0.bias"].size if f"{name}.0.bias" in arrays else 0
        shapes[name] = [(hidden, features + 4), (out, hidden)]
    return read_networks(file, arrays, shapes, AGAIN)


def is_uncompressed(path: Path) -> bool:
    """Whether a folder holds an uncompressed scene. Raises SceneFolderError if its render.json is not a file."""
    return there(path / RENDER_FILE, "restore it, or remove it if the folder holds a coded scene")


def write_uncompressed(scene: Uncompressed, path: Path) -> None:
    """Writes the folder as a whole, or leaves it as it was. Errors: as for replace_scene."""
    replace_scene(path, lambda folder: _write_files(scene, folder))


def _write_files(scene: Uncompressed, path: Path) -> None:
    write_cloud(scene.values, scene.masks, path / PLY_FILE)
    write_networks(path / NETWORKS_FILE, {name: scene.networks[name] for name in RENDERING})
    with new_file(path / RENDER_FILE) as file:
        file.write(render_document(scene.render, scene.cameras, scene.voxel))


def render_document(render: RenderInfo, cameras: Sequence[NamedCamera], voxel: float | None) -> bytes:
    stated = [vars(camera) for camera in cameras]
    document: dict[str, Any] = {"format": UNCOMPRESSED, "render": vars(render), "cameras": stated}
    if voxel is not None:
        document["voxel"] = voxel
    return (json.dumps(document, indent=2) + "\n").encode()


def read_render_document(file: Path) -> tuple[RenderInfo, tuple[NamedCamera, ...], float | None]:
    """Returns the render information, the cameras and the voxel of a render.json. Raises SceneFolderError."""
    document = FolderDocument(file, RenderFile, UNCOMPRESSED, AGAIN)
    values = document.values
    listed = [values.camera] if values.camera else values.cameras
    if listed is None:
        raise document.fault("cameras", "is missing")
    cameras = tuple(NamedCamera(*single(astuple(fields))) for fields in listed)
    for number, camera in enumerate(cameras):
        if fault := camera.fault():
            raise document.fault("camera" if values.camera else f"cameras[{number}]", f"is not allowed: {fault}")
    if len({camera.name for camera in cameras}) < len(cameras):
        raise document.fault("cameras", "has two cameras with the same name; names must differ")
    return RenderInfo(*single(astuple(values.render))), cameras, single(values.voxel)


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
