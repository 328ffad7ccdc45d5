"""What other programs draw of exported scenes.

python -m benchmarks viewers --scene NAME FILE.c3gs PHOTOGRAPHS ... [--size 200] [--views 5] [--write]

Each scene is exported as `refcodec export` does by default, and Spark, PlayCanvas and three.js draw it in Chromium with
their own settings, from the cameras of held-out photographs, at half, once and twice the size. INSTALL gets them.
"""

import io
import json
import math
import tempfile
import threading
import time
from argparse import Namespace
from dataclasses import asdict, replace
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from statistics import fmean

import numpy as np
from PIL import Image

from refcodec import api
from refcodec.bitstream.codec import parse
from refcodec.evaluate.quality import measures
from refcodec.formats.table import read_splats
from refcodec.photographs.photographs import read_photographs
from refcodec.rendering.camera import named_camera
from refcodec.rendering.rasterise import draw, settings_of
from refcodec.rendering.view import View, eight_bits
from refcodec.statuses import UsageError
from tests.chromium import Chromium, find

from .exports import SCENES
from .results import Arguments, machine, table

OPTIONS: Arguments = {
    "--scene": SCENES,
    "--size": {"type": int, "default": 200, "help": "longest side of the photographs of the training (200)"},
    "--views": {"type": int, "default": 5, "help": "how many held-out photographs (5)"},
}
ROOT = Path(__file__).resolve().parents[1]
# In a folder that Git ignores.
FOLDER = ROOT / "build" / "viewers"
PACKAGES = ("three", "@sparkjsdev/spark", "playcanvas")
INSTALL = f"npm install --ignore-scripts --no-audit --prefix {FOLDER.relative_to(ROOT)} {' '.join(PACKAGES)}"
PROGRAMS = {"Spark": "spark", "PlayCanvas": "playcanvas", "three.js": "three"}
OWN = "refcodec render"
# Of the 3DGS code, in square pixels.
FILTER = 0.3
SIZES = (0.5, 1, 2)
HEAD = ["scene", "program", *(f"{size:g} x: {what}, dB" for size in SIZES for what in ("to the scene", "PSNR"))]
NOTE = (
    "One thread. Pictures have eight bits, and 0.5, 1 or 2 times the size of the training. To the scene: PSNR to what",
    "`refcodec render` draws of the .c3gs. PSNR: to held-out photographs of that size. 3DGS: our renderer with the",
    "filter of the 3DGS code, 0.3 square pixels. Others: with their defaults.",
)


class _Handler(SimpleHTTPRequestHandler):
    """Serves the page, the package, npm's packages and the files of an export."""

    def translate_path(self, path: str) -> str:
        _, first, *rest = path.split("/")
        places = {"modules": FOLDER / "node_modules", "c3gs": ROOT / "refcodec" / "web"}
        if first == "viewers.html":
            return str(Path(__file__).with_suffix(".html"))
        return str(places.get(first, Path(self.directory) / first).joinpath(*rest))

    def log_message(self, *_: object) -> None:
        """Logs nothing."""


def pictures(page: str, program: str, cameras: list[str], width: int, height: int, near: float) -> list[np.ndarray]:
    """Returns what a program shows, uint8 [height, width, 3] for each camera in JSON. Raises BrowserError."""
    images = []
    with Chromium(str(find()), width, height) as browser:
        browser.open(f"{page}#{program}")
        browser.until("globalThis.show !== undefined")
        for camera in cameras:
            browser.run(f"show({camera}, {near})")
            # Workers sort after the first frames.
            last: list[bytes] = []
            while len(last) < 4 or (len({*last[-4:]}) > 1 and len(last) < 40):
                time.sleep(0.4)
                last.append(browser.screenshot())
            images.append(np.asarray(Image.open(io.BytesIO(last[-1])).convert("RGB")))
    return images


def measured(name: str, file: Path, photographs: Path, size: int, views: int) -> list[list[str]]:
    """Returns the rows of a scene. size: of its training, longest side. views: how many held-out photographs.

    Raises BitstreamError, PhotographError, UsageError, OSError and BrowserError.
    """
    scene = parse(file.read_bytes()).scene
    view, info = View(scene), scene.render
    rows = {program: [name, program] for program in (OWN, "3DGS", *PROGRAMS)}
    with tempfile.TemporaryDirectory() as folder:
        paths = [Path(folder) / f"scene{suffix}" for suffix in (".ply", ".glb")]
        api.export(str(file), [*map(str, paths)])
        plain = partial(draw, read_splats(paths[0]), settings=replace(settings_of(info), low_pass=FILTER))
        with ThreadingHTTPServer(("127.0.0.1", 0), partial(_Handler, directory=folder)) as server:
            threading.Thread(target=server.serve_forever, daemon=True).start()
            for scale in SIZES:
                held = read_photographs(photographs, round(size * scale), info.background).test[:views]
                right = [eight_bits(view.draw(p.camera)) for p in held]
                drawn = {OWN: right, "3DGS": [eight_bits(plain(camera=p.camera).image) for p in held]}
                stated = [json.dumps(asdict(named_camera(p.camera, ""))) for p in held]
                page = f"http://127.0.0.1:{server.server_address[1]}/viewers.html"
                for program, word in PROGRAMS.items():
                    width, height = held[0].camera.width, held[0].camera.height
                    drawn[program] = pictures(page, word, stated, width, height, info.near_plane)
                for program, images in drawn.items():
                    for digits, wanted in ((1, right), (2, [p.image for p in held])):
                        pairs = zip(images, wanted, strict=True)
                        found = fmean(measures(a / 255, b)["psnr"] for a, b in pairs)
                        rows[program].append(f"{found:.{digits}f}" if found < math.inf else "")
            server.shutdown()
    return [*rows.values()]


def section(options: Namespace) -> list[str]:
    """Returns the lines of the section. Raises UsageError without the programs, and what `measured` raises."""
    if find() is None or not all((FOLDER / "node_modules" / package).is_dir() for package in PACKAGES):
        raise UsageError(f"this needs Chromium, and packages of npm: run `{INSTALL}` in the repository's folder")
    rows = []
    for name, file, folder in options.scene:
        rows += measured(name, Path(file), Path(folder), options.size, options.views)
    found = [json.loads((FOLDER / "node_modules" / p / "package.json").read_text())["version"] for p in PACKAGES]
    versions = ", ".join(f"{package} {version}" for package, version in zip(PACKAGES, found, strict=True))
    words_of = f"--scene NAME FILE.c3gs PHOTOGRAPHS ... --size {options.size} --views {options.views}"
    head = [f"`python -m benchmarks viewers {words_of}`", "", machine(), f"{versions}.", *NOTE, ""]
    return [*head, *table(HEAD, rows)]
