"""The table of exports: its figures are kept, its files are what they are said to be, and pictures come by a server."""

from __future__ import annotations

import json
import shutil
import urllib.error
import urllib.request
from pathlib import Path
from threading import Thread

import numpy as np
import pytest

from benchmarks.exports import browser, making
from benchmarks.exports.__main__ import main
from benchmarks.exports.browser import drawn
from benchmarks.exports.making import Source, file_of, held, scene_record, splat_record
from benchmarks.peers.convert import ToolError
from refcodec.bitstream.cameras import rotation_matrix
from refcodec.export.formats import FORMATS
from refcodec.render.camera import Camera
from refcodec.render.rasterise import Settings

ROOT = Path(__file__).resolve().parents[2]
TRAINED = ROOT / "vectors" / "valid" / "trained-caliterra.c3gs"


@pytest.fixture
def source(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Source:
    monkeypatch.setattr(making, "ITERATIONS", 0)
    return Source("caliterra", TRAINED, folder, 40)


def test_figures_of_a_degree(source: Source, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = scene_record(source, tmp_path)
    assert (scene["gaussians"], scene["bytes"]) == (6120, TRAINED.stat().st_size)
    record = splat_record(source, 1, tmp_path)
    for suffix in FORMATS:
        file, found = file_of(source, 1, suffix, tmp_path), record["files"][suffix]
        assert found["bytes"] == file.stat().st_size
        # It is nearer to the scene than the scene is to the photographs.
        assert found["near"] > scene["psnr"] > found["psnr"] - 1 > 15
        splats = held(source, 1, suffix, tmp_path)
        assert len(splats.mean) == record["gaussians"]
        assert splats.degree == 1
    # What is there is not made again.
    monkeypatch.setattr(making, "fit", None)
    assert splat_record(source, 1, tmp_path) == record
    file.write_bytes(b"another file")
    with pytest.raises(ValueError, match="remove the folder"):
        held(source, 1, ".glb", tmp_path)


def test_the_command(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(making, "ITERATIONS", 0)
    words = [str(tmp_path / "out"), "--scene", "a", str(TRAINED), str(folder), "--size", "40", "--degrees", "0"]
    assert main(words) == 0
    lines = capsys.readouterr().out.splitlines()
    assert "### a" in lines
    assert [line.split(" | ")[0][2:] for line in lines if line.startswith("| .")] == [".c3gs", *FORMATS]
    monkeypatch.setattr(browser, "find", lambda: None)
    assert main([*words, "--clients"]) == 64
    assert "missing" in (said := capsys.readouterr().err) or "Chromium" in said


def test_a_camera_of_the_pages() -> None:
    """A point ahead, to the right and below is where three.js's axes have it: right, up, and away from the view."""
    turn = rotation_matrix(np.array([0.5, 0.5, -0.5, 0.5]))
    camera = Camera("a", 40, 30, 50, 60, 21, 14, turn, np.array([1.0, 2.0, 3.0]))
    stated = browser._stated(camera)
    point = np.array([0.3, -0.2, 0.9])
    x, y, z = turn @ point + camera.translation
    pose = np.array(stated["pose"]).reshape(4, 4)
    np.testing.assert_allclose(np.linalg.inv(pose) @ [*point, 1], [x, -y, -z, 1], atol=1e-12)
    assert (stated["width"], stated["height"], stated["fx"], stated["cy"]) == (40, 30, 50, 14)


def test_pictures_come_by_a_server(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A program in the place of a browser fetches the cameras and sends two pictures, or an error."""
    packages = tmp_path / "packages"
    (packages / "three").mkdir(parents=True)
    (packages / "three" / "a.js").write_text("export {}")
    (tmp_path / "secret").write_text("secret")
    monkeypatch.setattr(browser, "modules", lambda: packages)
    cameras = [Camera(str(i), 4, 3, 5, 5, 2, 1.5, np.eye(3), np.zeros(3)) for i in range(2)]
    file = tmp_path / "a.spz"
    file.write_bytes(b"splats")
    asked: list[object] = []

    class Program:
        """What Popen gives."""

        fault = ""

        def __init__(self, command: list[str], **options: object) -> None:
            self.address = command[-1]
            Thread(target=self.work).start()

        def work(self) -> None:
            root = self.address.partition("/pages/")[0]

            def fetch(path: str, data: bytes | None = None) -> bytes:
                with urllib.request.urlopen(root + path, data, timeout=10) as answer:
                    return bytes(answer.read())

            stated = json.loads(fetch("/cameras.json"))
            asked.extend(
                [stated["suffix"], fetch(stated["file"]), fetch("/modules/three/a.js"), fetch("/pages/spark.html")]
            )
            for path in ("/modules/../secret", "/modules/three/../../secret", "/nothing", "/modules/"):
                try:
                    asked.append(fetch(path))
                except urllib.error.HTTPError as error:
                    asked.append(error.code)
            for number in range(len(stated["cameras"])):
                fetch(f"/picture/{number}", bytes([number, 2, 3, 255]) * 12)
            fetch(*(("/error", Program.fault.encode()) if Program.fault else ("/done", b"")))

        def terminate(self) -> None:
            """The program is over."""

        wait = terminate

    monkeypatch.setattr(browser, "browser", lambda: "browser")
    monkeypatch.setattr(browser.subprocess, "Popen", Program)
    found = drawn(file, cameras, Settings())
    assert [image.shape for image in found] == [(3, 4, 3)] * 2
    assert [image[1, 1].tolist() for image in found] == [[0, 2, 3], [1, 2, 3]]
    assert asked[:3] == [".spz", b"splats", b"export {}"]
    assert b"SparkRenderer" in asked[3]  # type: ignore[operator]
    assert asked[4:] == [404] * 4
    monkeypatch.setattr(Program, "fault", "no WebGL")
    with pytest.raises(ToolError, match="no WebGL"):
        drawn(file, cameras, Settings())
    shutil.rmtree(packages)
