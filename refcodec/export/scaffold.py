"""The folder of a trained Scaffold-GS model, as the Scaffold-GS code loads it.

cfg_args                                     the network settings, as the text of a Namespace
cameras.json                                 the cameras of the scene
point_cloud/iteration_30000/point_cloud.ply  anchors
point_cloud/iteration_30000/*_mlp.pt         the three networks in TorchScript
point_cloud/iteration_30000/checkpoints.pth  the same as state dicts
point_cloud/iteration_30000/render.json      the other values of the scene, for refcodec convert

That code differs from SPEC 14.3 in three points. Values in the folder compensate for them, so that both draw the same.
convert.carried removes them again:

- Distances are in world units. The weights of the distance are divided by distance_unit.
- The width of the networks is the number of features. The smaller of the two is padded with zeros.
- There are no masks. Each offset gets a feature that is 1 for the anchors that drop it. A unit of the opacity network
  passes it on, with a weight that makes the opacity negative. The code does not draw Gaussians of negative opacity.
"""

# torch is imported where it is used, so that other commands start fast.
# ruff: noqa: PLC0415

from __future__ import annotations

import io
import json
import os
import re
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from .. import __version__
from ..bitstream.cameras import NamedCamera
from ..bitstream.dimensions import RENDERING
from ..bitstream.header import RenderInfo
from ..bitstream.networks import Layer
from ..bitstream.reconstruction import Reconstruction
from ..bitstream.scene import Scene
from ..files.lock import BESIDE
from ..files.outputs import Kind, check_file
from ..files.ply import ply_bytes
from ..files.stage import exchange, new_file
from ..folder.layout import RENDER_FILE
from ..folder.ply import ply_properties, ply_values
from ..folder.uncompressed import render_document
from ..rendering.camera import default_camera
from ..rendering.gaussians import check_view_dependent
from ..statuses import UsageError

if TYPE_CHECKING:
    from torch import nn

F32 = NDArray[np.float32]

CFG_ARGS, CAMERAS_JSON = Path("cfg_args"), Path("cameras.json")
_MODEL = Path("point_cloud", "iteration_30000")
# The names of the networks in the folder, and the last function of each.
_NAMES = {"opacity": "opacity_mlp", "covariance": "cov_mlp", "colour": "color_mlp"}
FILES = (
    CFG_ARGS,
    CAMERAS_JSON,
    _MODEL / "point_cloud.ply",
    *(_MODEL / f"{name}.pt" for name in _NAMES.values()),
    _MODEL / "checkpoints.pth",
    _MODEL / RENDER_FILE,
)
_MARK = "Namespace(generator='refcodec"
# The file that marks a folder as written by refcodec.
CFG = Kind("the cfg_args of a folder that refcodec wrote", re.compile(re.escape(_MARK.encode())))
# Larger than any opacity of a learned network before its hyperbolic tangent.
DROP = 2.0**64
# The inputs of SPEC 14.3 besides the features: a direction and a distance.
_VIEW = 4


def scaffold_files(
    values: Reconstruction,
    masks: NDArray[np.bool_],
    networks: dict[str, list[Layer]],
    render: RenderInfo,
    cameras: Sequence[NamedCamera],
    voxel: float | None,
) -> dict[Path, bytes]:
    """Returns the files of the folder by their names, which are FILES. Needs torch.

    values: the float32 values of the scene. masks: bool [N, K]. networks: the rendering networks, by name.
    cameras: the first is the default view. voxel: cell size of the position lattice, world units, or None.
    """
    check_view_dependent(render)
    features, wide = _widened(values, masks, networks, render.distance_unit)
    modules, width = {name: _module(name, wide[name]) for name in RENDERING}, features.shape[1]
    return {
        CFG_ARGS: _cfg_args(width, masks.shape[1], render, voxel).encode(),
        CAMERAS_JSON: json.dumps([_camera(number, camera) for number, camera in enumerate(cameras)]).encode(),
        _MODEL / "point_cloud.ply": _cloud(values, masks, features),
        **{_MODEL / f"{_NAMES[name]}.pt": _torch_script(modules[name], width + _VIEW) for name in modules},
        _MODEL / "checkpoints.pth": _state_dicts(modules),
        _MODEL / RENDER_FILE: render_document(render, cameras, voxel),
    }


def lattice_edge(scene: Scene) -> float | None:
    """Returns the cell size of the anchor lattice of a coded scene, world units; None if there is none."""
    whole = bool((scene.positions == np.rint(scene.positions)).all())
    return scene.grid.scale_mantissa * 2.0**scene.grid.scale_exponent if whole else None


def check_folder(folder: Path) -> None:
    """Raises UsageError if a folder has files that write_folder did not write."""
    if not os.path.lexists(folder):
        return
    if not folder.is_dir():
        raise UsageError(f"{folder} is a file: give a folder")
    files = {path.relative_to(folder) for path in folder.rglob("*") if not path.is_dir()}
    files = {file for file in files if BESIDE not in str(file)}
    if files and (CFG_ARGS not in files or not files <= set(FILES)):
        raise UsageError(f"{folder} exists and has other files: choose another folder, or empty it")
    check_file(folder / CFG_ARGS, CFG, made=True)


def write_folder(files: Mapping[Path, bytes], folder: Path) -> None:
    """Writes the files of scaffold_files over previous ones: all or none (files.stage.exchange).

    Raises UsageError as check_folder, and OSError.
    """

    def write(new: Path) -> None:
        for name, data in files.items():
            (new / name).parent.mkdir(parents=True, exist_ok=True)
            with new_file(new / name) as file:
                file.write(data)

    def replaced() -> list[Path]:
        check_folder(folder)
        return [folder / name for name in sorted({file.parts[0] for file in FILES})]

    exchange(folder, write, replaced, str(CFG_ARGS))


def _widened(
    values: Reconstruction, masks: NDArray[np.bool_], networks: dict[str, list[Layer]], distance_unit: float
) -> tuple[F32, dict[str, list[Layer]]]:
    """Returns the features of a Scaffold-GS scene [N, width], and networks of `width` features and hidden units."""
    count, own = values.features.shape
    dropped = ~masks if not masks.all() else np.zeros((count, 0), bool)
    extra = dropped.shape[1]
    hidden = max(len(networks[name][0][1]) for name in RENDERING)
    width = extra + max(own, hidden)
    features = np.zeros((count, width), np.float32)
    features[:, :own] = values.features
    features[:, width - extra :] = dropped
    layers = {}
    for name in RENDERING:
        (weight, bias), (last_weight, last_bias) = networks[name]
        first, first_bias = np.zeros((width, width + _VIEW), np.float32), np.zeros(width, np.float32)
        second = np.zeros((len(last_bias), width), np.float32)
        units = len(bias)
        first[:units, :own], first[:units, width:], first_bias[:units] = weight[:, :own], weight[:, own:], bias
        first[:units, -1] = weight[:, -1] / np.float32(distance_unit)
        second[:, :units] = last_weight
        if name == "opacity":
            unit = np.arange(width - extra, width)
            first[unit, unit], second[np.arange(extra), unit] = 1, -DROP
        layers[name] = [(first, first_bias), (second, last_bias)]
    return features, layers


def _module(name: str, layers: list[Layer]) -> nn.Sequential:
    """Returns a network in the structure of Scaffold-GS."""
    import torch
    from torch import nn

    linear = []
    for weight, bias in layers:
        layer = nn.Linear(weight.shape[1], weight.shape[0])
        with torch.no_grad():
            layer.weight.copy_(torch.tensor(weight))
            layer.bias.copy_(torch.tensor(bias))
        linear.append(layer)
    end: dict[str, list[nn.Module]] = {"opacity": [nn.Tanh()], "covariance": [], "colour": [nn.Sigmoid()]}
    return nn.Sequential(linear[0], nn.ReLU(), linear[1], *end[name])


def _torch_script(module: nn.Sequential, inputs: int) -> bytes:
    """Returns a network in the format of torch.jit.load. inputs: their number."""
    import torch

    file = io.BytesIO()
    with warnings.catch_warnings():
        # PyTorch warns about TorchScript, but Scaffold-GS loads it.
        warnings.simplefilter("ignore", DeprecationWarning)
        torch.jit.save(torch.jit.trace(module.eval(), torch.zeros(1, inputs)), file)
    return file.getvalue()


def _state_dicts(modules: dict[str, nn.Sequential]) -> bytes:
    """Returns the tensors of the networks as torch.load reads them with weights_only."""
    import torch

    file = io.BytesIO()
    torch.save({_NAMES[name]: module.state_dict() for name, module in modules.items()}, file)
    return file.getvalue()


def _cloud(values: Reconstruction, masks: NDArray[np.bool_], features: F32) -> bytes:
    """Returns point_cloud.ply, without masks. The opacity and the rotation of anchors are not used."""
    stored, zeros = ply_values(values, masks), np.zeros((len(masks), 3), np.float32)
    rotation = np.broadcast_to(np.array([1, 0, 0, 0], np.float32), (len(masks), 4))
    parts = stored["xyz"], zeros, stored["f_offset_"], features, zeros[:, :1], stored["scale_"], rotation
    names = ply_properties(masks.shape[1], features.shape[1])
    row = [(name, "<f4") for name in names if not name.startswith("f_mask_")]
    return ply_bytes({"vertex": np.concatenate(parts, axis=1).astype("<f4").view(row).reshape(len(masks))})


def _cfg_args(width: int, offsets: int, render: RenderInfo, voxel: float | None) -> str:
    """Returns the arguments that the Scaffold-GS code evaluates, with its defaults for values that a scene lacks."""
    return (
        f"{_MARK} {__version__}', sh_degree=3, feat_dim={width}, n_offsets={offsets}, voxel_size={voxel or 0.001!r}, "
        "update_depth=3, update_init_factor=16, update_hierachy_factor=4, use_feat_bank=False, source_path='', "
        f"model_path='', images='images', resolution=-1, white_background={render.background == (255, 255, 255)}, "
        "data_device='cuda', eval=False, lod=0, appearance_dim=0, lowpoly=False, ds=1, ratio=1, undistorted=False, "
        "add_opacity_dist=True, add_cov_dist=True, add_color_dist=True)"
    )


def _camera(number: int, stated: NamedCamera) -> dict[str, Any]:
    """Returns a camera as in the 3DGS code and viewers. The rotation is from camera to world, by rows."""
    camera = default_camera(stated)
    return {
        "id": number,
        "img_name": stated.name,
        "width": camera.width,
        "height": camera.height,
        "position": camera.centre.tolist(),
        "rotation": camera.rotation.T.tolist(),
        "fy": camera.fy,
        "fx": camera.fx,
    }
