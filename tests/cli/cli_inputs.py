"""Inputs of all commands in a folder, and a command in this process, for the tests of the command line."""

import json
import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from importlib import import_module
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

import numpy as np
from random_scenes import random_scene

from conformance.manifest import VECTORS
from refcodec.bitstream.codec import emit, parse
from refcodec.bitstream.scene import Ancillary
from refcodec.folder.write import write_folder

# A command in this process: its exit status, stdout and stderr.
Call = Callable[..., tuple[int, str, str]]
ROOT = Path(__file__).resolve().parents[2]
EXAMPLE, TRAINED = ROOT / "vectors" / "tiny-example.c3gs", ROOT / "vectors" / "valid" / "trained-caliterra.c3gs"
CALITERRA = ROOT / "examples" / "photographs" / "caliterra"
# Commands that decode a file.
DECODING = [
    "validate FILE",
    "digest FILE",
    "decode FILE -o new",
    "reconstruct FILE new --trace new.txt",
    "migrate FILE -o new",
    "gaussians FILE camera.json new",
    "inspect FILE --trace",
    "render FILE -o new",
    "export FILE -o new.ply",
    "export FILE -o new.html",
    "eval FILE photos --size 48 --images new",
]


def packages(*names: str) -> bool:
    """Whether some packages are installed."""
    try:
        return bool([import_module(name) for name in names]) or not names
    except ModuleNotFoundError:
        return False


def lacking(command: str) -> bool:
    """Whether a command needs packages that are not there."""
    return command.startswith(("render", "export", "eval")) and not packages("numba", "PIL")


@cache
def inputs() -> Path:
    """The inputs: files, a damaged one, scene folders, a camera, points, photographs, vectors, and a text."""
    folder = Path(mkdtemp()) / "inputs"
    folder.mkdir()
    scene = replace(random_scene(21, 6, chunk_size=4), ancillary=(Ancillary(b"noTE", 0, b"kept", 5),))
    scene.networks["opacity"][-1][1][:] = 5
    other = random_scene(22, 5, chunk_size=4)
    (folder / "scene.c3gs").write_bytes(emit(scene))
    (folder / "other.c3gs").write_bytes(emit(other))
    (folder / "bad.c3gs").write_bytes(emit(scene)[:-1])
    for name in ("scene", "other"):
        write_folder(parse((folder / f"{name}.c3gs").read_bytes()).scene, folder / name)
    camera = {"width": 8, "height": 6, "focal": [8, 8], "principal_point": [4, 3], "translation": [0, 0, 4]}
    (folder / "camera.json").write_text(json.dumps({**camera, "rotation": np.eye(3).tolist()}))
    points = [f"{i} {i % 5} {i // 5} {i % 3} 90 90 200 0.5\n" for i in range(30)]
    (folder / "points3D.txt").write_text("".join(points))
    (folder / "letter.txt").write_text("precious\n")
    if packages("PIL"):
        photographs(folder / "photos")
    document = json.loads((VECTORS / "manifest.json").read_text())
    document["vectors"] = [v for v in document["vectors"] if v["id"].startswith("valid-")][:2]
    for name in ("flags", "features"):
        used = {entry for vector in document["vectors"] for entry in vector[name]}
        document[name] = {entry: text for entry, text in document[name].items() if entry in used}
    for name in ("manifest.schema.json", *(vector["input"]["path"] for vector in document["vectors"])):
        (folder / "suite" / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(VECTORS / name, folder / "suite" / name)
    (folder / "suite" / "manifest.json").write_text(json.dumps(document))
    return folder


def photographs(folder: Path) -> None:
    """Four photographs in NeRF's format, of which two have one name in two folders."""
    image: Any = import_module("PIL.Image")
    frames = []
    for number, name in enumerate(("l/0.png", "r/0.png", "l/1.png", "r/1.png")):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        pixels = np.random.default_rng(number).integers(0, 256, (12, 16, 3)).astype(np.uint8)
        image.fromarray(pixels).save(folder / name)
        c, s = np.cos(number / 3), np.sin(number / 3)
        pose = [[c, 0, s, 4 * s], [0, 1, 0, 0], [-s, 0, c, 4 * c], [0, 0, 0, 1]]
        frames.append({"file_path": name, "transform_matrix": pose})
    for part, some in {"train": frames[2:], "test": frames[:2]}.items():
        (folder / f"transforms_{part}.json").write_text(json.dumps({"camera_angle_x": 0.7, "frames": some}))


def rows(text: str, columns: int) -> list[list[str]]:
    """The rows of a table in text, with | between columns. Missing ones are empty, and # begins a remark."""
    lines = [line.strip() for line in text.strip().splitlines() if not line.strip().startswith("#")]
    return [(re.split(r"\s*\|\s*", line) + [""] * columns)[:columns] for line in lines]


def contents(folder: Path) -> dict[str, bytes | None]:
    """Everything below a folder by name; None for a folder and a pipe."""
    return {p.relative_to(folder).as_posix(): p.read_bytes() if p.is_file() else None for p in folder.rglob("*")}
