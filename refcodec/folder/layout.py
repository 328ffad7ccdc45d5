"""The scene folder, which `decode` writes and `encode` reads. Its files are in formats that other programs know.

scene.json              the values of the header, the frame and the small tables, and the digest
point_cloud.ply         the reconstruction, in the layout of Scaffold-GS checkpoints
networks.safetensors    fp32 weights and biases
planes.safetensors      the planes' symbols
coded.safetensors       fp16 positions, masks, attribute symbols and step indices
extension_XX.bin        the ancillary section of type XX

With coded.safetensors a folder is encoded exactly. Without it, `encode` quantises point_cloud.ply anew, with the
networks, planes, frame and grid of the folder.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

SCENE_FILE = "scene.json"
PLY_FILE = "point_cloud.ply"
NETWORKS_FILE = "networks.safetensors"
PLANES_FILE = "planes.safetensors"
CODED_FILE = "coded.safetensors"
EXTENSION_FILE = re.compile(r"extension_[0-9a-f]{2}\.bin")
# The folder inside the scene folder in which files are written. They are moved out when all of them are whole.
INCOMING = ".c3gs-incoming"
FORMAT = "C3GS scene"
# HAC and CAT-3DGS store a mask as a logit. They keep an offset if the sigmoid of its logit is above 0.01.
MASK_LOGIT_MIN = float(np.log(0.01 / 0.99))


class SceneFolderError(ValueError):
    """A scene folder, or a file in it, cannot be used. file: which one. problem: what is wrong. advice: what to do."""

    def __init__(self, file: Path | str, problem: str, advice: str) -> None:
        self.file, self.problem, self.advice = str(file), problem, advice
        super().__init__(f"{file}: {problem}; {advice}")


def is_free(path: Path) -> bool:
    """Whether write_folder may write to a path: nothing is there, or an empty directory, or a scene folder."""
    if not path.exists():
        return True
    return path.is_dir() and ((path / SCENE_FILE).is_file() or all(p.name == INCOMING for p in path.iterdir()))


def extension_name(kind: int) -> str:
    """Returns the name of the file of an ancillary section. kind: its type."""
    return f"extension_{kind:02x}.bin"
