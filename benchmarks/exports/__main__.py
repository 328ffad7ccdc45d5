"""Quality and size of exported scenes, and third-party clients: a section of RESULTS.md.

python -m benchmarks.exports FOLDER --scene NAME FILE.c3gs PHOTOGRAPHS --scene ... [--clients] [--write]

Each scene is exported to every format with harmonics of each degree, fitted to the cameras of its training. A static
scene is exported as it is, with its own degree. FOLDER keeps files, figures and pictures for later runs. --clients also
tests the files with third-party programs: splat-transform, Khronos's glTF validator, three.js and Spark in Chromium. If
one is missing, it prints how to install it. --write writes the section.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np
from PIL import Image

from refcodec.evaluate.quality import measures
from refcodec.files.text import printable
from refcodec.rendering.rasterise import draw, settings_of
from refcodec.rendering.view import eight_bits
from refcodec.statuses import DONE, USAGE

from ..peers.convert import VERSION, ToolError
from ..results import machine, table, write_section
from .browser import drawn
from .clients import INSTALL, SPARK, THREE, VALIDATOR, difference, issues
from .making import MEASURED, Record, Source, file_of, held, kept, scene_record, splat_record

DEGREES = range(4)
# The formats that splat-transform reads.
READ = (".ply", ".spz", ".sog")
# The number of held-out photographs whose cameras the viewers use, at most.
PICTURES = 3


def client_record(source: Source, degree: int, folder: Path) -> Record:
    """Returns the results of third-party programs for the files of a degree. Raises ToolError.

    For each format: the largest difference of a number that splat-transform reads; the messages of the validator; the
    PSNR of a viewer's pictures relative to our rendering of the same Gaussians, and of the scene. Each saved picture
    has the scene, the Gaussians rendered by us, and by the viewer, from left to right.
    """

    def made() -> Record:
        view, cameras = source.view, source.tests[:PICTURES]
        settings, found = settings_of(view.info), {}
        scene = [view.draw(camera) for camera in cameras]
        for suffix in MEASURED:
            file, splats = file_of(source, degree, suffix, folder), held(source, degree, suffix, folder)
            own = [draw(splats, camera, settings).image for camera in cameras]
            shown = drawn(file, cameras, settings)
            beside = [
                np.concatenate([eight_bits(a), eight_bits(b), c], axis=1)
                for a, b, c in zip(scene, own, shown, strict=True)
            ]
            Image.fromarray(np.concatenate(beside)).save(folder / f"{file.name}.png")
            found[suffix] = {
                "same": _psnr(own, shown),
                "near": _psnr(scene, shown),
                **({"difference": difference(file, splats)} if suffix in READ else {}),
                **({"issues": issues(file)} if suffix == ".glb" else {}),
            }
        return found

    return kept(folder / f"{source.stem}-{degree}.clients.json", made)


def _psnr(wanted: list, shown: list) -> float:
    return float(np.mean([measures(a, b)["psnr"] for a, b in zip(wanted, shown, strict=True)]))


# --- the section ------------------------------------------------------------------------------------------------------


def _quality(source: Source, scene: Record, splats: dict[int, Record]) -> list[str]:
    head = ["file", "degree", "Gaussians", "bytes", "times .c3gs", "PSNR to the scene, dB", "PSNR, dB", "SSIM"]
    whole = scene["bytes"]
    rows = [
        [".c3gs", "", f"{scene['gaussians']:,}", f"{whole:,}", "1", "", f"{scene['psnr']:.3f}", f"{scene['ssim']:.4f}"]
    ]
    for name in next(iter(splats.values()))["files"]:
        for degree, record in splats.items():
            f = record["files"][name]
            rows.append(
                [
                    name,
                    str(degree),
                    f"{record['gaussians']:,}",
                    f"{f['bytes']:,}",
                    f"{f['bytes'] / whole:.1f}",
                    f"{f['near']:.2f}",
                    f"{f['psnr']:.3f}",
                    f"{f['ssim']:.4f}",
                ]
            )
    fitted = "no fit" if source.own else f"{scene['cameras']} cameras for fitting"
    said = f"{scene['anchors']:,} anchors, {fitted}, {scene['tests']} photographs held out."
    return [f"### {source.name}", "", said, "", *table(head, rows), ""]


def _clients(sources: list[Source], found: dict[str, dict[int, Record]]) -> list[str]:
    head = [
        "scene",
        "degree",
        *(f"{suffix}: {what}" for suffix in READ for what in ("difference", "picture, dB")),
        ".glb: messages",
        ".glb: picture, dB",
    ]
    rows = []
    for source in sources:
        for degree, record in found[source.name].items():
            cells = [
                cell
                for suffix in READ
                for cell in (f"{record[suffix]['difference']:.1e}", f"{record[suffix]['same']:.2f}")
            ]
            issues = record[".glb"]["issues"]
            rows.append(
                [
                    source.name,
                    str(degree),
                    *cells,
                    ", ".join(f"{code} {count}" for code, count in issues.items()) or "none",
                    f"{record['.glb']['same']:.2f}",
                ]
            )
    return ["### Third-party clients", "", *CLIENTS_NOTE, "", *table(head, rows), ""]


NOTE = (
    "The scenes are those of the experiment `quality` with lambda_r 0.004 and seed 0, and two static ones of this rate",
    "and seed, trained while the settings of static scenes were chosen. These need no fit.",
    "One thread. PSNR to the scene: of float renderings of the splat and of the scene, from the cameras of held-out",
    "photographs. PSNR and SSIM: of eight-bit renderings and these photographs, by scikit-image. SPZ and SOG are",
    "decoded before rendering. GLB has the Gaussians of PLY. bits: of the harmonics, by `export --spz-bits`.",
    "Degrees 0 to 2 of the first two scenes are in this section at commit 0d20a29.",
)
CLIENTS_NOTE = (
    f"difference: the largest difference between a number that splat-transform {VERSION} reads from the file and the",
    "expected one, relative to the number if that is above 1. The program takes the axes of SPZ files for those of PLY",
    "files, thus the expected y and z have the other signs. picture: the PSNR of a viewer's picture relative to our",
    f"rendering of the same Gaussians, over {PICTURES} cameras. The viewer of .ply, .spz and .sog is {SPARK}",
    f"in {THREE}. That of .glb is {THREE}'s own, which keeps colours and harmonics in eight bits, and cuts a",
    "Gaussian at two deviations. Both blend in eight bits, in Chromium, with software rendering. Both omit Gaussians",
    "whose centre is far outside the image.",
    f"messages: of {VALIDATOR}, except those about the extension and its names, which are unknown to it.",
)


def main(words: list[str] | None = None) -> int:
    """Runs the command line. Returns the exit status."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.exports", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("--scene", nargs=3, action="append", required=True, metavar=("NAME", "FILE", "PHOTOGRAPHS"))
    parser.add_argument("--size", type=int, default=200, help="longest side of the photographs in pixels (200)")
    parser.add_argument("--degrees", type=int, choices=DEGREES, nargs="+", default=list(DEGREES), metavar="D")
    parser.add_argument("--clients", action="store_true", help="test the files with third-party programs")
    parser.add_argument("--write", action="store_true", help="write the section of benchmarks/RESULTS.md")
    options = parser.parse_args(words)
    sources = [Source(name, Path(file), Path(photographs), options.size) for name, file, photographs in options.scene]
    lines, clients = [], {}
    try:
        options.folder.mkdir(parents=True, exist_ok=True)
        for source in sources:
            scene = scene_record(source, options.folder)
            degrees = [source.own.degree] if source.own else options.degrees
            splats = {degree: splat_record(source, degree, options.folder) for degree in degrees}
            lines += _quality(source, scene, splats)
            if options.clients:
                clients[source.name] = {d: client_record(source, d, options.folder) for d in degrees}
    except (ToolError, ValueError, OSError) as error:
        print(printable(str(error)), file=sys.stderr)
        return USAGE
    if clients:
        lines += _clients(sources, clients)
    print("\n".join(lines))
    if options.write:
        shown = ["python -m benchmarks.exports FOLDER", *(f"--scene {s.name} FILE.c3gs PHOTOGRAPHS" for s in sources)]
        given = f"--size {options.size} --degrees {' '.join(map(str, options.degrees))}{' --clients' * bool(clients)}"
        command = [" \\\n  ".join([*shown, f"{given} --write"])]
        tools = [INSTALL] if clients else []
        write_section("exports", "Exported scenes", ["```", *tools, *command, "```", "", machine(), *NOTE, "", *lines])
    return DONE


if __name__ == "__main__":
    sys.exit(main())
