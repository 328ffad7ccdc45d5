"""What a scene loses on the way out of refcodec and back: every format that is written and read.

python -m benchmarks.rounds FOLDER --scene NAME FILE.c3gs PHOTOGRAPHS [--steps 500] [--again .ply] [--write]

A scene is exported to a splat of each format, and to the folders that hold it as it is: Scaffold-GS, which convert
turns into the folder of an uncompressed scene, and the scene folder. Each is read back, and converted and encoded again
by the commands. Scenes are trained from splats in pictures of the cameras of the training. FOLDER keeps files and
figures. What is there is not made again. --write writes a section of RESULTS.md.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from refcodec.bitstream.batches import no_progress
from refcodec.bitstream.codec import parse
from refcodec.convert.splat_files import read_splats
from refcodec.evaluate.quality import measures
from refcodec.export.fit import agreement, render_settings
from refcodec.export.formats import FORMATS
from refcodec.export.splats import Splats, draw
from refcodec.render.camera import Camera
from refcodec.render.view import View
from refcodec.statuses import DONE

from .exports.making import Record, Source, file_of, held, kept, splat_record
from .results import machine, table, write_section
from .runs import refcodec

DEGREE, RATE = 3, "0.004"
SCAFFOLD, SCENE = "Scaffold-GS", "scene folder"


def shown(source: Source, image: Callable[[Camera], Any]) -> float:
    """The mean PSNR of the held-out photographs, in dB."""
    return float(np.mean([measures(image(p.camera), p.image)["psnr"] for p in source.set.test]))


def decibels(source: Source, first: Callable[[Camera], Any], second: Callable[[Camera], Any]) -> float | None:
    """The mean PSNR between two drawings from the cameras of these photographs; None if an image is equal."""
    found = []
    for camera in source.tests:
        error = float(np.mean((np.clip(first(camera), 0, 1).astype(np.float64) - np.clip(second(camera), 0, 1)) ** 2))
        if not error:
            return None
        found.append(-10 * math.log10(error))
    return float(np.mean(found))


def cameras_json(source: Source, file: Path) -> Path:
    """Writes the cameras of the training as 3DGS does. Returns the file."""
    listed = [
        {
            "id": number,
            "img_name": str(number),
            **{name: getattr(camera, name) for name in ("width", "height", "fx", "fy")},
            "position": camera.centre.tolist(),
            "rotation": camera.rotation.T.tolist(),
        }
        for number, camera in enumerate(source.fitted)
    ]
    file.write_text(json.dumps(listed))
    return file


def coded(source: Source, scene: Path, file: Path, *words: str) -> Record:
    """Encodes a folder. Returns bytes, PSNR of the photographs, and PSNR to the scene."""
    refcodec("encode", str(scene), "-o", str(file), *words)
    view = View(parse(file.read_bytes()).scene)
    again = {"shown": shown(source, view.draw), "near": decibels(source, view.draw, source.view.draw)}
    return {"bytes": file.stat().st_size, **again}


def splat_round(source: Source, suffix: str, folder: Path) -> Record:
    """A splat: its bytes, its PSNR to the scene, that of what is read to what the fit gave, and to the photographs."""

    def made() -> Record:
        splat_record(source, DEGREE, folder)
        file, settings = file_of(source, DEGREE, suffix, folder), render_settings(source.view)
        whole, found = (Splats(**read_splats(file.with_suffix(s))) for s in (".ply", suffix))

        def drawn(splats: Splats) -> Callable[[Camera], Any]:
            return lambda camera: draw(splats, camera, settings).image

        return {
            "bytes": file.stat().st_size,
            "near": agreement(source.view, held(source, DEGREE, suffix, folder), source.tests, no_progress),
            "back": decibels(source, drawn(found), drawn(whole)),
            "shown": shown(source, drawn(found)),
        }

    return kept(folder / f"{source.stem}{suffix}-round.json", made)


def trained_round(source: Source, suffix: str, steps: int, folder: Path) -> Record:
    """The scene that convert trains from a splat, coded. The splat is there (splat_round)."""
    file = file_of(source, DEGREE, suffix, folder)
    scene = folder / f"{file.name}-{steps}"

    def made() -> Record:
        words = ["--cameras", str(cameras_json(source, folder / f"{source.stem}-cameras.json"))]
        words += ["--views", str(len(source.fitted)), "--steps", str(steps), "--rate", RATE, "--size", str(source.size)]
        if not scene.exists():
            refcodec("convert", str(file), "-o", str(scene), *words)
        return coded(source, scene, folder / f"{scene.name}.c3gs")

    return kept(folder / f"{scene.name}-round.json", made)


def folder_round(source: Source, form: str, folder: Path) -> Record:
    """A folder that holds the scene as it is, and the file that encode makes of it."""

    def made() -> Record:
        scene, words = folder / f"{source.stem}-{form.replace(' ', '-')}", ["--rate", RATE]
        if form == SCENE:
            refcodec("decode", str(source.file), "-o", str(scene))
            words = []
        else:
            refcodec("export", str(source.file), "-o", str(scene), "--scaffold")
            refcodec("convert", str(scene), "-o", f"{scene}-converted")
            scene = Path(f"{scene}-converted")
        return {"coded": coded(source, scene, folder / f"{scene.name}.c3gs", *words)}

    return kept(folder / f"{source.stem}-{form.replace(' ', '-')}-round.json", made)


NOTE = (
    "PSNR in dB, from the cameras of the held-out photographs. out: of the exported splat to the scene. back: of what",
    "convert reads to the splat of the fit. photographs: against the held-out photographs. again: of the file that",
    f"convert and encode make of it at lambda_r {RATE}, its bytes, its PSNR to the scene and to the photographs.",
    f"Splats have degree {DEGREE}, and are fitted to the cameras of the training, which convert draws them from again.",
    "Folders hold the scene as it is. What encode loses of them is lost to new steps.",
)


def _number(value: float | None) -> str:
    return "equal" if value is None else f"{value:.2f}"


def _again(record: Record | None) -> list[str]:
    return [f"{record['bytes']:,}", _number(record["near"]), _number(record["shown"])] if record else [""] * 3


def section(source: Source, steps: int, again: list[str], folder: Path) -> list[str]:
    """The section's table. again: the formats of splats that are trained from."""
    own = shown(source, source.view.draw)
    head = ["format", "bytes", "out", "back", "photographs", "again, bytes", "again, scene", "again, photographs"]
    rows = [[".c3gs", f"{source.file.stat().st_size:,}", "", "", _number(own), "", "", ""]]
    for suffix in FORMATS:
        record = splat_round(source, suffix, folder)
        first = [f"{record['bytes']:,}", *(_number(record[key]) for key in ("near", "back", "shown"))]
        trained = trained_round(source, suffix, steps, folder) if suffix in again else None
        rows.append([suffix, *first, *_again(trained)])
    folders = {form: folder_round(source, form, folder)["coded"] for form in (SCAFFOLD, SCENE)}
    return table(head, [*rows, *([form, *[""] * 4, *_again(record)] for form, record in folders.items())])


def main(words: list[str] | None = None) -> int:
    """Command line. Returns the exit status."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.rounds", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("--scene", nargs=3, required=True, metavar=("NAME", "FILE", "PHOTOGRAPHS"))
    parser.add_argument("--size", type=int, default=200, help="longest side of the photographs in pixels (200)")
    parser.add_argument("--steps", type=int, default=500, help="of the trainings from splats (500)")
    parser.add_argument("--again", nargs="*", choices=FORMATS, default=list(FORMATS), help="splats to train from (all)")
    parser.add_argument("--write", action="store_true", help="write the section of benchmarks/RESULTS.md")
    options = parser.parse_args(words)
    name, file, photographs = options.scene
    source = Source(name, Path(file), Path(photographs), options.size)
    options.folder.mkdir(parents=True, exist_ok=True)
    lines = section(source, options.steps, options.again, options.folder)
    print("\n".join(lines))
    if options.write:
        command = f"python -m benchmarks.rounds FOLDER --scene {name} {file} {photographs} "
        command += f"--size {options.size} --steps {options.steps} --again {' '.join(options.again)} --write"
        write_section("rounds", "Out and back", ["```", command, "```", "", machine("torch"), *NOTE, "", *lines])
    return DONE


if __name__ == "__main__":
    sys.exit(main())
