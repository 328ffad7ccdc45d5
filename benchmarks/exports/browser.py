"""Pictures of splat files by third-party viewers, in a headless browser.

`spark.html` has three.js with Spark, which renders PLY, SPZ and SOG. `gltf.html` has only three.js, with its own
support of KHR_gaussian_splatting. A page fetches the cameras, renders, and sends its pictures back. Chromium uses
software rendering.
"""

from __future__ import annotations

import json
import subprocess
import tempfile
import threading
from collections.abc import Sequence
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from refcodec.rendering.camera import Camera
from refcodec.rendering.rasterise import Settings

from ..chromium import find
from ..peers.convert import ToolError
from .clients import modules

U8 = NDArray[np.uint8]

PAGES = Path(__file__).resolve().parent / "pages"
PAGE = {".ply": "spark.html", ".spz": "spark.html", ".sog": "spark.html", ".glb": "gltf.html"}
# Without a graphics card.
_OPTIONS = (
    *("--headless=new", "--no-sandbox", "--no-first-run"),
    *("--use-angle=swiftshader", "--enable-unsafe-swiftshader"),
)
_TYPES = {".html": "text/html", ".js": "text/javascript", ".wasm": "application/wasm"}
# Seconds for all pictures of a file.
PATIENCE = 240


def browser() -> str:
    """Returns the path of the browser. Raises ToolError."""
    found = find()
    if found is None:
        raise ToolError("Chromium is missing: apt-get install chromium")
    return found


def drawn(file: Path, cameras: Sequence[Camera], settings: Settings) -> list[U8]:
    """Returns a viewer's pictures of a splat file, uint8 [height, width, 3] for each camera.

    The cameras are those of the exported scene, whatever the axes of the format are. settings: rendering settings of
    3DGS, which Spark gets. Raises ToolError.
    """
    stated = {
        "file": f"/splats{file.suffix}",
        "suffix": file.suffix,
        "background": settings.background,
        "near": settings.near_plane,
        "low_pass": settings.low_pass,
        "cameras": [_stated(camera) for camera in cameras],
    }
    served = _Server(file, json.dumps(stated).encode())
    threading.Thread(target=served.serve_forever, daemon=True).start()
    try:
        with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
            address = f"http://127.0.0.1:{served.server_address[1]}/pages/{PAGE[file.suffix]}"
            command = [browser(), *_OPTIONS, f"--user-data-dir={profile}", address]
            program = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
            try:
                served.over.wait(PATIENCE)
            finally:
                program.terminate()
                program.wait()
    finally:
        served.shutdown()
        served.server_close()
    if served.fault or len(served.pictures) != len(cameras):
        raise ToolError(f"the viewer of {file.name} failed: {served.fault or 'it did not finish in time'}")
    found = []
    for number, camera in enumerate(cameras):
        pixels = np.frombuffer(served.pictures[number], np.uint8)
        found.append(pixels.reshape(camera.height, camera.width, 4)[:, :, :3])
    return found


def _stated(camera: Camera) -> dict[str, Any]:
    """Returns a camera for the pages. pose: by rows, from three.js's camera axes (right, up, back) to the world."""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = camera.rotation.T * (1, -1, -1), camera.centre
    lens = {name: getattr(camera, name) for name in ("width", "height", "fx", "fy", "cx", "cy")}
    return {**lens, "pose": pose.reshape(-1).tolist()}


class _Server(ThreadingHTTPServer):
    """Serves the pages, the packages, a splat file and the cameras, and takes pictures.

    pictures: RGBA by the number of their camera. fault: the error that a page reports. over: set at the end.
    """

    daemon_threads = True

    def __init__(self, file: Path, stated: bytes) -> None:
        super().__init__(("127.0.0.1", 0), _Handler)
        self.file, self.stated = file, stated
        self.folders = {"pages": PAGES, "modules": modules()}
        self.pictures: dict[int, bytes] = {}
        self.fault = ""
        self.over = threading.Event()

    def content(self, path: str) -> tuple[bytes, str] | None:
        """Returns the content at a path, and its type."""
        _, first, *rest = path.split("/")
        if first == "cameras.json":
            return self.stated, "application/json"
        if first.startswith("splats."):
            return self.file.read_bytes(), "application/octet-stream"
        place = self.folders.get(first)
        wanted = place and place.joinpath(*rest).resolve()
        if not place or not wanted or not wanted.is_relative_to(place.resolve()) or not wanted.is_file():
            return None
        return wanted.read_bytes(), _TYPES.get(wanted.suffix, "application/octet-stream")


class _Handler(BaseHTTPRequestHandler):
    server: _Server

    def do_GET(self) -> None:
        found = self.server.content(self.path.partition("?")[0])
        self._answer(404 if found is None else 200, *(found or (b"", "text/plain")))

    def do_POST(self) -> None:
        data = self.rfile.read(int(self.headers["Content-Length"]))
        _, kind, *rest = self.path.split("/")
        if kind == "picture":
            self.server.pictures[int(rest[0])] = data
        elif kind == "error":
            self.server.fault = data.decode("utf-8", "replace")[:500]
        self._answer(200, b"", "text/plain")
        if kind in ("done", "error"):
            self.server.over.set()

    def _answer(self, status: int, data: bytes, kind: str) -> None:
        self.send_response(status)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(data)))
        self.end_headers()
        self.wfile.write(data)

    def log_message(self, *words: Any) -> None:
        """Logs nothing."""
