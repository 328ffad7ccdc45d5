"""Static scenes in the viewer and in pages of Spark and PlayCanvas, opened in Chromium.

The packages are looked for as in test_web_three.py: `npm install three @sparkjsdev/spark playcanvas`.
"""

from __future__ import annotations

import base64
import io
import threading
from dataclasses import replace
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_web_three import FOLDERS
from web_program import ROOT, WEB

from benchmarks.large import made_static
from refcodec.bitstream import cameras, codec
from refcodec.bitstream.scene import Ancillary
from refcodec.viewer.page import page
from tests.chromium import Chromium, find

pytestmark = [
    pytest.mark.no_cover,
    pytest.mark.slow,
    pytest.mark.skipif(find() is None, reason="there is no Chromium here, so the pages are not opened"),
]

PAGES = Path(__file__).with_name("pages")
TYPES = {".html": "text/html", ".js": "text/javascript", ".mjs": "text/javascript", ".wasm": "application/wasm"}
VALID = ROOT / "vectors" / "valid"
CAMERAS = 4


@pytest.fixture(scope="module", params=[1, 3])
def path(request: pytest.FixtureRequest) -> tuple[bytes, list[np.ndarray]]:
    """A static scene with harmonics of a degree that states a path of cameras, and what `refcodec render` draws."""
    for package in ("numba", "PIL", "scipy"):
        pytest.importorskip(package, reason="the pictures are compared with those of the extra render")
    from refcodec.rendering.camera import named_camera  # noqa: PLC0415
    from refcodec.rendering.view import View, eight_bits  # noqa: PLC0415

    scene = made_static(codec.parse((VALID / "trained-caliterra.c3gs").read_bytes()).scene, request.param)
    seen = View(scene)
    orbit = [camera.resized(320, 240) for camera in seen.orbit(CAMERAS)]
    named = [named_camera(camera, f"{number}") for number, camera in enumerate(orbit)]
    section = Ancillary(cameras.CAMERAS, 0, cameras.emit_cameras(named))
    return codec.emit(replace(scene, ancillary=(section,))), [eight_bits(seen.draw(camera)) for camera in orbit]


class _Server(ThreadingHTTPServer):
    """Serves the pages, the module, packages and files, each under a name of its own."""

    daemon_threads = True

    def __init__(self, places: dict[str, Path], files: dict[str, bytes]) -> None:
        super().__init__(("127.0.0.1", 0), _Handler)
        self.places, self.files = places, files


class _Handler(BaseHTTPRequestHandler):
    server: _Server

    def do_GET(self) -> None:
        _, first, *rest = self.path.partition("?")[0].split("/")
        path = self.server.places.get(first, PAGES / first).joinpath(*rest)
        data = self.server.files.get(first) or (path.read_bytes() if path.is_file() else None)
        self.send_response(404 if data is None else 200)
        self.send_header("Content-Type", TYPES.get(path.suffix, "application/octet-stream"))
        self.send_header("Content-Length", str(len(data or b"")))
        self.end_headers()
        self.wfile.write(data or b"")

    def log_message(self, *words: Any) -> None:
        """Logs nothing."""


def _image(address: str) -> np.ndarray:
    """Returns the image of a data URL, uint8 [height, width, 3]."""
    from PIL import Image  # noqa: PLC0415

    return np.asarray(Image.open(io.BytesIO(base64.b64decode(address.partition(",")[2]))).convert("RGB"))


def _pictures(name: str, packages: tuple[str, ...], data: bytes) -> list[np.ndarray]:
    """Returns what a page draws of a file for each camera. It must report nothing. Skips without its packages."""
    modules = next((f for f in FOLDERS if all((f / package / "package.json").exists() for package in packages)), None)
    if modules is None:
        pytest.skip(f"{' and '.join(packages)} are in no folder of NODE_PATH")
    with _Server({"modules": modules, "c3gs": WEB}, {"scene.c3gs": data}) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        with Chromium(str(find()), 320, 240) as browser:
            browser.open(f"http://127.0.0.1:{server.server_address[1]}/{name}.html")
            browser.until("globalThis.picture !== undefined")
            images = [_image(browser.run(f"picture({number})")) for number in range(CAMERAS)]
            assert browser.said == []
        server.shutdown()
    return images


def _agreement(images: list[np.ndarray], right: list[np.ndarray]) -> list[float]:
    """Returns the PSNR of each picture, in dB."""
    pairs = zip(images, right, strict=True)
    return [10 * np.log10(255**2 / max(np.mean((a.astype(np.float64) - b) ** 2), 1e-9)) for a, b in pairs]


def test_the_viewer_draws_what_render_draws(path: tuple[bytes, list[np.ndarray]], tmp_path: Path) -> None:
    data, right = path
    (tmp_path / "scene.html").write_bytes(page("scene.c3gs", data))
    with Chromium(str(find()), 320, 240) as browser:
        browser.open((tmp_path / "scene.html").as_uri())
        browser.run("c3gs.settle()")
        images = [_image(browser.run(f"c3gs.picture(c3gs.cameras[{number}])")) for number in range(CAMERAS)]
        assert browser.said == []
    assert min(_agreement(images, right)) > 45


def test_spark_draws_what_render_draws(path: tuple[bytes, list[np.ndarray]]) -> None:
    images = _pictures("spark", ("three", "@sparkjsdev/spark"), path[0])
    assert min(_agreement(images, path[1])) > 45


def test_playcanvas_draws_the_scene(path: tuple[bytes, list[np.ndarray]]) -> None:
    """Its Gaussians end at another distance, and are blended in 8 bits."""
    assert min(_agreement(_pictures("playcanvas", ("playcanvas",), path[0]), path[1])) > 30
