"""Each command once, in the shortest way in which it does its work, or begins it."""

import json
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest

from conformance import cli as suite
from conformance.manifest import VECTORS
from refcodec import statuses
from refcodec.cli import main as refcodec

CAMERA = {"focal": [9, 9], "principal_point": [4, 3], "rotation": np.eye(3).tolist(), "translation": [0, 0, 4]}
DONE, REJECTED, USAGE, DAMAGED = statuses.DONE, statuses.REJECTED, statuses.USAGE, statuses.DAMAGED_SUITE
DECODER = ("--", sys.executable, "-m", "conformance.spec_decoder", "decode", "{input}", "{output}")
# The words, and the exit status. A command that would take long is refused for the file that it has to read.
COMMANDS: list[tuple[tuple[str, ...], int]] = [
    (("conformance", "check-encoder", "scene.c3gs"), DONE),
    (("conformance", "fuzz", "-n", "1", "--jobs", "1", "--", "none", "{input}", "{output}"), USAGE),
    (("conformance", "generate", "-o", "photos"), USAGE),
    (("conformance", "run", "--select", "id:valid-plain", "--slow", "20", *DECODER), DONE),
    (("conformance", "selftest", "--manifest", "scene.c3gs"), DAMAGED),
    (("conformance", "verify-report", "scene.c3gs", *DECODER), USAGE),
    (("refcodec", "convert", "cloud.ply", "-o", "new.c3gs"), USAGE),
    (("refcodec", "decode", "scene.c3gs", "-o", "folder"), DONE),
    (("refcodec", "demo", "--photographs", "folder", "-o", "new"), USAGE),
    (("refcodec", "digest", "scene.c3gs"), DONE),
    (("refcodec", "encode", "folder", "-o", "again.c3gs"), DONE),
    (("refcodec", "eval", "scene.c3gs", "folder"), USAGE),
    (("refcodec", "experiment", "camera.json", "-o", "new"), USAGE),
    (("refcodec", "explain", "R6.1-1"), DONE),
    (("refcodec", "export", "scene.c3gs", "-o", "new.html"), DONE),
    (("refcodec", "fit", "cloud.ply", "-o", "new"), USAGE),
    (("refcodec", "gaussians", "scene.c3gs", "camera.json", "gaussians.json"), DONE),
    (("refcodec", "inspect", "scene.c3gs"), DONE),
    (("refcodec", "migrate", "scene.c3gs", "-o", "new.c3gs"), DONE),
    (("refcodec", "rd", "folder", "-o", "new"), USAGE),
    (("refcodec", "reconstruct", "scene.c3gs", "output"), DONE),
    (("refcodec", "render", "scene.c3gs", "-o", "images"), DONE),
    (("refcodec", "train", "--print-settings"), DONE),
    (("refcodec", "validate", "damaged.c3gs"), REJECTED),
    (("refcodec", "view", "none.c3gs", "--no-browser"), USAGE),
]


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("commands")
    shutil.copy(VECTORS / "tiny-example.c3gs", folder / "scene.c3gs")
    (folder / "damaged.c3gs").write_bytes((VECTORS / "tiny-example.c3gs").read_bytes()[:-1])
    (folder / "cloud.ply").write_bytes(b"no cloud")
    (folder / "photos").mkdir()
    (folder / "photos" / "a.txt").touch()
    (folder / "camera.json").write_text(json.dumps({"width": 8, "height": 6, **CAMERA}))
    assert refcodec.main(["decode", str(folder / "scene.c3gs"), "-o", str(folder / "folder")]) == DONE
    return folder


@pytest.mark.parametrize(("words", "status"), COMMANDS, ids=[" ".join(words[:2]) for words, _ in COMMANDS])
def test_a_command(words: tuple[str, ...], status: int, place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(place)
    program, *rest = words
    assert (refcodec.main if program == "refcodec" else suite.main)(rest) == status
