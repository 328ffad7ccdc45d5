"""Trained models of the Scaffold-GS family (Scaffold-GS, HAC, HAC++, CAT-3DGS), as uncompressed scenes.

A model folder has point_cloud/iteration_N/point_cloud.ply. The rendering networks are beside that file: as state dicts
in one file, or as a TorchScript archive for each network. Their common structure is that of Scaffold-GS (Lu et al.
2024): Linear, ReLU, Linear, with the features, the unit vector from the camera and the distance as inputs.
"""

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
from ..files.ply import check_ply_header, property_names
from ..folder.layout import PLY_FILE, SceneFolderError, there
from ..folder.ply import read_cloud
from ..folder.uncompressed import Uncompressed
from ..formats.common import ContentError, errors_in
from ..rendering.camera import STATED, spread_cameras, up_axis
from .notes import CAMERAS_FILE, SETTINGS_FILE, ModelSettings, read_cameras, read_settings
from .tensors import Parameters, read_state_dicts, read_torchscript

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
_FEWER = "train the model with fewer"
_BANK = "the model has a feature bank, which mixes features by view; the format cannot express it"
_WITHOUT_BANK = "train the model without use_feat_bank"


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
    settings, seen_from = read_settings(root / SETTINGS_FILE), read_cameras(root / CAMERAS_FILE)
    if settings.bank:
        raise SceneFolderError(root / SETTINGS_FILE, _BANK, _WITHOUT_BANK)
    with errors_in(ply, _ADVICE):
        _check_header(ply)
        cloud = read_cloud(ply)
        _check_sizes(cloud, settings)
    file, stored = _stored(ply.parent)
    with errors_in(file, _ADVICE):
        networks, embeddings = _networks(stored, cloud, appearance)
        networks = _of_one_width(networks)
    render = RenderInfo(
        background=(255, 255, 255) if settings.white else (0, 0, 0),
        up_axis=up_axis(seen_from, cloud.positions.astype(np.float64)) if seen_from else RenderInfo.up_axis,
    )
    cameras = tuple(spread_cameras(seen_from, STATED))
    offsets = np.where(cloud.masks[:, :, None], cloud.offsets, np.float32(0))
    values = Reconstruction(cloud.positions, cloud.features, cloud.scalings, offsets)
    scene = Uncompressed(values, cloud.masks, networks, render, cameras, _lattice(cloud.positions, settings.voxel))
    return Converted(scene, embeddings)


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
    """Raises ContentError and PlyError for more anchors than Main holds, and for anchors with levels of detail."""
    count, _ = check_ply_header(ply)
    if count > ANCHORS_MAX:
        raise ContentError(f"it has {count} anchors, but at most {ANCHORS_MAX} are allowed (SPEC.md 11.2)", _FEWER)
    level = next((name for name in LEVELS if name in property_names(ply)), None)
    if level:
        raise ContentError(f"its anchors have levels of detail (the property {level}), which the format does not have")


def _check_sizes(cloud: AnchorCloud, settings: ModelSettings) -> None:
    """Raises ContentError for more offsets or features than Main holds, or if they differ from cfg_args."""
    offsets, features = cloud.masks.shape[1], cloud.features.shape[1]
    low, high = PROFILES[MAIN].offset_count
    if not low <= offsets <= high:
        raise ContentError(f"its anchors have {offsets} offsets, but must have {low} to {high} (SPEC.md 11.1)", _FEWER)
    if features > FEATURES_MAX:
        problem = f"its anchors have {features} features, but at most {FEATURES_MAX} are allowed (SPEC.md 11.1)"
        raise ContentError(problem, _FEWER)
    if settings.features not in (None, features):
        problem = f"its anchors have {features} features, but {SETTINGS_FILE} states {settings.features}"
        raise ContentError(problem, "give the whole folder of one training")


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


def _networks(
    stored: Mapping[str, Parameters], cloud: AnchorCloud, appearance: int | None
) -> tuple[dict[str, list[Layer]], int]:
    """Returns the rendering networks of SPEC 14.3, and the number of embeddings.

    stored: the parameters by the names of state dicts. The width of the networks is the stored one. Raises
    ContentError.
    """
    offsets, features = cloud.masks.shape[1], cloud.features.shape[1]
    if any(bank in stored for bank in BANKS):
        raise ContentError(_BANK, _WITHOUT_BANK)
    embedding = _embedding(stored[APPEARANCE]) if APPEARANCE in stored else None
    networks = {}
    for (own, name), each in zip(NETWORKS.items(), (1, 7, 3), strict=True):
        if own not in stored:
            raise ContentError(f"it has no network {own}")
        first, last = _layers(own, stored[own], each * offsets)
        extra = 0 if embedding is None or name != RENDERING[2] else embedding.shape[1]
        inputs = first[0].shape[1] - features - VIEW
        if inputs not in (extra, extra + 1):
            wanted = f"it must have {features + VIEW + extra}, or one more with the distance"
            raise ContentError(f"{own} has {first[0].shape[1]} inputs; {wanted}")
        code = None if embedding is None or not extra else _code(embedding, appearance)
        networks[name] = [_first_layer(first, features, inputs > extra, code), last]
        if not np.isfinite(networks[name][0][1]).all():
            raise ContentError(f"{own} with its appearance has a bias that is infinite")
    if appearance is not None and embedding is None:
        raise ContentError("the model has no appearance embedding", "omit --appearance")
    return networks, 0 if embedding is None else len(embedding)


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


def _embedding(stored: Parameters) -> NDArray[np.float32] | None:
    """Returns the embedding of cameras, float32 [cameras, numbers]; None if there is none. Raises ContentError."""
    tables = [value for value in stored.values() if value.size]
    if not tables:
        return None
    if len(tables) != 1 or tables[0].ndim != 2 or not np.isfinite(tables[0]).all():
        raise ContentError(f"{APPEARANCE} is not one table of finite numbers")
    return tables[0]


def _code(embedding: NDArray[np.float32], camera: int | None) -> NDArray[np.float64]:
    """Returns the embedding of a camera, or the mean of all. Raises ContentError."""
    if camera is None:
        return embedding.mean(axis=0, dtype=np.float64)
    if camera >= len(embedding):
        problem = f"its appearance embedding has {len(embedding)} cameras, from 0; there is no camera {camera}"
        raise ContentError(problem, "give --appearance another number")
    return embedding[camera].astype(np.float64)


def _layers(name: str, stored: Parameters, outputs: int) -> tuple[Layer, Layer]:
    """Returns the two layers of a network with the given number of outputs. Raises ContentError."""
    if set(stored) != {"0.weight", "0.bias", "2.weight", "2.bias"}:
        raise ContentError(f"{name} is not a network of two linear layers, 0 and 2, with a rectifier between them")
    weights, biases = (stored["0.weight"], stored["2.weight"]), (stored["0.bias"], stored["2.bias"])
    hidden = len(biases[0]) if biases[0].ndim == 1 else 0
    inputs = weights[0].shape[1] if weights[0].ndim == 2 else 0
    for number, weight, bias, shape in zip((0, 2), weights, biases, ((hidden, inputs), (outputs, hidden)), strict=True):
        if weight.shape != shape or bias.shape != shape[:1] or not weight.size:
            raise ContentError(
                f"{name}.{number} has the shapes {weight.shape} and {bias.shape}, but must have {shape} and {shape[:1]}"
            )
        if not (np.isfinite(weight).all() and np.isfinite(bias).all()):
            raise ContentError(f"{name}.{number} has a number that is NaN or infinite")
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


def _of_one_width(networks: dict[str, list[Layer]]) -> dict[str, list[Layer]]:
    """SPEC 5.3: pads the rendering networks to one width with hidden units that are 0.

    Raises ContentError for a network that is too wide.
    """
    width = max(len(layers[0][1]) for layers in networks.values())
    most = PROFILES[MAIN].render_width[1]
    if width > most:
        problem = f"a network has {width} hidden units, but at most {most} are allowed (SPEC.md 11.1)"
        raise ContentError(problem, "train the model with fewer features")
    padded: dict[str, list[Layer]] = {}
    for name, ((weight, bias), (last, end)) in networks.items():
        more = width - len(bias)
        first = np.pad(weight, ((0, more), (0, 0))), np.pad(bias, (0, more))
        padded[name] = [first, (np.pad(last, ((0, 0), (0, more))), end)]
    return padded
