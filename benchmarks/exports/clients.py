"""Third-party readers of exported files: PlayCanvas's splat-transform, and Khronos's glTF validator.

INSTALL installs them from npm. Nothing here downloads.
"""

from __future__ import annotations

import json
import subprocess
import tempfile
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np

from refcodec.bitstream.cameras import rotation_matrix
from refcodec.formats.packing import opacities
from refcodec.formats.splats import Splats
from refcodec.formats.spz import HARMONIC_SIGNS
from refcodec.formats.table import read_splats

from ..peers.convert import ROOT, ToolError, convert

# In a folder that Git ignores.
FOLDER = "build/export-clients"
THREE, SPARK, VALIDATOR = "three@0.187.0", "@sparkjsdev/spark@2.2.0", "gltf-validator@2.0.0-dev.3.10"
EXTENSION = "KHR_gaussian_splatting"
INSTALL = f"npm install --ignore-scripts --no-audit --prefix {FOLDER} {THREE} {SPARK} {VALIDATOR}"
_VALIDATE = """
const validator = require("gltf-validator"), fs = require("fs");
validator.validateBytes(new Uint8Array(fs.readFileSync(process.argv[1])))
  .then((report) => console.log(JSON.stringify(report.issues)));
"""


def modules() -> Path:
    """Returns the folder of the packages of INSTALL. Raises ToolError if they are missing."""
    found = ROOT / FOLDER / "node_modules"
    if not all((found / package.rpartition("@")[0]).is_dir() for package in (THREE, SPARK, VALIDATOR)):
        raise ToolError(f"npm packages are missing: run `{INSTALL}` in the repository's folder")
    return found


def as_read(splats: Splats, suffix: str) -> Splats:
    """Returns the Gaussians that splat-transform reads from a file of Gaussians.

    SPZ files have axes that point right, up and back (Niantic's README). splat-transform 3 takes them for those of PLY
    files, which point right, down and forward. Thus its y and z have the other signs.
    """
    if suffix != ".spz":
        return splats
    signs = np.array([1, -1, -1], np.float32)
    return replace(
        splats,
        mean=splats.mean * signs,
        quaternion=splats.quaternion * np.append(np.float32(1), signs),
        rest=splats.rest * HARMONIC_SIGNS[: splats.rest.shape[1], None].astype(np.float32),
    )


def difference(file: Path, held: Splats) -> float:
    """Returns the difference between the Gaussians that splat-transform reads and the expected ones.

    held: the Gaussians of the file. The difference is the largest of a number, relative to the number if that is above
    1. Opacities are from 0 to 1, and rotations are matrices. Raises ToolError.
    """
    with tempfile.TemporaryDirectory() as folder:
        again = Path(folder) / "again.ply"
        convert(file, again)
        found = read_splats(again)
    wanted = as_read(held, file.suffix)
    if found.rest.shape != wanted.rest.shape:
        raise ToolError(f"splat-transform reads {found.rest.shape} harmonics of {file}, not {wanted.rest.shape}")
    pairs = [(getattr(found, name), getattr(wanted, name)) for name in ("mean", "base", "rest", "scale")]
    pairs.append((opacities(found), opacities(wanted)))
    pairs.append((rotation_matrix(found.unit_quaternions()), rotation_matrix(wanted.unit_quaternions())))
    return max(float((np.abs(a - b) / np.maximum(np.abs(b), 1)).max(initial=0)) for a, b in pairs)


def issues(file: Path) -> dict[str, int]:
    """Returns the number of messages of Khronos's validator for a GLB file, by code. Raises ToolError.

    The messages about the extension and its attributes, which the validator does not know, are omitted.
    """
    command = ["node", "-e", _VALIDATE, str(file.absolute())]
    done = subprocess.run(command, cwd=modules(), capture_output=True, text=True, check=False)
    if done.returncode:
        raise ToolError(f"the validator failed: {done.stderr.strip()[-500:]}")
    codes = [
        message["code"]
        for message in json.loads(done.stdout)["messages"]
        if message["code"] != "UNSUPPORTED_EXTENSION"
        and not (message["code"] == "MESH_PRIMITIVE_INVALID_ATTRIBUTE" and EXTENSION in message["pointer"])
    ]
    return dict(Counter(codes))
