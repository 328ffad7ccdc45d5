"""The input of `refcodec fit`: points, which become anchors here, or a scene with its rendering networks."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..bitstream.cameras import NamedCamera, cameras
from ..bitstream.dimensions import RENDERING
from ..bitstream.header import PositionGrid, RenderInfo
from ..bitstream.metadata import metadata
from ..bitstream.networks import Layer
from ..bitstream.reconstruction import Reconstruction, reconstruct
from ..encoder.cloud import AnchorCloud
from ..files.ply import PlyError, property_names
from ..folder.georeference import stated_offset
from ..folder.layout import NETWORKS_FILE, PLY_FILE, RENDER_FILE, SCENE_FILE, there
from ..folder.read import read_folder
from ..folder.uncompressed import is_uncompressed, read_uncompressed
from ..rendering.gaussians import check_view_dependent
from .voxelise import default_voxel, read_points, short_mantissa, voxelise

_ADVICE = "restore the file, or give another scene folder"


@dataclass(frozen=True, eq=False)
class Given:
    """Anchors to fit an entropy model to.

    voxel: edge of the lattice of their positions, world units; None if it is not known. grid: that of the coded scene
    that they come from. networks: the rendering networks of SPEC 14.3; None where features 0 to 2 are logits of colour,
    as voxelise makes them. render: SPEC 6.5. cameras: those that it states. base_step: of features, scalings and
    offsets; None to choose them. offset: subtracted from all places, float64 [3]. notes: what was changed or left out.
    """

    cloud: AnchorCloud
    voxel: float | None = None
    grid: PositionGrid | None = None
    networks: dict[str, list[Layer]] | None = None
    render: RenderInfo = field(default_factory=RenderInfo)
    cameras: tuple[NamedCamera, ...] = ()
    base_step: tuple[float, float, float] | None = None
    offset: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))
    notes: tuple[str, ...] = ()


def read_given(path: str | Path, voxel: float | None = None) -> Given:
    """Points (as voxelise.read_points), a scene folder of refcodec, or the point_cloud.ply in one.

    voxel: edge of the lattice, None for the median distance of the points, or for the edge that a scene states. Raises
    ValueError for anything else; SceneFolderError is one.
    """
    path = Path(path)
    voxel = voxel and short_mantissa(voxel)
    if path.is_dir():
        return _read_scene(path, voxel)
    if path.suffix == ".ply" and _is_scaffold(path):
        return _read_scene(_folder_of(path), voxel)
    points = read_points(path)
    voxel = voxel or default_voxel(points.points)
    return Given(voxelise(points.points, points.colours, voxel), voxel, offset=points.offset, notes=points.notes)


def _is_scaffold(cloud: Path) -> bool:
    """Whether a PLY file has anchors, and not only points."""
    try:
        return "f_anchor_feat_0" in property_names(cloud)
    except PlyError as error:
        raise ValueError(f"it is not a readable PLY file ({error})") from None


def _folder_of(cloud: Path) -> Path:
    """The scene folder that a PLY file is the point cloud of. Raises ValueError."""
    folder = cloud.parent
    if not there(folder / NETWORKS_FILE, _ADVICE):
        raise ValueError(
            f"{NETWORKS_FILE} is not beside it: a trained scene is fitted with its rendering networks; "
            "give a scene folder of refcodec train, fit or decode"
        )
    if cloud.name != PLY_FILE:
        raise ValueError(f"it is not {PLY_FILE}, the point cloud of the scene in {folder}: give that folder")
    return folder


def _read_scene(folder: Path, voxel: float | None) -> Given:
    if is_uncompressed(folder):
        plain = read_uncompressed(folder)
        # An edge that a scene states, with a mantissa with which a lattice is exact.
        edge = voxel or (plain.voxel and short_mantissa(plain.voxel))
        return Given(_cloud(plain.values, plain.masks), edge, None, plain.networks, plain.render, plain.cameras)
    if not there(folder / SCENE_FILE, _ADVICE):
        raise ValueError(f"{folder} has neither {SCENE_FILE} nor {RENDER_FILE}: it is not a scene folder")
    scene = read_folder(folder)
    networks = {name: scene.networks[name] for name in RENDERING}
    grid = None if voxel else scene.grid
    check_view_dependent(scene.render)
    stated, offset = tuple(cameras(scene.ancillary)), stated_offset(metadata(scene.ancillary))
    return Given(_cloud(reconstruct(scene), scene.masks), voxel, grid, networks, scene.render, stated, offset=offset)


def _cloud(values: Reconstruction, masks: np.ndarray) -> AnchorCloud:
    return AnchorCloud(values.positions, values.features, values.scalings, values.offsets, masks)
