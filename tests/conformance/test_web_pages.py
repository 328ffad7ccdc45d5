"""The viewer, and the pages of Spark, PlayCanvas and three.js in the manual, opened in Chromium.

The newest packages are installed by npm where its registry can be reached, and else looked for as in test_web_three.py.
"""

import base64
import io
import re
import shutil
import subprocess
import threading
import time
from dataclasses import replace
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_web_three import FOLDERS
from web_program import MISSING, NODE, ROOT, WEB

from benchmarks.large import made_static
from refcodec.bitstream import cameras, codec
from refcodec.bitstream.scene import Ancillary, Scene
from refcodec.cli.main import main
from refcodec.viewer.page import page
from tests.chromium import Chromium, find

pytestmark = [
    pytest.mark.no_cover,
    pytest.mark.slow,
    pytest.mark.skipif(find() is None, reason="there is no Chromium here, so the pages are not opened"),
]

TYPES = {"": "text/html", ".js": "text/javascript", ".mjs": "text/javascript", ".wasm": "application/wasm"}
TRAINED = ROOT / "vectors" / "valid" / "trained-caliterra.c3gs"
SIZE = WIDTH, HEIGHT = 320, 240
CAMERAS = 4
PACKAGES = ("three", "@types/three", "@sparkjsdev/spark", "playcanvas", "typescript", "vite")
# A word of each example that is a whole page, and of the modules that it imports.
WORDS = ("c3gs/spark", "c3gs/playcanvas", "GLTFLoader", "GaussianSplat.js")
# An example in a page, which finds packages where a bundler would.
PAGE = """<!doctype html><meta charset="utf-8"><link rel="icon" href="data:,"><style>body {{ margin: 0 }}</style>
<script type="importmap">{{"imports": {{
  "c3gs/gltf": "/c3gs/gltf.js", "c3gs/playcanvas": "/c3gs/playcanvas.js", "c3gs/spark": "/c3gs/spark.js",
  "c3gs/three": "/c3gs/three.js", "playcanvas": "/modules/playcanvas/build/playcanvas.mjs",
  "three": "/modules/three/build/three.module.js", "three/webgpu": "/modules/three/build/three.webgpu.js",
  "three/tsl": "/modules/three/build/three.tsl.js", "three/addons/": "/modules/three/examples/jsm/",
  "@sparkjsdev/spark": "/modules/@sparkjsdev/spark/dist/spark.module.min.js"}}}}</script>
<body></body><script type="module">{code}</script>"""


@pytest.fixture(scope="module")
def modules(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of npm packages, of their newest versions if npm gets them."""
    folder = tmp_path_factory.mktemp("npm")
    if shutil.which("npm") is not None:
        quick = "--fetch-retries=0 --fetch-timeout=20000 --no-audit --no-fund --ignore-scripts"
        subprocess.run(["npm", "pack", str(WEB)], cwd=folder, capture_output=True, check=False)
        command = ["npm", "install", *quick.split(), *PACKAGES, *map(str, folder.glob("*.tgz"))]
        if subprocess.run(command, cwd=folder, capture_output=True, check=False).returncode == 0:
            return folder / "node_modules"
    found = next((f for f in FOLDERS if all((f / name / "package.json").exists() for name in PACKAGES)), None)
    if found is None:
        pytest.skip(f"npm gets no packages here, and {', '.join(PACKAGES)} are in no folder of NODE_PATH")
    return found


def examples(word: str) -> list[str]:
    """Returns the code blocks of the manual that have a word."""
    texts = [path.read_text(encoding="utf-8") for path in (WEB / "README.md", ROOT / "docs" / "page.md")]
    return [block for text in texts for block in re.findall(r"```js\n(.*?)```", text, re.DOTALL) if word in block]


@pytest.fixture(scope="module", params=[None, 1, 3], ids=["view-dependent", "degree 1", "degree 3"])
def scene(request: pytest.FixtureRequest) -> tuple[Scene, list[Any]]:
    """A scene with -y up, static with harmonics of a degree or not, and a path of cameras."""
    for package in ("numba", "PIL", "scipy"):
        pytest.importorskip(package, reason="the pictures are compared with those of the extra render")
    from refcodec.rendering.view import View  # noqa: PLC0415

    found = codec.parse(TRAINED.read_bytes()).scene
    found = replace(found, render=replace(found.render, up_axis=3))
    if request.param is not None:
        found = made_static(found, request.param)
    return found, [camera.resized(*SIZE) for camera in View(found).orbit(CAMERAS)]


def coded(scene: Scene, path: list[Any]) -> bytes:
    """Returns a file that states cameras."""
    from refcodec.rendering.camera import named_camera  # noqa: PLC0415

    named = [named_camera(camera, f"{number}") for number, camera in enumerate(path)]
    return codec.emit(replace(scene, ancillary=(Ancillary(cameras.CAMERAS, 0, cameras.emit_cameras(named)),)))


def drawn(scene: Scene, camera: Any) -> np.ndarray:
    """Returns what `refcodec render` draws."""
    from refcodec.rendering.view import View, eight_bits  # noqa: PLC0415

    return eight_bits(View(scene).draw(camera))


class _Server(ThreadingHTTPServer):
    """Serves files of folders, and files in memory, each under a name of its own."""

    daemon_threads = True

    def __init__(self, places: dict[str, Path], files: dict[str, bytes]) -> None:
        super().__init__(("127.0.0.1", 0), _Handler)
        self.places, self.files = places, files


class _Handler(BaseHTTPRequestHandler):
    server: _Server

    def do_GET(self) -> None:
        _, first, *rest = self.path.partition("?")[0].split("/")
        path = self.server.places.get(first, Path(first)).joinpath(*rest)
        data = self.server.files.get(first) or (path.read_bytes() if rest and path.is_file() else None)
        self.send_response(404 if data is None else 200)
        self.send_header("Content-Type", TYPES.get(path.suffix, "application/octet-stream"))
        self.send_header("Content-Length", str(len(data or b"")))
        self.end_headers()
        self.wfile.write(data or b"")

    def log_message(self, *words: Any) -> None:
        """Logs nothing."""


def _image(data: bytes) -> np.ndarray:
    """Returns an image, uint8 [height, width, 3]."""
    from PIL import Image  # noqa: PLC0415

    return np.asarray(Image.open(io.BytesIO(data)).convert("RGB"))


def _tail(*ends: str) -> str:
    """Returns what an example has behind it: functions of expressions, for _shown."""
    return f"\nglobalThis.ends = [{', '.join(f'() => {end}' for end in ends)}];"


def _shown(places: dict[str, Path], files: dict[str, bytes]) -> tuple[list[np.ndarray], list[Any]]:
    """Returns what a page shows after each of its expressions, and their values. It must report nothing."""
    images, values = [], []
    with _Server(places, files) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        with Chromium(str(find()), *SIZE) as browser:
            browser.open(f"http://127.0.0.1:{server.server_address[1]}/")
            browser.until("globalThis.ends !== undefined")
            for number in range(browser.run("ends.length")):
                browser.run(f"ends[{number}]()")
                # Workers sort after the first frames. A picture that stays is that of the last order.
                last: list[bytes] = []
                while len(last) < 4 or len({*last[-4:]}) > 1 or np.ptp(_image(last[-1])) == 0:
                    assert len(last) < 60, "the picture does not stay"
                    time.sleep(0.5)
                    last.append(browser.screenshot())
                images.append(_image(last[-1]))
                values.append(browser.run(f"ends[{number}]()"))
            # three.js notes that software has no WebGPU.
            assert [text for text in browser.said if "WebGPU" not in text and "adapters" not in text] == []
        server.shutdown()
    return images, values


def _example(modules: Path, code: str, files: dict[str, bytes], *ends: str) -> tuple[list[np.ndarray], list[Any]]:
    """Returns what an example shows after each expression, and the values."""
    page = PAGE.format(code=code + _tail(*ends)).encode()
    packed = modules / "c3gs"
    return _shown({"modules": modules, "c3gs": packed if packed.exists() else WEB}, {"": page, **files})


def _agreement(one: np.ndarray, other: np.ndarray) -> float:
    """Returns the PSNR of two pictures, in dB."""
    return float(10 * np.log10(255**2 / max(np.mean((one.astype(np.float64) - other) ** 2), 1e-9)))


@pytest.mark.parametrize("alpha_max", [0.5, 0.99])
def test_the_viewer_draws_what_render_draws(alpha_max: float, scene: tuple[Scene, list[Any]], tmp_path: Path) -> None:
    """Beyond 50 dB (SPEC.md 14.5), also where many Gaussians are as opaque as the file allows."""
    found, path = scene
    if alpha_max > 0.9 and found.render.render_model:
        # Gaussians that cover many pixels: the logits are larger by 12, and the logarithms of the lengths by 2.
        networks = dict(found.networks)
        for name, width, more in (("opacity", 1, [12]), ("covariance", 7, [2, 2, 2, 0, 0, 0, 0])):
            *first, (weight, bias) = networks[name]
            networks[name] = [*first, (weight, bias + np.tile(np.float32(more) * 4096, len(bias) // width))]
        found = replace(found, networks=networks)
    found = replace(found, render=replace(found.render, alpha_max=alpha_max, background=(90, 0, 160)))
    (tmp_path / "scene.html").write_bytes(page("scene.c3gs", coded(found, path)))
    with Chromium(str(find()), *SIZE) as browser:
        browser.open((tmp_path / "scene.html").as_uri())
        browser.run("c3gs.settle()")
        addresses = [
            browser.run(f"c3gs.picture(c3gs.cameras.find((c) => c.name === '{number}'))") for number in range(CAMERAS)
        ]
        assert browser.said == []
    images = [_image(base64.b64decode(address.partition(",")[2])) for address in addresses]
    assert min(map(_agreement, images, [drawn(found, camera) for camera in path])) > 55


def test_the_example_of_spark(scene: tuple[Scene, list[Any]], modules: Path) -> None:
    """It draws what is there of a file, then all of it, and another camera when the camera has moved."""
    (code,), (found, path) = examples(WORDS[0]), scene
    head = """let rest; const whole = fetch; globalThis.fetch = async (url, ...more) => {
      const bytes = new Uint8Array(await (await whole(url, ...more)).arrayBuffer());
      const start = (given) => (given.enqueue(bytes.subarray(0, -2000)),
        rest = () => (rest = () => 0, given.enqueue(bytes.subarray(-2000)), given.close()));
      return url === "scene.c3gs" ? new Response(new ReadableStream({ start })) : whole(url, ...more);
    };\n"""
    up = "camera.matrixWorld.elements[5]"
    move = "(camera.position.copy(model.cameras[1].position), camera.quaternion.copy(model.cameras[1].quaternion), "
    ends = "mesh.isInitialized", f"(rest(), mesh.initialized.then(() => {up}))", f"{move} {up})"
    files = {"scene.c3gs": coded(replace(found, chunk_size=512, chunk_anchors=None, position_forms=None), path)}
    (part, *images), (is_whole, *ups) = _example(modules, head + code, files, *ends)
    assert not is_whole
    assert 15 < _agreement(part, drawn(found, path[0])) < 25
    assert min(map(_agreement, images, [drawn(found, camera) for camera in path])) > 45
    assert min(ups) > 0.5


@pytest.mark.parametrize("first", [0, 1])
@pytest.mark.parametrize(
    ("word", "up", "least"),
    [(WORDS[1], 'app.root.findByName("camera")?.up.y', 30), (WORDS[3], "camera.matrixWorld.elements[5]", 28)],
    ids=["PlayCanvas", "three.js"],
)
def test_the_other_examples(
    word: str, up: str, least: float, scene: tuple[Scene, list[Any]], modules: Path, first: int
) -> None:
    """Gaussians of PlayCanvas end at another distance. Small ones of three.js are transparent instead of larger."""
    (code,), (found, path) = examples(word), scene
    (image,), (height,) = _example(modules, code, {"scene.c3gs": coded(found, path[first:])}, up)
    assert height > 0.5
    assert _agreement(image, drawn(found, path[first])) > least


def test_the_example_of_gltf(scene: tuple[Scene, list[Any]], modules: Path, tmp_path: Path) -> None:
    """Its camera is its own. three.js makes small Gaussians transparent instead of larger."""
    from refcodec.rendering.camera import Camera  # noqa: PLC0415

    (code,), (found, path) = examples(WORDS[2]), scene
    if not found.render.render_model:
        pytest.skip("glTF has static scenes only")
    (tmp_path / "scene.c3gs").write_bytes(coded(found, path))
    assert main(["export", str(tmp_path / "scene.c3gs"), "-o", str(tmp_path / "scene.glb"), "--glb", "c3gs"]) == 0
    files = {"scene.glb": (tmp_path / "scene.glb").read_bytes()}
    end = "[camera.fov, scene.children[0].matrixWorld.clone().invert().multiply(camera.matrixWorld).toArray()]"
    (image,), ((angle, matrix),) = _example(modules, code, files, end)
    pose = np.array(matrix).reshape(4, 4).T
    rotation = (pose[:3, :3] * [1, -1, -1]).T
    focal = HEIGHT / 2 / np.tan(np.radians(angle) / 2)
    camera = Camera("", *SIZE, focal, focal, WIDTH / 2, HEIGHT / 2, rotation, -rotation @ pose[:3, 3])
    assert _agreement(image, drawn(found, camera)) > 28


@pytest.mark.skipif(NODE is None, reason=MISSING)
@pytest.mark.parametrize("manual", [WEB / "README.md", ROOT / "docs" / "page.md"], ids=["README", "page"])
def test_the_package_installs_as_the_manual_says(
    scene: tuple[Scene, list[Any]], modules: Path, tmp_path: Path, manual: Path
) -> None:
    """In an empty folder: tsc --strict accepts the examples, and Vite's page of one shows the picture."""
    page, (found, path) = tmp_path / "page", scene
    page.mkdir()
    (tmp_path / "c3gs").symlink_to(ROOT)

    def run(*command: str) -> None:
        done = subprocess.run(command, cwd=page, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout + done.stderr

    (block,) = re.findall(r"```sh\n(npm .*?)```", manual.read_text(encoding="utf-8"), re.DOTALL)
    run("bash", "-euc", f"export npm_config_offline=true\n{block}")
    for package in modules.iterdir():
        if not package.name.startswith((".", "c3gs")):
            (page / "node_modules" / package.name).symlink_to(package)
    for word in WORDS:
        assert word == "GLTFLoader" or examples(word)[0].count("\n") <= 15
        (page / f"{word.rpartition('/')[2]}.ts").write_text(examples(word)[0])
    options = "--noEmit --strict --skipLibCheck --target es2022 --module esnext --moduleResolution bundler"
    files = [path.name for path in page.glob("*.ts")]
    run(str(NODE), "node_modules/typescript/bin/tsc", *options.split(), "--lib", "es2022,dom,dom.iterable", *files)
    (page / "index.html").write_text('<body style="margin: 0"></body><script type="module" src="page.js"></script>')
    (page / "page.js").write_text(examples(WORDS[0])[0] + _tail("0"))
    run(str(NODE), "node_modules/vite/bin/vite.js", "build")
    served = {"": (page / "dist" / "index.html").read_bytes(), "scene.c3gs": coded(found, path), "favicon.ico": b" "}
    (image,), _ = _shown({"assets": page / "dist" / "assets"}, served)
    assert _agreement(image, drawn(found, path[0])) > 45
