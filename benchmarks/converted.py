"""Splat files converted to C3GS, compared with SPZ and SOG of the same file: a section of RESULTS.md.

python -m benchmarks.converted FOLDER SPLATS ... --up=-y [--lambdas 0.001 0.004 0.015] [--fast 35 40 46 52] [--write]

`refcodec convert` trains a scene from views of each file of SPLATS, and the scene is encoded. `refcodec convert --fast`
codes the Gaussians themselves. refcodec and splat-transform write SPZ and SOG. Test cameras compare renderings of all
files with those of SPLATS. FOLDER keeps the files: finished commands are not repeated, interrupted trainings go on.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from functools import cached_property
from pathlib import Path
from statistics import fmean

import numpy as np
from numpy.typing import NDArray

from refcodec.bitstream.codec import parse
from refcodec.convert.drawing import drawn, tensors
from refcodec.convert.views import AXES, NEAR, NEAR_MAX, TEST, TEST_EVERY, middle_and_radius, orbit
from refcodec.evaluate.quality import measures
from refcodec.experiments.jobs import Job, RunError, Step, Watch, run_jobs
from refcodec.files.text import printable
from refcodec.formats.common import Options
from refcodec.formats.splats import Splats
from refcodec.formats.table import read_splats, write_splats
from refcodec.rendering.camera import Camera, axis_direction
from refcodec.rendering.rasterise import Settings
from refcodec.rendering.view import View, eight_bits
from refcodec.statuses import DONE, INTERRUPTED, USAGE, UsageError

from .peers.convert import INSTALL, VERSION, ToolError, convert, tool
from .results import machine, publish, table

OWN, TOOL = "refcodec", f"splat-transform {VERSION}"
FORMATS = (".spz", ".sog")
HEAD = ["of", "file", "by", "bytes", "of the splat file", "PSNR, dB", "SSIM", "", "processor, s"]
NOTE = (
    "Test cameras compare the eight-bit renderings of all files with those of the splat file, by scikit-image. SPZ and",
    "SOG are read by the program that wrote them, and rendered as plain 3DGS. One thread each.",
)


class SplatFile:
    """A splat file, and the pictures of its test cameras, which are those of refcodec convert.

    up: its upward axis, of AXES. views: training pictures. size: their sides in pixels.
    """

    def __init__(self, file: Path, up: str, views: int, size: int) -> None:
        """Raises ValueError and OSError."""
        self.file, self.splats = file, read_splats(file)
        self.name = file.name.removesuffix(file.suffix).removesuffix(".compressed")
        self.options = ("--views", str(views), f"--up={up}", "--size", str(size))
        self.cameras = orbit(self.splats, AXES[up], size, views, max(views // TEST_EVERY, 1))[TEST]
        self.settings = Settings(near_plane=min(NEAR * middle_and_radius(self.splats)[1], NEAR_MAX))

    def image(self, splats: Splats, camera: Camera) -> NDArray[np.float32]:
        """Returns a picture of Gaussians by a camera."""
        picture: NDArray[np.float32] = drawn(tensors(splats), camera, self.settings)[0].numpy()
        return picture

    @cached_property
    def truth(self) -> list[NDArray[np.uint8]]:
        """The test pictures of the file itself."""
        return [eight_bits(self.image(self.splats, camera)) for camera in self.cameras]

    def row(
        self, label: str, by: str, file: Path, image: Callable[[Camera], NDArray[np.float32]], *more: str
    ) -> list[str]:
        rows = [measures(image(camera), right) for camera, right in zip(self.cameras, self.truth, strict=True)]
        size = file.stat().st_size
        figures = [f"{fmean(row['psnr'] for row in rows):.2f}", f"{fmean(row['ssim'] for row in rows):.4f}"]
        return [
            self.name,
            label,
            by,
            f"{size:,}",
            f"{size / self.file.stat().st_size:.3f}",
            *figures,
            *(more or ("", "")),
        ]

    def packed(self, suffix: str, maker: str, folder: Path) -> list[str]:
        """Returns the row of SPZ or SOG, written and read by its maker. Raises ToolError."""
        file = folder / f"{self.name}-{maker.partition(' ')[0]}{suffix}"
        again = file.with_name(f"{file.name}.ply")
        if maker == OWN:
            file.write_bytes(write_splats(self.splats, suffix, Options(axis_direction(0))))
        else:
            convert(self.file, file)
            convert(file, again)
        splats = read_splats(file if maker == OWN else again)
        return self.row(suffix, maker, file, lambda camera: self.image(splats, camera))

    def jobs(self, lambdas: Sequence[float], qualities: Sequence[float], steps: int, folder: Path) -> dict[str, Job]:
        """Returns the jobs that make the files of C3GS, by their words in the table. The last step makes the file."""
        made: dict[str, Job] = {}

        def convert_to(place: Path, output: Path, *words: str) -> Step:
            words = ("convert", str(self.file), "-o", str(place), *words)
            state = place.with_name(f"{place.name}.train-state") if place != output else None
            return Step(words, output, (self.file,), state=state)

        for psnr in qualities:
            file = folder / f"{self.name}-fast-{psnr:g}.c3gs"
            step = convert_to(file, file, "--fast", "--psnr", f"{psnr:g}", self.options[2])
            made[f"--fast --psnr {psnr:g}"] = Job(file.stem, file.with_suffix(".json"), (step,))
        for value in lambdas:
            scene, file = folder / f"{self.name}-{value:g}", folder / f"{self.name}-{value:g}.c3gs"
            report, more = scene / "training.json", ("--steps", str(steps), "--lambda", f"{value:g}")
            train = convert_to(scene, report, *self.options, *more)
            encode = Step(("encode", str(scene), "-o", str(file)), file, (report,))
            made[f"lambda_r {value:g}"] = Job(scene.name, Path(f"{scene}.json"), (train, encode))
        return made


def section(sources: Sequence[SplatFile], options: argparse.Namespace) -> list[str]:
    """Returns the lines of the section. Raises ToolError, UsageError, RunError, ValueError and OSError."""
    if tool() is None:
        raise ToolError(f"splat-transform is missing: run `{INSTALL}` in the repository's folder")
    folder, rows = options.folder.absolute(), list[list[str]]()
    folder.mkdir(parents=True, exist_ok=True)
    if folder in [source.file.absolute().parent for source in sources]:
        raise ToolError(f"{folder} has a splat file: choose another folder for the results")
    for source in sources:
        jobs = source.jobs(options.lambdas, options.fast, options.steps, folder)
        outcomes, stopped = run_jobs([*jobs.values()], options.jobs, watch=Watch(len(jobs), 0))
        for outcome in outcomes:
            if outcome.status != DONE:
                raise RunError(outcome.text, outcome.status)
        if stopped:
            raise RunError("stopped; the same command continues", INTERRUPTED)
        own = source.file.stat().st_size
        gaussians = f"{len(source.splats.mean):,} Gaussians"
        rows.append([source.name, source.file.suffix, "", f"{own:,}", "1", "", "", gaussians, ""])
        rows += [source.packed(suffix, maker, folder) for suffix in FORMATS for maker in (OWN, TOOL)]
        for by, job in jobs.items():
            view = View(parse(job.steps[-1].output.read_bytes()).scene)
            spent = f"{job.entries()['convert'].processor_seconds:.0f}"
            anchors = f"{len(view.masks):,} anchors"
            rows.append(source.row(".c3gs", by, job.steps[-1].output, view.draw, anchors, spent))
    return table(HEAD, rows)


def main(words: list[str] | None = None) -> int:
    """Runs the command line. Returns the exit status."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.converted", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("splats", type=Path, nargs="+")
    parser.add_argument("--up", choices=AXES, default="-y", help="axis that is up (-y); write --up=-y")
    for name, default, text in (("views", 200, "training pictures"), ("size", 400, "their sides"), ("steps", 4000, "")):
        parser.add_argument(f"--{name}", type=int, default=default, help=f"{text} ({default})")
    parser.add_argument("--jobs", type=int, default=2, help="training runs at a time (2)")
    parser.add_argument("--fast", type=float, nargs="*", default=[35, 40, 46, 52], metavar="DB", help="qualities, dB")
    parser.add_argument("--lambdas", type=float, nargs="*", default=[0.001, 0.004, 0.015], metavar="L", help="lambda_r")
    parser.add_argument("--write", action="store_true", help="write the section of benchmarks/RESULTS.md")
    options = parser.parse_args(words)
    try:
        sources = [SplatFile(file, options.up, options.views, options.size) for file in options.splats]
        lines = section(sources, options)
    except (ToolError, UsageError, ValueError, OSError) as error:
        print(printable(str(error), lines=True), file=sys.stderr)
        return USAGE
    files = " ".join(source.file.name for source in sources)
    command = f"`python -m benchmarks.converted FOLDER {files} --up={options.up}`"
    made = [command, "", machine("torch"), *NOTE, "", *lines]
    return publish("converted", "Converted splat files", made, options.write)


if __name__ == "__main__":
    sys.exit(main())
