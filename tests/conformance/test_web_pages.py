"""Static scenes in the viewer and in pages of Spark, PlayCanvas and three.js, opened in Chromium.

The packages are looked for as in test_web_three.py: `npm install three @sparkjsdev/spark playcanvas`.
"""

from __future__ import annotations

import base64
import contextlib
import io
import threading
from collections.abc import Iterator
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
from refcodec.formats.glb import glb_bytes
from refcodec.rendering.camera import axis_direction
from refcodec.rendering.gaussians import static_splats
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
# Since three 0.187.
SPLATS = "examples/jsm/loaders/GLTFGaussianSplatLoaderExtension.js"
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


@contextlib.contextmanager
def _opened(name: str, packages: tuple[str, ...], files: dict[str, bytes]) -> Iterator[Chromium]:
    """Opens a page, which must report nothing. Skips without its packages. files: what the page loads, by name."""
    modules = next((f for f in FOLDERS if all((f / package / "package.json").exists() for package in packages)), None)
    if modules is None:
        pytest.skip(f"{' and '.join(packages)} are in no folder of NODE_PATH")
    with _Server({"modules": modules, "c3gs": WEB}, files) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        with Chromium(str(find()), 320, 240) as browser:
            browser.open(f"http://127.0.0.1:{server.server_address[1]}/{name}.html")
            browser.until("globalThis.picture !== undefined")
            yield browser
            assert browser.said == []
        server.shutdown()


def _pictures(name: str, packages: tuple[str, ...], data: bytes) -> list[np.ndarray]:
    """Returns what a page draws for each camera."""
    with _opened(name, packages, {"scene.c3gs": data}) as browser:
        return [_image(browser.run(f"picture({number})")) for number in range(CAMERAS)]


def _agreement(found: list[np.ndarray], right: list[np.ndarray]) -> list[float]:
    """Returns the PSNR of each picture, in dB."""
    pairs = zip(found, right, strict=True)
    return [10 * np.log10(255**2 / max(np.mean((a.astype(np.float64) - b) ** 2), 1e-9)) for a, b in pairs]


def test_the_viewer_draws_what_render_draws(path: tuple[bytes, list[np.ndarray]], tmp_path: Path) -> None:
    data, right = path
    (tmp_path / "scene.html").write_bytes(page("scene.c3gs", data))
    with Chromium(str(find()), 320, 240) as browser:
        browser.open((tmp_path / "scene.html").as_uri())
        browser.run("c3gs.settle()")
        found = [_image(browser.run(f"c3gs.picture(c3gs.cameras[{number}])")) for number in range(CAMERAS)]
        assert browser.said == []
    assert min(_agreement(found, right)) > 45


def test_spark_draws_what_render_draws(path: tuple[bytes, list[np.ndarray]]) -> None:
    found = _pictures("spark", ("three", "@sparkjsdev/spark"), path[0])
    assert min(_agreement(found, path[1])) > 45


def test_playcanvas_draws_the_scene(path: tuple[bytes, list[np.ndarray]]) -> None:
    """Its Gaussians end at another distance, and are blended in 8 bits."""
    assert min(_agreement(_pictures("playcanvas", ("playcanvas",), path[0]), path[1])) > 30


def test_three_draws_the_means(path: tuple[bytes, list[np.ndarray]]) -> None:
    assert min(_agreement(_pictures("three", ("three",), path[0]), path[1])) > 12


def test_three_draws_glb_files(path: tuple[bytes, list[np.ndarray]]) -> None:
    """Its own renderer draws the same from the compressed scene and from the fallback. It has harmonics of 8 bits."""
    data, right = path
    scene = codec.parse(data).scene
    splats, up = static_splats(scene), axis_direction(scene.render.up_axis)
    files = {"c3gs.glb": glb_bytes(splats, up, data, plain=False), "both.glb": glb_bytes(splats, up, data)}
    if not any((f / "three" / SPLATS).exists() for f in FOLDERS):
        pytest.skip("three is in no folder of NODE_PATH, or has no loader of Gaussians in glTF")
    with _opened("gltf", ("three",), {"scene.c3gs": data, **files}) as browser:
        assert browser.run("kinds") == ["GaussianSplat"] * 3
        assert browser.run("same(0)")
        found = [_image(browser.run(f"picture({number})")) for number in range(CAMERAS)]
    assert min(_agreement(found, right)) > 28
