"""Quality and size of exported scenes.

python -m benchmarks exports --scene NAME FILE.c3gs PHOTOGRAPHS ... [--size 200] [--degree 3] [--write]

Each scene is exported to every format with harmonics of a degree, fitted to the cameras of its training. A static scene
is exported as it is, with its own degree. Every eighth photograph, or the data set's own tests, are held out.
"""

from argparse import Namespace
from pathlib import Path
from statistics import fmean

from refcodec.bitstream.batches import no_progress
from refcodec.bitstream.codec import parse
from refcodec.bitstream.dimensions import STATIC
from refcodec.evaluate.quality import measures
from refcodec.export.fit import agreement, fit, viewed
from refcodec.export.views import sized
from refcodec.formats.common import BITS, BITS_MOST, Options
from refcodec.formats.table import FORMATS, write_splats
from refcodec.photographs.photographs import read_photographs
from refcodec.rendering.gaussians import static_splats
from refcodec.rendering.rasterise import draw
from refcodec.rendering.view import View

from .results import Arguments, machine, table

SCENES = {"nargs": 3, "action": "append", "required": True, "metavar": ("NAME", "FILE", "PHOTOGRAPHS")}
OPTIONS: Arguments = {
    "--scene": SCENES,
    "--size": {"type": int, "default": 200, "help": "longest side of the photographs in pixels (200)"},
    "--degree": {"type": int, "choices": range(4), "default": 3, "help": "of the harmonics (3)"},
}
# As in refcodec export.
ITERATIONS = 10
# The measured formats, by suffix.
MEASURED = (".ply", ".spz", ".sog", ".glb")
HEAD = ["scene", "file", "degree", "Gaussians", "bytes", "times .c3gs", "PSNR to the scene, dB", "PSNR, dB", "SSIM"]
NOTE = (
    "One thread. Splats are drawn with the filter of viewers, 0.3 square pixels, scenes with their own. PSNR to the",
    "scene: of float renderings of both, from the cameras of held-out photographs. PSNR and SSIM: of eight-bit",
    "renderings and these photographs, by scikit-image. SPZ and SOG are decoded before rendering. bits: of the",
    "harmonics, by `export --spz-bits`.",
)


def exported(name: str, file: Path, folder: Path, size: int, degree: int) -> list[list[str]]:
    """Returns the rows of a scene. folder: of its photographs. size: their longest side in pixels.

    Raises BitstreamError, PhotographError and OSError.
    """
    scene = parse(file.read_bytes()).scene
    view, whole = View(scene), file.stat().st_size
    photographs = read_photographs(folder, size, view.info.background)
    cameras, tests = ([sized(p.camera) for p in part] for part in (photographs.train, photographs.test))
    static = scene.render.render_model == STATIC
    splats = static_splats(scene) if static else fit(view, cameras, degree, ITERATIONS, no_progress).splats
    settings = viewed(view.info)

    def row(label: str, own: str, gaussians: int, length: int, near: str, shown: list[dict[str, float]]) -> list[str]:
        figures = [f"{fmean(one['psnr'] for one in shown):.3f}", f"{fmean(one['ssim'] for one in shown):.4f}"]
        return [name, label, own, f"{gaussians:,}", f"{length:,}", f"{length / whole:.1f}", near, *figures]

    drawn = [measures(view.draw(p.camera), p.image) for p in photographs.test]
    rows = [row(".c3gs", "", int(view.masks.sum()), whole, "", drawn)]
    for suffix, bits in [(s, bits) for s in MEASURED for bits in ((BITS, BITS_MOST) if s == ".spz" else (BITS,))]:
        data = write_splats(splats, suffix, Options(view.up, spz_bits=bits))
        read = FORMATS[suffix].read(data)
        drawn = [measures(draw(read, p.camera, settings).image, p.image) for p in photographs.test]
        near = f"{agreement(view, read, tests, no_progress):.2f}"
        label = f"{suffix}, {bits} bits" if suffix == ".spz" else suffix
        rows.append(row(label, str(splats.degree), len(splats.mean), len(data), near, drawn))
    return rows


def section(options: Namespace) -> list[str]:
    """Returns the lines of the section. Raises BitstreamError, PhotographError and OSError."""
    rows = []
    for name, file, folder in options.scene:
        rows += exported(name, Path(file), Path(folder), options.size, options.degree)
    words_of = f"--scene NAME FILE.c3gs PHOTOGRAPHS ... --size {options.size} --degree {options.degree}"
    return [f"`python -m benchmarks exports {words_of}`", "", machine(), *NOTE, "", *table(HEAD, rows)]
