"""The scene folder, which `decode` writes and `encode` reads. Its files are in formats that other programs know.

scene.json              the values of the header, the frame and the small tables, and the digest
point_cloud.ply         the reconstruction, in the layout of Scaffold-GS checkpoints
networks.safetensors    fp32 weights and biases
planes.safetensors      the planes' symbols
coded.safetensors       fp16 positions, masks, attribute symbols and step indices
ancillary_N_TYPE.bin    the ancillary section number N, counted from 0, with its type

With coded.safetensors a folder is encoded exactly. Without it, `encode` quantises point_cloud.ply anew, with the
networks, planes, frame and grid of the folder.
"""

from __future__ import annotations

import os
import re
import stat
from pathlib import Path

import numpy as np

from ..files.lock import is_empty
from ..files.present import NotAFileError, is_there
from ..files.stage import INCOMING

SCENE_FILE = "scene.json"
PLY_FILE = "point_cloud.ply"
NETWORKS_FILE = "networks.safetensors"
PLANES_FILE = "planes.safetensors"
CODED_FILE = "coded.safetensors"
ANCILLARY_FILE = re.compile(r"ancillary_[0-9]+_[A-Za-z]{4}\.bin")
# What a training says of itself, beside the scene.
REPORT_FILE = "training.json"
# The file that only the folder of an uncompressed scene has.
RENDER_FILE = "render.json"
FORMAT = "C3GS scene"
UNCOMPRESSED = "Scaffold-GS, uncompressed"
# HAC and CAT-3DGS store a mask as a logit. They keep an offset if the sigmoid of its logit is above 0.01.
MASK_LOGIT_MIN = float(np.log(0.01 / 0.99))


class SceneFolderError(ValueError):
    """A scene folder, or a file in it, cannot be used. file: which one. problem: what is wrong. advice: what to do."""

    def __init__(self, file: Path | str, problem: str, advice: str) -> None:
        self.file, self.problem, self.advice = str(file), problem, advice
        super().__init__(f"{file}: {problem}; {advice}")


def there(path: Path, advice: str) -> bool:
    """Whether a file that may be missing is there. Raises SceneFolderError for a link, pipe or folder in its place.

    advice: what to do about such a thing.
    """
    try:
        return is_there(path)
    except NotAFileError as error:
        raise SceneFolderError(path, str(error), advice) from None


def is_free(path: Path, uncompressed: bool = False) -> bool:
    """Whether a scene may be written to a path.

    It may if nothing is there, or an empty directory, or a scene folder, or one that a killed run left without
    scene.json. uncompressed: whether the folder of an uncompressed scene is one, too.
    """
    try:
        if not is_there(path, stat.S_IFDIR):
            return True
        plain = is_there(path / RENDER_FILE)
        if plain:
            with (path / RENDER_FILE).open("rb") as file:
                if UNCOMPRESSED.encode() not in file.read(len(UNCOMPRESSED) + 64):
                    return False
        if is_there(path / SCENE_FILE) or (plain and uncompressed):
            return True
        return (path / INCOMING).is_dir() or is_empty(path)
    except NotAFileError:
        return False


def scene_files(path: Path) -> list[Path]:
    """Returns the files that writing a scene to a folder makes, replaces or removes. Some may not be there."""
    fixed = (SCENE_FILE, PLY_FILE, NETWORKS_FILE, PLANES_FILE, CODED_FILE, RENDER_FILE)
    found = sorted(os.listdir(path)) if path.is_dir() else []
    return [path / name for name in (*fixed, *(name for name in found if ANCILLARY_FILE.fullmatch(name)))]


def ancillary_name(number: int, kind: bytes) -> str:
    """Returns the name of the file of an ancillary section. number: its place among them. kind: its type."""
    return f"ancillary_{number}_{kind.decode('ascii')}.bin"
