"""Decoding time of C3GS beside SPZ and L-GSC, for the same number of Gaussians, in one run.

python -m benchmarks.peers.speed --spz FOLDER [--lgsc FOLDER] [--write]

FOLDER is the source of the library: https://github.com/nianticlabs/spz, https://github.com/qualcomm/lite-3Dgsplat-codec.
They are compiled with `c++`, and need the headers of zlib and zstd (Debian: zlib1g-dev, libzstd-dev).

C3GS decodes a large scene (benchmarks.large), and the same as a static scene, which ends with Gaussians. The others
decode as many Gaussians: copies of the export of the trained scene.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from refcodec.bitstream.batches import no_progress
from refcodec.bitstream.codec import emit, parse
from refcodec.bitstream.dimensions import RENDER_MODELS, RENDERING, STATIC
from refcodec.bitstream.reconstruction import gaussians, reconstruct
from refcodec.bitstream.scene import Scene
from refcodec.bitstream.tables import tables
from refcodec.export.fit import fit
from refcodec.export.views import views_of
from refcodec.formats.splats import Splats, rows_of
from refcodec.formats.table import FORMATS, read_splats, write_splats
from refcodec.rendering.rasterise import draw, settings_of
from refcodec.rendering.view import View, stated_cameras

from ..contenders import NATIVE, ONE_THREAD
from ..large import KEPT, PAPER_ANCHORS, TRAINED, large
from ..results import facts, facts_line, table, write_section

DECODERS = Path(__file__).parent / "decoders"
DEGREE = 3
LGSC_PARTS = "Common", "Encoder", "Decoder"
# The arguments of the compiler: sources and options, in the folder of a library.
LIBRARIES = {
    "spz": ["-std=c++17", "-Isrc/cc", "src/cc/load-spz.cc", "src/cc/splat-types.cc", "-lzstd", "-lz", "-pthread"],
    "lgsc": ["-std=c++14", "-I.", "-Isource", *(f"source/LGSC{part}.cpp" for part in LGSC_PARTS), "-lz"],
}
NAMES = {"spz": "SPZ 4, Niantic's library", "lgsc": "L-GSC 1.0, Qualcomm's library"}
OWN, OWN_STATIC = "C3GS", "C3GS, static"


class LibraryError(Exception):
    """A library cannot be compiled or run. The message has the output of the program."""


def static_scene(scene: Scene) -> Scene:
    """Returns a static scene with the symbols of another scene, and random rendering networks."""
    d = replace(scene.dimensions, view_inputs=0, colour_outputs=RENDER_MODELS[STATIC][1][DEGREE])
    random, networks = np.random.default_rng(1), dict(scene.networks)
    for name in RENDERING:
        shapes = d.network_shapes()[name]
        layers = [(random.normal(0, 0.1, shape), random.normal(0, 0.1, shape[0])) for shape in shapes]
        networks[name] = [(weight.astype(np.float32), bias.astype(np.float32)) for weight, bias in layers]
    return replace(scene, dimensions=d, networks=networks, render=replace(scene.render, render_model=STATIC))


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
    found = rows_of(splats, rows)
    places = random.normal(0, 20 * splats.mean.std(axis=0), (copies, 3)).repeat(own, axis=0)[:count]
    return replace(found, mean=(found.mean + places).astype(np.float32))


def _ran(command: Sequence[str | Path], folder: Path | None = None) -> str:
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    if done.returncode:
        raise LibraryError(f"{' '.join(map(str, command))} failed: {(done.stderr or done.stdout).strip()[-500:]}")
    return done.stdout


def built(library: str, source: Path, folder: Path) -> Path:
    """Returns the program of a library, compiled from its source. Raises LibraryError."""
    program = folder / library
    _ran(["c++", "-O3", "-march=native", DECODERS / f"{library}.cc", *LIBRARIES[library], "-o", program], source)
    return program


def decoded(path: Path) -> dict[str, float]:
    """Decodes a file of C3GS twice. Returns the processor seconds of the second time, and the number of Gaussians."""
    tables()
    data, found = path.read_bytes(), dict[str, float]()
    for _ in range(2):
        start = time.process_time()
        scene = parse(data).scene
        found["symbols"] = time.process_time() - start
        values = reconstruct(scene)
        found["values"] = time.process_time() - start - found["symbols"]
        if scene.render.render_model == STATIC:
            gaussians(scene, values)
            found["Gaussians"] = time.process_time() - start - found["symbols"] - found["values"]
        found["seconds"], found["count"] = time.process_time() - start, int(scene.masks.sum())
    return found


def _own(path: Path) -> dict[str, float]:
    """Returns the result of `decoded` in a process with one thread."""
    environment = {**os.environ, **ONE_THREAD, "REFCODEC_PATH": NATIVE}
    command = [sys.executable, "-m", "benchmarks.peers.speed", "--decode", str(path)]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    return dict(json.loads(done.stdout))


def _others(program: Path, path: Path) -> dict[str, float]:
    count, seconds = _ran([program, path]).splitlines()[-1].split()
    return {"seconds": float(seconds), "count": int(count)}


def section(sources: dict[str, Path], anchors: int, rounds: int) -> list[str]:
    """Measures, in rounds in which each decoder runs once. Returns the lines of the section. Raises LibraryError."""
    machine = facts()
    scene = large(TRAINED, anchors, KEPT).path
    whole = parse(scene.read_bytes()).scene
    count = int(whole.masks.sum())
    splats, psnr = exported(TRAINED.read_bytes())
    own = write_splats(splats, ".spz")
    single = [_single("SPZ, `refcodec export`", len(own), len(splats.mean), psnr(FORMATS[".spz"].read(own)))]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        static = folder / "static.c3gs"
        static.write_bytes(emit(static_scene(whole)))
        files = {OWN: scene, OWN_STATIC: static}
        calls: dict[str, Any] = {OWN: lambda: _own(scene), OWN_STATIC: lambda: _own(static)}
        one, many, read = (folder / f"{size}.ply" for size in ("one", "many", "read"))
        one.write_bytes(write_splats(splats, ".ply"))
        many.write_bytes(write_splats(repeated(splats, count), ".ply"))
        for library, source in sources.items():
            program, title = built(library, source, folder), NAMES[library]
            files[title] = folder / f"many.{library}"
            _ran([program, many, files[title]])
            calls[title] = lambda program=program, path=files[title]: _others(program, path)
            coded = folder / f"one.{library}"
            _ran([program, one, coded])
            _ran([program, coded, read])
            found = psnr(read_splats(read))
            single.append(_single(title, coded.stat().st_size, len(splats.mean), found))
        runs: dict[str, list[dict[str, float]]] = {title: [] for title in calls}
        for _ in tqdm(range(rounds), leave=False):
            for title, call in calls.items():
                runs[title].append(call())
        sizes = {title: path.stat().st_size for title, path in files.items()}
    best = {title: min(own, key=lambda run: run["seconds"]) for title, own in runs.items()}
    if {run["count"] for run in best.values()} != {count}:
        raise LibraryError(f"the decoders found {best}, but there are {count} Gaussians")
    base = best[NAMES["spz"]]["seconds"]
    rows = []
    for title, run in best.items():
        times = [f"{run['seconds']:.3f}", f"{run['seconds'] / base:.2f}", f"{1e6 * run['seconds'] / count:.2f}"]
        rows.append([title, f"{sizes[title]:,}", f"{8 * sizes[title] / count:.1f}", *times])
    parts = best[OWN_STATIC]
    words = [f"--{library} {library.upper()}" for library in sources]
    return [
        f"`python -m benchmarks.peers.speed {' '.join(words)} --anchors {anchors} --rounds {rounds}`",
        "",
        facts_line(machine),
        f"{anchors:,} anchors, which keep {count:,} Gaussians. Processor seconds of the fastest of {rounds} rounds, in",
        "each of which all decoders ran once; C3GS has one thread. Files are in memory, and the time ends with float32",
        f"arrays: the values of the anchors, or Gaussians with harmonics of degree {DEGREE}.",
        "",
        *table(["decoder", "bytes", "bits of a Gaussian", "seconds", "times SPZ", "of a Gaussian, µs"], rows),
        "",
        f"C3GS has the symbols of `{TRAINED.name}`, as in `decode`. The static scene has random rendering networks.",
        f"Its parts are {parts['symbols']:.3f} s for symbols, {parts['values']:.3f} s for values, and"
        f" {parts['Gaussians']:.3f} s for Gaussians.",
        "The others have copies of the Gaussians that `refcodec export` fits to this scene, in random orders. A file",
        "of one copy, and the PSNR of its pictures relative to those of the Gaussians before quantisation:",
        "",
        *table(["file", "bytes", "bits of a Gaussian", "PSNR, dB"], single),
    ]


def _single(title: str, size: int, count: int, psnr: float) -> list[str]:
    return [title, f"{size:,}", f"{8 * size / count:.1f}", f"{psnr:.2f}"]


def main() -> None:
    """Runs the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--spz", type=Path, help="the source of SPZ")
    parser.add_argument("--lgsc", type=Path, help="the source of L-GSC")
    parser.add_argument("--anchors", type=int, default=PAPER_ANCHORS)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--write", action="store_true", help="write the section of benchmarks/RESULTS.md")
    parser.add_argument("--decode", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.decode:
        print(json.dumps(decoded(options.decode)))
        return
    if options.spz is None:
        parser.error("--spz is required")
    sources = {library: getattr(options, library) for library in LIBRARIES if getattr(options, library)}
    try:
        lines = section(sources, options.anchors, options.rounds)
    except (LibraryError, OSError) as error:
        sys.exit(str(error))
    print("\n".join(lines))
    if options.write:
        write_section("peers-speed", "Decoding time beside SPZ", lines)


if __name__ == "__main__":
    main()
