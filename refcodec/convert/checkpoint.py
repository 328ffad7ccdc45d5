"""Trained models of the Scaffold-GS family (Scaffold-GS, HAC, HAC++, CAT-3DGS), as uncompressed scenes.

A model folder has point_cloud/iteration_N/point_cloud.ply. The rendering networks are beside that file: as state dicts
in one file, or as a TorchScript archive for each network. Their common structure is that of Scaffold-GS (Lu et al.
2024): Linear, ReLU, Linear, with the features, the unit vector from the camera and the distance as inputs.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..bitstream.dimensions import RENDERING
from ..bitstream.header import RenderInfo
from ..bitstream.limits import FEATURES_MAX, MAIN, PROFILES
from ..bitstream.networks import Layer
from ..bitstream.reconstruction import Reconstruction
from ..encoder.cloud import AnchorCloud
from ..files.ply import PlyError, check_ply_header, property_names
from ..folder.layout import PLY_FILE, RENDER_FILE, SceneFolderError, there
from ..folder.ply import read_cloud
from ..folder.uncompressed import Uncompressed, read_render_document
from ..rendering.camera import STATED, spread_cameras, up_axis
from .carried import with_distance_unit, without_carried
from .notes import CAMERAS_FILE, SETTINGS_FILE, ModelSettings, read_cameras, read_settings
from .tensors import read_state_dicts, read_torchscript

CLOUDS = "point_cloud"
# HAC, HAC++ and CAT-3DGS have one file of state dicts. Scaffold-GS has one, or a file for each network.
STATE_DICT_FILES = ("checkpoint.pth", "checkpoints.pth")
# The names that the family gives the networks of SPEC 14.3.
NETWORKS = dict(zip(("opacity_mlp", "cov_mlp", "color_mlp"), RENDERING, strict=True))
APPEARANCE, APPEARANCE_FILE = "appearance", "embedding_appearance.pt"
BANKS = ("feature_bank_mlp", "mlp_feature_bank")
# Anchor properties of models with levels of detail (Octree-GS).
LEVELS = ("level", "extra_level", "info")
# The direction, which the distance follows.
VIEW = 3
ANCHORS_MAX = max(level.anchors for level in PROFILES[MAIN].levels.values())
# An anchor is on the lattice within this distance of a corner, in voxels: float32 has about 7 digits.
NEAR = 0.01
_ADVICE = "give the folder of a trained model of Scaffold-GS, HAC, HAC++ or CAT-3DGS"

Parameters = Mapping[str, NDArray[np.float32]]


@dataclass(frozen=True, eq=False)
class Converted:
    """A converted model. appearances: number of cameras of its appearance embedding, 0 without one."""

    scene: Uncompressed
    appearances: int


def read_checkpoint(folder: Path, appearance: int | None = None) -> Converted:
    """Returns the scene of a trained model.

    folder: of the model, or one of its folders iteration_N; by default the last iteration is used. appearance: number
    of the camera whose embedding gives the colours, None for the mean of all. Raises SceneFolderError if the model
    cannot be read, or does not fit the format.
    """
    ply = _cloud_file(folder)
    root = ply.parent.parent.parent if ply.parent.parent.name == CLOUDS else ply.parent
    settings, cameras = read_settings(root / SETTINGS_FILE), read_cameras(root / CAMERAS_FILE)
    if settings.bank:
        raise _bank(root / SETTINGS_FILE)
    _check_header(ply)
    cloud = read_cloud(ply)
    _check_sizes(ply, cloud, settings)
    file, networks, embeddings = _networks(ply.parent, cloud, appearance)
    cloud, networks = without_carried(cloud, networks)
    voxel, document = settings.voxel, ply.parent / RENDER_FILE
    if there(document, _ADVICE):
        render, stated, voxel = read_render_document(document)
        networks = with_distance_unit(networks, render.distance_unit)
        if not all(np.isfinite(networks[name][0][0]).all() for name in RENDERING):
            raise SceneFolderError(document, "a weight times its distance_unit is infinite", _ADVICE)
    else:
        render = RenderInfo(
            background=(255, 255, 255) if settings.white else (0, 0, 0),
            up_axis=up_axis(cameras, cloud.positions.astype(np.float64)) if cameras else RenderInfo.up_axis,
        )
        stated = tuple(spread_cameras(cameras, STATED))
    values = Reconstruction(
        cloud.positions,
        cloud.features,
        cloud.scalings,
        np.where(cloud.masks[:, :, None], cloud.offsets, np.float32(0)),
    )
    networks, voxel = _of_one_width(file, networks), _lattice(cloud.positions, voxel)
    return Converted(Uncompressed(values, cloud.masks, networks, render, stated, voxel), embeddings)


# --- the anchors ------------------------------------------------------------------------------------------------------


def _cloud_file(folder: Path) -> Path:
    """Returns the point cloud of a model folder. Raises SceneFolderError."""
    if there(folder / PLY_FILE, _ADVICE):
        return folder / PLY_FILE
    clouds = folder / CLOUDS
    folders = [path for path in clouds.iterdir() if path.is_dir()] if clouds.is_dir() else []
    numbers = {int(path.name[10:]): path for path in folders if re.fullmatch(r"iteration_[0-9]{1,9}", path.name)}
    if not numbers:
        raise SceneFolderError(folder, f"it has neither {PLY_FILE} nor {CLOUDS}/iteration_N", _ADVICE)
    chosen = numbers[max(numbers)] / PLY_FILE
    if not there(chosen, _ADVICE):
        raise SceneFolderError(chosen, "the file does not exist", _ADVICE)
    return chosen


def _check_header(ply: Path) -> None:
    """Raises SceneFolderError for more anchors than Main holds, and for anchors with levels of detail."""
    try:
        count, _ = check_ply_header(ply)
        names = property_names(ply)
    except PlyError as error:
        raise SceneFolderError(ply, f"it is not a readable PLY file ({error})", _ADVICE) from None
    if count > ANCHORS_MAX:
        problem = f"it has {count} anchors, but at most {ANCHORS_MAX} are allowed (SPEC.md 11.2)"
        raise SceneFolderError(ply, problem, "train the model with fewer")
    level = next((name for name in LEVELS if name in names), None)
    if level:
        problem = f"its anchors have levels of detail (the property {level}), which the format does not have"
        raise SceneFolderError(ply, problem, _ADVICE)


def _check_sizes(ply: Path, cloud: AnchorCloud, settings: ModelSettings) -> None:
    """Raises SceneFolderError for more offsets or features than Main holds, or if they differ from cfg_args."""
    offsets, features = cloud.masks.shape[1], cloud.features.shape[1]
    low, high = PROFILES[MAIN].offset_count
    if not low <= offsets <= high:
        problem = f"its anchors have {offsets} offsets, but must have {low} to {high} (SPEC.md 11.1)"
        raise SceneFolderError(ply, problem, "train the model with fewer")
    if features > FEATURES_MAX:
        problem = f"its anchors have {features} features, but at most {FEATURES_MAX} are allowed (SPEC.md 11.1)"
        raise SceneFolderError(ply, problem, "train the model with fewer")
    if settings.features not in (None, features):
        problem = f"its anchors have {features} features, but {SETTINGS_FILE} states {settings.features}"
        raise SceneFolderError(ply, problem, "give the whole folder of one training")


def _lattice(positions: NDArray[np.float32], voxel: float | None) -> float | None:
    """Returns the voxel size of the anchor lattice, as a float32 value; None if the anchors are not on a lattice."""
    if voxel is None or not len(positions):
        return None
    cells = positions.astype(np.float64) / voxel
    # From here on, a float32 has no fractional digits.
    if np.abs(cells).max() > 1 << 20 or np.abs(cells - np.rint(cells)).max() > NEAR:
        return None
    return float(np.float32(voxel))


# --- the networks -----------------------------------------------------------------------------------------------------


def _bank(file: Path) -> SceneFolderError:
    problem = "the model has a feature bank, which mixes features by view; the format cannot express it"
    return SceneFolderError(file, problem, "train the model without use_feat_bank")


def _networks(folder: Path, cloud: AnchorCloud, appearance: int | None) -> tuple[Path, dict[str, list[Layer]], int]:
    """Returns the rendering networks of SPEC 14.3, their file or folder, and the number of embeddings.

    Their width is the stored one. Raises SceneFolderError.
    """
    file, stored = _stored(folder)
    offsets, features = cloud.masks.shape[1], cloud.features.shape[1]
    if any(bank in stored for bank in BANKS):
        raise _bank(file)
    embedding = _embedding(file, stored[APPEARANCE]) if APPEARANCE in stored else None
    networks = {}
    for (own, name), each in zip(NETWORKS.items(), (1, 7, 3), strict=True):
        if own not in stored:
            raise SceneFolderError(file, f"it has no network {own}", _ADVICE)
        first, last = _layers(file, own, stored[own], each * offsets)
        extra = 0 if embedding is None or name != RENDERING[2] else embedding.shape[1]
        inputs = first[0].shape[1] - features - VIEW
        if inputs not in (extra, extra + 1):
            wanted = f"it must have {features + VIEW + extra}, or one more with the distance"
            raise SceneFolderError(file, f"{own} has {first[0].shape[1]} inputs; {wanted}", _ADVICE)
        code = None if embedding is None or not extra else _code(file, embedding, appearance)
        networks[name] = [_first_layer(first, features, inputs > extra, code), last]
        if not np.isfinite(networks[name][0][1]).all():
            raise SceneFolderError(file, f"{own} with its appearance has a bias that is infinite", _ADVICE)
    if appearance is not None and embedding is None:
        raise SceneFolderError(file, "the model has no appearance embedding", "omit --appearance")
    return file, networks, 0 if embedding is None else len(embedding)


def _stored(folder: Path) -> tuple[Path, dict[str, Parameters]]:
    """Returns the parameters of the networks by the names of state dicts, and their file or folder.

    Raises SceneFolderError.
    """
    for name in STATE_DICT_FILES:
        if there(folder / name, _ADVICE):
            return folder / name, dict(read_state_dicts(folder / name, (*NETWORKS, APPEARANCE, *BANKS)))
    names = {**{name: f"{name}.pt" for name in (*NETWORKS, *BANKS)}, APPEARANCE: APPEARANCE_FILE}
    files = {name: folder / file for name, file in names.items() if there(folder / file, _ADVICE)}
    if not files:
        problem = f"it has neither {' nor '.join(STATE_DICT_FILES)} nor {', '.join(names[n] for n in NETWORKS)}"
        raise SceneFolderError(folder, problem, _ADVICE)
    return folder, {name: read_torchscript(file) for name, file in files.items()}


def _embedding(file: Path, stored: Parameters) -> NDArray[np.float32] | None:
    """Returns the embedding of cameras, float32 [cameras, numbers]; None if there is none. Raises SceneFolderError."""
    tables = [value for value in stored.values() if value.size]
    if not tables:
        return None
    if len(tables) != 1 or tables[0].ndim != 2 or not np.isfinite(tables[0]).all():
        raise SceneFolderError(file, f"{APPEARANCE} is not one table of finite numbers", _ADVICE)
    return tables[0]


def _code(file: Path, embedding: NDArray[np.float32], camera: int | None) -> NDArray[np.float64]:
    """Returns the embedding of a camera, or the mean of all. Raises SceneFolderError."""
    if camera is None:
        return embedding.mean(axis=0, dtype=np.float64)
    if camera >= len(embedding):
        problem = f"its appearance embedding has {len(embedding)} cameras, from 0; there is no camera {camera}"
        raise SceneFolderError(file, problem, "give --appearance another number")
    return embedding[camera].astype(np.float64)


def _layers(file: Path, name: str, stored: Parameters, outputs: int) -> tuple[Layer, Layer]:
    """Returns the two layers of a network with the given number of outputs. Raises SceneFolderError."""
    if set(stored) != {"0.weight", "0.bias", "2.weight", "2.bias"}:
        problem = f"{name} is not a network of two linear layers, 0 and 2, with a rectifier between them"
        raise SceneFolderError(file, problem, _ADVICE)
    weights, biases = (stored["0.weight"], stored["2.weight"]), (stored["0.bias"], stored["2.bias"])
    hidden = len(biases[0]) if biases[0].ndim == 1 else 0
    inputs = weights[0].shape[1] if weights[0].ndim == 2 else 0
    for number, weight, bias, shape in zip((0, 2), weights, biases, ((hidden, inputs), (outputs, hidden)), strict=True):
        if weight.shape != shape or bias.shape != shape[:1] or not weight.size:
            problem = (
                f"{name}.{number} has the shapes {weight.shape} and {bias.shape}, but must have {shape} and {shape[:1]}"
            )
            raise SceneFolderError(file, problem, _ADVICE)
        if not (np.isfinite(weight).all() and np.isfinite(bias).all()):
            raise SceneFolderError(file, f"{name}.{number} has a number that is NaN or infinite", _ADVICE)
    return (weights[0], biases[0]), (weights[1], biases[1])


def _first_layer(layer: Layer, features: int, distance: bool, code: NDArray[np.float64] | None) -> Layer:
    """Returns a first layer that takes features, direction and distance.

    A layer without a distance input gets weights of 0 for it. The appearance is a constant input, which is added to the
    bias. distance: whether the layer has this input. code: of the appearance, or None.
    """
    weight, bias = layer
    taken = features + VIEW + distance
    away = weight[:, taken - 1 : taken] if distance else np.zeros((len(weight), 1), np.float32)
    if code is not None:
        with np.errstate(over="ignore", invalid="ignore"):
            bias = (bias + weight[:, taken:].astype(np.float64) @ code).astype(np.float32)
    return np.concatenate([weight[:, : features + VIEW], away], axis=1), bias


def _of_one_width(file: Path, networks: dict[str, list[Layer]]) -> dict[str, list[Layer]]:
    """SPEC 5.3: pads the rendering networks to one width with hidden units that are 0.

    Raises SceneFolderError for a network that is too wide.
    """
    width = max(len(layers[0][1]) for layers in networks.values())
    most = PROFILES[MAIN].render_width[1]
    if width > most:
        problem = f"a network has {width} hidden units, but at most {most} are allowed (SPEC.md 11.1)"
        raise SceneFolderError(file, problem, "train the model with fewer features")
    padded: dict[str, list[Layer]] = {}
    for name, ((weight, bias), (last, end)) in networks.items():
        more = width - len(bias)
        padded[name] = [
            (np.pad(weight, ((0, more), (0, 0))), np.pad(bias, (0, more))),
            (np.pad(last, ((0, 0), (0, more))), end),
        ]
    return padded
