"""The scene folder, which `decode` writes and `encode` reads. Its files have formats that other programs read.

scene.json              the values of the header, the frame and the small tables, the digest, and a fingerprint of these
point_cloud.ply         the reconstruction, in the Scaffold-GS checkpoint layout
networks.safetensors    fp32 weights and biases
planes.safetensors      plane symbols
coded.safetensors       fp16 positions, masks, attribute symbols and step indices
ancillary_N_TYPE.bin    ancillary section N, counted from 0, and its type

With coded.safetensors, encoding a folder is exact. Without it, `encode` quantises point_cloud.ply again, with the
networks, planes, frame and grid of the folder. A changed folder loses the ancillary sections that are not safe to copy.
"""

import hashlib
import json
import os
import re
import stat
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from ..files.lock import is_empty
from ..files.present import NotAFileError, is_there
from ..files.stage import INCOMING, exchange
from ..files.text import shell_word
from ..statuses import UsageError

SCENE_FILE = "scene.json"
PLY_FILE = "point_cloud.ply"
NETWORKS_FILE = "networks.safetensors"
PLANES_FILE = "planes.safetensors"
CODED_FILE = "coded.safetensors"
ANCILLARY_FILE = re.compile(r"ancillary_[0-9]+_[A-Za-z]{4}\.bin")
# The report of a training, beside the scene.
REPORT_FILE = "training.json"
# Only the folder of an uncompressed scene has this file.
RENDER_FILE = "render.json"
FORMAT = "C3GS scene"
UNCOMPRESSED = "Scaffold-GS, uncompressed"
# HAC and CAT-3DGS store a mask as a logit. They keep an offset if the sigmoid of its logit is above 0.01.
MASK_LOGIT_MIN = float(np.log(0.01 / 0.99))


class SceneFolderError(UsageError):
    """A scene folder, or a file in it, that cannot be used. file: its path. problem: the fault. advice: the remedy."""

    file: str
    problem: str
    advice: str

    def __init__(self, file: Path | str, problem: str, advice: str) -> None:
        self.file, self.problem, self.advice = str(file), problem, advice
        super().__init__(f"{file}: {problem}; {advice}")


def there(path: Path, advice: str) -> bool:
    """Whether an optional file exists. Raises SceneFolderError if a dangling link, a pipe or a folder has its name.

    advice: the remedy in the error.
    """
    try:
        return is_there(path)
    except NotAFileError as error:
        raise SceneFolderError(path, str(error), advice) from None


def is_free(path: Path, uncompressed: bool = False) -> bool:
    """Whether a scene may be written to a path.

    It may if the path is missing, an empty directory, a scene folder, or one that a killed run left without scene.json.
    uncompressed: whether the folder of an uncompressed scene counts, too.
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


def check_scene_folder(path: Path) -> None:
    """Raises UsageError for the folder of a Scaffold-GS model in place of a scene folder."""
    if (path / "point_cloud").is_dir() and not (path / SCENE_FILE).exists():
        raise UsageError(
            f"{path} is a model of another program, not a scene folder: convert it first with "
            f"refcodec convert {shell_word(str(path))} -o SCENE_DIR"
        )


def scene_files(path: Path) -> list[Path]:
    """Returns the files that writing a scene to a folder makes, replaces or removes. Some may be missing."""
    fixed = (SCENE_FILE, PLY_FILE, NETWORKS_FILE, PLANES_FILE, CODED_FILE, RENDER_FILE)
    names = sorted(os.listdir(path)) if path.is_dir() else []
    return [path / name for name in (*fixed, *(name for name in names if ANCILLARY_FILE.fullmatch(name)))]


def ancillary_name(number: int, kind: bytes) -> str:
    """Returns the file name of an ancillary section. number: its index. kind: its type."""
    return f"ancillary_{number}_{kind.decode('ascii')}.bin"


def replace_scene(path: Path, write: Callable[[Path], None]) -> None:
    """Replaces the scene of a folder as a whole (files.stage.exchange). A missing folder is made.

    Args:
        path: the folder.
        write: writes the new files into the folder that it is given.

    Raises:
        SceneFolderError: the path is a file, or a folder with other contents.
        OSError: a file cannot be written.
    """

    def replaced() -> list[Path]:
        if not is_free(path, uncompressed=True):
            raise SceneFolderError(
                path, "it exists and is not a scene folder", "choose another folder, or empty this one"
            )
        files = scene_files(path)
        for file in files:
            if file.is_dir() and not file.is_symlink():
                raise SceneFolderError(file, "it is a directory", "move it, or choose another folder")
        return files

    if os.path.lexists(path) and not path.is_dir():
        replaced()
    exchange(path, write, replaced, SCENE_FILE)


def fingerprint(document: dict[str, Any]) -> str:
    """Returns the SHA-256 of the values of scene.json apart from its ancillary sections, in hexadecimal.

    With the digest among them, they determine the header and the critical sections of the encoded file.
    """
    values = {name: value for name, value in document.items() if name not in ("ancillary", "fingerprint")}
    return hashlib.sha256(json.dumps(values, sort_keys=True).encode()).hexdigest()
