"""Decoding time of C3GS beside SPZ, for the same number of Gaussians, in one run.

python -m benchmarks peers-speed FOLDER [--write]

FOLDER is the source of Niantic's library, https://github.com/nianticlabs/spz. It is compiled with `c++`, and needs the
headers of zlib and zstd (Debian: zlib1g-dev, libzstd-dev).

C3GS decodes a large scene (benchmarks.large), and the same as a static scene, which ends with Gaussians. SPZ decodes as
many Gaussians: copies of the export of the trained scene.
"""

import tempfile
from argparse import Namespace
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from refcodec.bitstream.batches import no_progress
from refcodec.bitstream.codec import parse
from refcodec.export.fit import fit
from refcodec.export.views import views_of
from refcodec.files.terminal import bar_options
from refcodec.formats.splats import Splats, rows_of
from refcodec.formats.table import FORMATS, read_splats, write_splats
from refcodec.rendering.rasterise import draw, settings_of
from refcodec.rendering.view import View, stated_cameras

from ..decoders import decoding, in_turn
from ..large import PAPER_ANCHORS, TRAINED, large
from ..results import Arguments, machine, table
from .convert import ToolError, ran

OPTIONS: Arguments = {
    "source": {"type": Path, "help": "the source of SPZ"},
    "--anchors": {"type": int, "default": PAPER_ANCHORS},
    "--rounds": {"type": int, "default": 5},
}
DEGREE = 3
# The driver, and the sources and options of the library, in its folder.
DRIVER = Path(__file__).parent / "decoders" / "spz.cc"
LIBRARY = ["-std=c++17", "-Isrc/cc", "src/cc/load-spz.cc", "src/cc/splat-types.cc", "-lzstd", "-lz", "-pthread"]
OWN, OWN_STATIC, SPZ = "C3GS", "C3GS, static", "SPZ 4, Niantic's library"


def exported(trained: bytes) -> tuple[Splats, Callable[[Splats], float]]:
    """Returns the Gaussians of a scene, as `refcodec export` fits them without photographs, and a measure.

    The measure is the mean PSNR in dB of pictures of other Gaussians relative to those of these, in test views.
    """
    scene = parse(trained).scene
    view = View(scene)
    views, settings = views_of(view, stated_cameras(scene)), settings_of(view.info)
    splats = fit(view, views.fit, DEGREE, 1, no_progress).splats

    def pictures(shown: Splats) -> list[Any]:
        return [np.clip(draw(shown, camera, settings).image, 0, 1).astype(np.float64) for camera in views.test]

    right = pictures(splats)
    return splats, lambda other: float(
        np.mean([-10 * np.log10(np.mean((one - two) ** 2)) for one, two in zip(right, pictures(other), strict=True)])
    )


def repeated(splats: Splats, count: int) -> Splats:
    """Returns a number of Gaussians: copies in places of their own, in random orders.

    zstd does not find the copies: a Gaussian takes as many bits as in a file of one.
    """
    random = np.random.default_rng(2)
    own = len(splats.mean)
    copies = -(-count // own)
    rows = np.concatenate([random.permutation(own) for _ in range(copies)])[:count]
    more = rows_of(splats, rows)
    places = random.normal(0, 20 * splats.mean.std(axis=0), (copies, 3)).repeat(own, axis=0)[:count]
    return replace(more, mean=(more.mean + places).astype(np.float32))


def section(options: Namespace) -> list[str]:
    """Measures, in rounds in which each decoder runs once. Returns the lines of the section. Raises ToolError."""
    anchors, rounds = options.anchors, options.rounds
    facts, files = machine(), {OWN: large(anchors), OWN_STATIC: large(anchors, static=True)}
    count = int(parse(files[OWN].read_bytes()).scene.masks.sum())
    splats, psnr = exported(TRAINED.read_bytes())
    own = write_splats(splats, ".spz")
    with tempfile.TemporaryDirectory() as name:
        program, one, many, coded, read = (Path(name, end) for end in ("spz", "1.ply", "n.ply", "1.spz", "again.ply"))
        ran(["c++", "-O3", "-march=native", DRIVER, *LIBRARY, "-o", program], options.source)
        one.write_bytes(write_splats(splats, ".ply"))
        many.write_bytes(write_splats(repeated(splats, count), ".ply"))
        files[SPZ] = Path(name, "n.spz")
        for source_file, target in ((many, files[SPZ]), (one, coded), (coded, read)):
            ran([program, source_file, target])
        sizes = {title: path.stat().st_size for title, path in files.items()}
        files_of_one = {"SPZ, `refcodec export`": (len(own), FORMATS[".spz"].read(own))}
        files_of_one[SPZ] = coded.stat().st_size, read_splats(read)
        runs: list[dict[str, dict[str, Any]]] = []
        for _ in tqdm(range(rounds), unit="rounds", **bar_options()):
            ours = in_turn({title: decoding("whole", files[title]) for title in (OWN, OWN_STATIC)}, 1)
            number, seconds = ran([program, files[SPZ]]).split()[-2:]
            runs.append({title: run for title, [(_, run)] in ours.items()})
            runs[-1][SPZ] = {"processor": float(seconds), "count": int(number)}
    best = {title: min((run[title] for run in runs), key=lambda each: each["processor"]) for title in sizes}
    if {run["count"] for run in best.values()} != {count}:
        raise ToolError(f"the decoders found {best}, but there are {count} Gaussians")
    rows = []
    for title, run in best.items():
        seconds, size = run["processor"], sizes[title]
        times = [f"{seconds:.3f}", f"{seconds / best[SPZ]['processor']:.2f}", f"{1e6 * seconds / count:.2f}"]
        rows.append([title, f"{size:,}", f"{8 * size / count:.1f}", *times])
    single = [
        [title, f"{size:,}", f"{8 * size / len(splats.mean):.1f}", f"{psnr(shown):.2f}"]
        for title, (size, shown) in files_of_one.items()
    ]
    parts = ", ".join(f"{seconds:.3f} s for {part}" for part, seconds in best[OWN_STATIC]["parts"].items())
    return [
        f"`python -m benchmarks peers-speed SPZ --anchors {anchors} --rounds {rounds}`",
        "",
        facts,
        f"{anchors:,} anchors, which keep {count:,} Gaussians. Processor seconds of the fastest of {rounds} rounds, in",
        "each of which all decoders ran once; C3GS has one thread. Files are in memory, and the time ends with float32",
        f"arrays: the values of the anchors, or Gaussians with harmonics of degree {DEGREE}.",
        "",
        *table(["decoder", "bytes", "bits of a Gaussian", "seconds", "times SPZ", "of a Gaussian, µs"], rows),
        "",
        f"C3GS has the symbols of `{TRAINED.name}`.",
        f"The parts of the static scene are {parts}.",
        "SPZ has copies of the Gaussians that `refcodec export` fits to this scene, in random orders. A file of one",
        "copy, and the PSNR of its pictures relative to those of the Gaussians before quantisation:",
        "",
        *table(["file", "bytes", "bits of a Gaussian", "PSNR, dB"], single),
    ]
