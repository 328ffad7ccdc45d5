"""Anchors from a coloured point cloud: real input for the codec where no trained scene is at hand (SPEC.md B.1).

Positions follow Scaffold-GS (unique voxels of the points). Attributes are measured from the points around an anchor, so
that they depend on place and on each other as learned ones do.
"""

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ..bitstream.dimensions import Dimensions
from ..bitstream.networks import Layer
from ..encoder.cloud import AnchorCloud
from ..folder.georeference import far_offset

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]

FEATURES, OFFSETS = 50, 10
# Points that describe the surface around an anchor, and a wider ring for its surroundings' colour.
NEAR, WIDE = 16, 64
# An offset is kept if its point is within this many voxels of the anchor.
KEEP_RADIUS = 4.0
# Bits of a voxel's mantissa: an integer times it is exact in float32 up to 2^12, and in a position grid always.
VOXEL_BITS = 12
# Colours are kept this far from 0 and 1 before their logit is taken.
COLOUR_MARGIN = 0.02
BLOCK = 16384


@dataclass(frozen=True, eq=False)
class PointCloud:
    """points: float32 [M, 3] in world units; colours: uint8 [M, 3], RGB.

    offset: subtracted from the points, float64 [3]. notes: what was changed or left out.
    """

    points: F32
    colours: NDArray[np.uint8]
    offset: F64 = field(default_factory=lambda: np.zeros(3))
    notes: tuple[str, ...] = ()


def read_points(path: str | Path) -> PointCloud:
    """Points of COLMAP (points3D.txt or .bin), of a PLY file, or an npz with `means3d` and `colors`, [M, 3] each.

    The colours of an npz are integers from 0 to 255 or floats from 0 to 1, those of a PLY file uchar. Raises ValueError
    for any other. Points far from all others are left out.
    """
    # They need Pillow, which a fit of a scene does not.
    from ..photographs import colmap, transforms  # noqa: PLC0415
    from ..photographs.photographs import far_points  # noqa: PLC0415

    path = Path(path)
    readers = {".txt": colmap.read_points, ".bin": colmap.read_points, ".ply": transforms.read_points}
    if path.suffix not in (".npz", *readers):
        raise ValueError(f"{path}: COLMAP's points3D.txt or points3D.bin, a .ply or an .npz expected")
    stated, colours = (readers.get(path.suffix) or _read_archive)(path)
    if stated.shape != colours.shape or stated.ndim != 2 or stated.shape[1] != 3:
        raise ValueError(f"{path}: points {stated.shape} and colours {colours.shape} are not both [M, 3]")
    finite = np.isfinite(stated).all(axis=1)
    if not finite.any():
        raise ValueError(f"{path}: it has no points, or all are NaN or infinite: write them again")
    near, notes = far_points(stated, stated[finite])
    offset = far_offset(stated[near])
    if offset.any():
        notes.append(f"far from the world's origin for its size: {offset.tolist()} is subtracted from all places")
    return PointCloud((stated[near] - offset).astype(np.float32), colours[near], offset, tuple(notes))


def _read_archive(path: Path) -> tuple[NDArray[Any], NDArray[np.uint8]]:
    try:
        with np.load(path) as archive:
            if not {"means3d", "colors"} <= set(archive.files):
                raise ValueError(f"it has the arrays {archive.files}, but needs means3d and colors")
            return archive["means3d"].astype(np.float64), _eight_bits(archive["colors"])
    except (FileNotFoundError, IsADirectoryError, PermissionError, MemoryError):
        raise
    # NumPy, zipfile and zlib raise many types for bad bytes. All of them mean that the file cannot be read.
    except Exception as error:
        raise ValueError(f"{path} cannot be read ({error})") from None


def _eight_bits(colours: NDArray[Any]) -> NDArray[np.uint8]:
    """Returns colours as integers from 0 to 255. Raises ValueError for others than integers of these and 0.0 to 1.0."""
    whole = colours.dtype.kind in "iu"
    # Written so that NaN fails.
    if colours.dtype.kind not in "fiu" or not ((colours >= 0) & (colours <= (255 if whole else 1))).all():
        raise ValueError("its colors are neither integers from 0 to 255 nor floats from 0 to 1")
    return (colours if whole else np.rint(colours.astype(np.float64) * 255)).astype(np.uint8)


def default_voxel(points: F32) -> float:
    """Scaffold-GS's voxel for v = 0: the median distance to the nearest other point, with a mantissa of 12 bits."""
    if len(points) < 2:
        return 1.0
    distance = cKDTree(points.astype(np.float64)).query(points.astype(np.float64), 2)[0][:, 1]
    median = float(np.median(distance[distance > 0])) if (distance > 0).any() else 1.0
    return short_mantissa(median)


def short_mantissa(value: float) -> float:
    """The nearest number with a mantissa of 12 bits."""
    fraction, exponent = math.frexp(value)
    return math.ldexp(round(fraction * (1 << VOXEL_BITS)), exponent - VOXEL_BITS)


def voxelise(points: F32, colours: NDArray[np.uint8], voxel: float | None = None) -> AnchorCloud:
    """Anchors at unique(round(p / v)) * v, K = 10 offsets to the nearest points, F = 50 features of the points around.

    points: [M, 3], world units. colours: uint8 [M, 3]. voxel: v, world units, None for default_voxel. position + offset
    * exp(scaling[:3]) of a kept offset is a point of the cloud. Raises ValueError for an empty cloud.
    """
    if len(points) == 0:
        raise ValueError("there are no points")
    v = short_mantissa(voxel) if voxel else default_voxel(points)
    if not v > 0:
        raise ValueError(f"a voxel of {voxel} is not positive")
    p = points.astype(np.float64)
    lattice, owner = np.unique(np.round(p / v).astype(np.int64), axis=0, return_inverse=True)
    anchors: F64 = lattice.astype(np.float64) * v
    c = np.clip(colours.astype(np.float64) / 255, COLOUR_MARGIN, 1 - COLOUR_MARGIN)
    logits = np.log(c / (1 - c))
    tree = cKDTree(p)
    count = np.bincount(owner.reshape(-1), minlength=len(anchors))
    parts = [
        _describe(anchors[i : i + BLOCK], count[i : i + BLOCK], tree, p, logits, v)
        for i in range(0, len(anchors), BLOCK)
    ]
    features, scalings, offsets, masks = (np.concatenate(column) for column in zip(*parts, strict=True))
    # Colours do not change, for display. The following channels are each scaled to a deviation of one.
    features[:, 3:] /= np.maximum(features[:, 3:].std(axis=0), 1e-3)
    kinds = features.astype(np.float32), scalings.astype(np.float32), offsets.astype(np.float32)
    return AnchorCloud(anchors.astype(np.float32), *kinds, masks)


def _describe(
    anchors: F64, count: NDArray[np.int64], tree: cKDTree, points: F64, logits: F64, voxel: float
) -> tuple[F64, F64, F64, NDArray[np.bool_]]:
    """Features [n, 50], scalings [n, 6], offsets [n, 10, 3] and masks [n, 10] of some anchors."""
    distance, index = tree.query(anchors, min(WIDE, len(points)))
    distance, index = distance.reshape(len(anchors), -1), index.reshape(len(anchors), -1)
    # A tiny cloud has fewer points than neighbours: the farthest one stands in for the rest.
    pad = WIDE - index.shape[1]
    distance, index = (np.pad(a, ((0, 0), (0, pad)), mode="edge") for a in (distance, index))
    away = points[index[:, :NEAR]] - anchors[:, None]
    colour = logits[index]
    floor = voxel / 4

    spread = np.sqrt((away[:, :OFFSETS] ** 2).mean(axis=1))
    size = np.sqrt((away[:, :4] ** 2).mean(axis=1))
    scalings = np.log(np.maximum(np.concatenate([spread, size], axis=1), floor))
    offsets = away[:, :OFFSETS] / np.exp(scalings[:, None, :3])
    masks = distance[:, :OFFSETS] <= KEEP_RADIUS * voxel
    masks[:, 0] = True

    centre = away.mean(axis=1)
    around = away - centre[:, None]
    variance, axes = np.linalg.eigh(np.einsum("nki,nkj->nij", around, around) / NEAR)
    deviation = np.sqrt(np.maximum(variance, 0)) + floor
    normal = axes[:, :, 0]
    # The sign of an eigenvector is free: the largest component is made positive.
    largest = np.take_along_axis(normal, np.abs(normal).argmax(axis=1)[:, None], axis=1)
    normal = normal * np.where(largest < 0, -1, 1)
    near = colour[:, :NEAR]
    own, mean = near[:, 0], near.mean(axis=1)
    change = near - mean[:, None]
    # Slope of each colour along each axis, in colour per deviation of the points along it.
    slope = np.einsum("nki,nkc->nic", around, change) / NEAR / deviation.mean(axis=1)[:, None, None]
    ratio = np.log(deviation)
    features = np.concatenate(
        [
            own,
            np.log(distance[:, NEAR - 1 : NEAR] + floor),
            np.log(count)[:, None],
            normal,
            mean - own,
            np.log(near.std(axis=1) + 0.05),
            ratio - ratio.mean(axis=1)[:, None],
            centre / np.exp(scalings[:, :3]),
            slope.reshape(len(anchors), 9),
            np.log(distance[:, [3, WIDE - 1]] + floor),
            colour.mean(axis=1) - own,
            (near[:, 1:6] - own[:, None]).reshape(len(anchors), 15),
            np.log(colour.std(axis=1).mean(axis=1) + 0.05)[:, None],
        ],
        axis=1,
    )
    return features, scalings, offsets, masks


def display_networks(dimensions: Dimensions) -> dict[str, list[Layer]]:
    """Rendering networks that show an anchor's offsets as balls of its colour: features 0 to 2 are the logits of RGB.

    They are float32 layers as SPEC 5.8 stores them: opacity (tanh) about 1, scale logits 0, quaternions (1, 0, 0, 0),
    colour (sigmoid). Raises ValueError if the dimensions have fewer than three features or six hidden units.
    """
    if dimensions.features < 3 or dimensions.render_width < 6:
        raise ValueError("three features and six hidden units are needed to pass a colour on")
    shapes = dimensions.network_shapes()
    networks = {
        name: [(np.zeros(shape, np.float32), np.zeros(shape[0], np.float32)) for shape in shapes[name]]
        for name in ("opacity", "covariance", "colour")
    }
    networks["opacity"][1][1][:] = 4
    networks["covariance"][1][1].reshape(-1, 7)[:, 3] = 1
    hidden, out = networks["colour"]
    for channel in range(3):
        # x = relu(x) - relu(-x)
        hidden[0][2 * channel, channel], hidden[0][2 * channel + 1, channel] = 1, -1
        out[0][channel::3, 2 * channel], out[0][channel::3, 2 * channel + 1] = 1, -1
    return networks
