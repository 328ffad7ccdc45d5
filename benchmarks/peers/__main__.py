"""Peers in one harness: plain 3DGS, as SPZ and SOG, beside the cells of an experiment.

python -m benchmarks.peers run PLAN -o FOLDER --caps 32000    trains 3DGS for each scene and seed of PLAN
python -m benchmarks.peers table FOLDER                       one table, and curves with --write, of a folder's cells
python -m benchmarks.peers scene SPLAT.ply -o FOLDER          renders photographs of a splat, in NeRF's format

PLAN is the file of an experiment, and FOLDER the folder of `refcodec experiment PLAN -o FOLDER`, which trains C3GS. A
finished training is not repeated. splat-transform writes SPZ and SOG; `run` prints the command that installs it.
"""

import argparse
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from statistics import fmean
from typing import Any

import msgspec
import numba
import torch

from refcodec import __version__
from refcodec.convert.drawing import drawn, tensors
from refcodec.convert.views import AXES, orbit, write_photographs
from refcodec.evaluate.quality import measures
from refcodec.experiments.cells import WORK, Evaluation, hash_of, read_result, write_result
from refcodec.experiments.command import FORMAT, MARK
from refcodec.experiments.jobs import Job, Step, Watch, claim, dumped, read, run_jobs
from refcodec.experiments.plan import read_experiment
from refcodec.experiments.tables import Row, grouped, row, spread_text, table, write_curves
from refcodec.files.lock import hold_folder
from refcodec.files.text import printable
from refcodec.formats.splats import Splats
from refcodec.formats.table import read_splats, write_splats
from refcodec.photographs.photographs import PhotographSet, parse_size, read_photographs
from refcodec.statuses import DONE, INTERRUPTED, USAGE

from ..results import ROOT, bytes_at, kb, machine, publish
from .convert import FORMATS, INSTALL, VERSION, ToolError, there_and_back, tool
from .trainer import SplatSettings, SplatTrainer, view_settings

# The names of methods in the table by those of cells, and the method to compare with.
LABELS = {"pro": "C3GS", "static": "C3GS, static", "uncompressed": "Scaffold-GS"}
LABELS |= {f"3dgs-{kind}": f"3DGS, {kind.upper()}" for kind in FORMATS}
BASELINE = LABELS["3dgs-spz"]
# The least number of seeds of a result.
SEEDS = 3
NOTE = (
    "One thread each. Every eighth image is held out, or the 25 of playbot's own split. PSNR and SSIM are those of",
    "eight-bit images, by scikit-image. SPZ 4 and SOG 2 are decoded before rendering. Bytes are those of the file,",
    "processor seconds those of the training. A spread is the standard deviation of the seeds. All methods draw with a",
    "low-pass filter of 0.1 square pixels.",
    "playbot is rendered from a splat of 31,000 Gaussians, PLAYBOT by Stephane Agullo (https://sa3d.fr), CC-BY-4.0, by",
    "`python -m benchmarks.peers scene playbot_lod3.ply -o playbot`.",
    f"splat-transform {VERSION} wrote SPZ and SOG.",
)


# --- trainings --------------------------------------------------------------------------------------------------------


def train(photographs: Path, folder: Path, settings: SplatSettings) -> dict[str, Any]:
    """Trains a plain 3DGS, and writes PLY, SPZ and SOG. Returns an Evaluation of each, and the processor seconds.

    Raises ToolError, and ValueError for unusable photographs.
    """
    torch.set_num_threads(1)
    numba.set_num_threads(1)
    views = read_photographs(photographs, parse_size(settings.size))
    trainer, ply = SplatTrainer(views, settings), folder / "splat.ply"
    splats = trainer.run()
    folder.mkdir(parents=True, exist_ok=True)
    ply.write_bytes(write_splats(Splats(**{name: value.numpy() for name, value in splats.items()}), ".ply"))
    files = {"ply": (ply, ply), **{suffix: there_and_back(ply, suffix) for suffix in FORMATS}}
    shown = {kind: quality(coded, again, views) for kind, (coded, again) in files.items()}
    return {"files": shown, "seconds": trainer.seconds}


@torch.no_grad()
def quality(file: Path, ply: Path, photographs: PhotographSet) -> Evaluation:
    """Returns the bytes of a file, and the quality of its Gaussians, which are in `ply`, on held-out photographs."""
    splats, view = tensors(read_splats(ply)), view_settings(photographs)
    images: list[dict[str, Any]] = [
        {"image": p.camera.name, **measures(drawn(splats, p.camera, view)[0].numpy(), p.image)}
        for p in photographs.test
    ]
    mean = {name: fmean(image[name] for image in images) for name in images[0] if name != "image"}
    shown = {"bytes": file.stat().st_size, "anchors": len(splats["mean"]), "parts": {}, "mean": mean, "images": images}
    return msgspec.convert(shown, Evaluation)


class _Trained(msgspec.Struct):
    files: dict[str, Evaluation]
    seconds: float


def job(root: Path, scene: str, photographs: Path, settings: SplatSettings) -> Job:
    """Returns the job of a training, whose results are cells of the folder `root`."""
    cell = f"{scene}/3dgs-KIND/cap-{settings.most}/seed-{settings.seed}"
    work = root / "cells" / cell.replace("KIND", "ply") / WORK
    options = [word for name, value in asdict(settings).items() for word in (f"--{name}", str(value))]
    words = ("train", str(photographs), "-o", str(work), *options)
    step = Step(words, work / "eval.json", printed=True, module="benchmarks.peers")
    definition = {"refcodec": __version__, "splat-transform": VERSION, "settings": asdict(settings)}
    finish = partial(_finish, root / "cells" / cell, definition)
    return Job(cell, work.parent / "steps.json", (step,), hash_of(definition), finish)


def _finish(folder: Path, definition: dict[str, Any], job: Job) -> None:
    trained = read(job.steps[0].output, _Trained)
    for kind, shown in trained.files.items():
        write_result(Path(str(folder).replace("KIND", kind)), definition, shown, None, job, trained.seconds)


def run(plan: Path, folder: Path, caps: Sequence[int], jobs: int) -> int:
    """Trains 3DGS for each scene and seed of a plan. Returns the exit status."""
    if tool() is None:
        raise ToolError(f"splat-transform is missing: run `{INSTALL}` in the repository's folder")
    experiment, root = read_experiment(plan), folder.absolute()
    claim(root, MARK, FORMAT)
    wanted = []
    for scene in experiment.scenes:
        settings = experiment.settings(scene, experiment.methods_of(scene)[0], 0.01, 0)
        for cap in caps:
            for seed in experiment.seeds:
                own = SplatSettings(cap, settings.steps, settings.size, seed)
                wanted.append(job(root, scene.name, experiment.photographs(scene), own))
    with hold_folder(root):
        outcomes, stopped = run_jobs(wanted, jobs, watch=Watch(len(wanted), 0))
    for outcome in outcomes:
        if outcome.status not in (DONE, INTERRUPTED):
            print(outcome.name, outcome.text, sep=": ", file=sys.stderr)
    return INTERRUPTED if stopped else max(outcome.status for outcome in outcomes)


# --- the table --------------------------------------------------------------------------------------------------------


def rows(folder: Path) -> Iterator[Row]:
    """Yields the rows of a folder's results but PLY, with the size of the photographs. lambda_r: that, or the cap."""
    for path in sorted(folder.glob("cells/*/*/*/seed-*/result.json")):
        if "3dgs-ply" not in path.parts and (result := read_result(path.parent)):
            scene, method, strength, seed = path.parent.parts[-4:]
            label, settings = LABELS.get(method, f"C3GS, {method}"), result.definition["settings"]
            made = row(scene, label, float(strength.partition("-")[2]), int(seed.partition("-")[2]), result)
            yield made | {"size": settings["size"]}


def report(results: Sequence[Row]) -> list[str]:
    """Returns the lines of two tables: figures, and sizes at the PSNR of BASELINE."""
    body, curves = [], dict[tuple[str, str], list[tuple[float, float]]]()
    for (scene, label, strength), several in sorted(grouped(results, "scene", "method", "lambda_r").items()):
        figures = {name: [one[name] for one in several] for name in ("bytes", "psnr", "ssim", "processor_seconds")}
        cells = [spread_text(values, digits) for values, digits in zip(figures.values(), (0, 2, 4, 0), strict=True)]
        body.append([scene, label, f"{strength:g}", str(len(several)), *cells])
        curves.setdefault((scene, label), []).append((fmean(figures["bytes"]), fmean(figures["psnr"])))
    equal, others = [], sorted({label for _, label in curves} - {BASELINE})
    for scene in sorted({scene for scene, _ in curves}):
        for own, psnr in sorted(curves.get((scene, BASELINE), [])):
            # A single point has no curve to read from.
            lines = [sorted(curves.get((scene, label), [])) for label in others]
            sizes = [bytes_at(line, psnr) if len(line) > 1 else None for line in lines]
            if any(sizes):
                equal.append([scene, f"{psnr:.2f}", kb(own), *(kb(size) if size else "-" for size in sizes)])
    head = ["scene", "method", "cap or lambda_r", "seeds", "bytes", "PSNR, dB", "SSIM", "processor, s"]
    words = f"KB at the PSNR of {BASELINE}, by linear interpolation of the logarithm of the bytes:"
    return [*table(head, body), "", words, "", *table(["scene", "PSNR, dB", BASELINE, *others], equal)]


def tables(folders: Sequence[Path], seeds: int, write: bool) -> int:
    """Prints a section of RESULTS.md for each size, of points with `seeds` or more; `write` writes them and curves."""
    points = grouped([one for folder in folders for one in rows(folder)], "size", "scene", "method", "lambda_r")
    results = [one for several in points.values() if len(several) >= seeds for one in several]
    for (size,), shown in sorted(grouped(results, "size").items()):
        lines = report(shown)
        head = ["`python -m benchmarks.peers table FOLDER --write`", "", machine("torch"), *NOTE, ""]
        publish(f"peers-{size}", f"Peers in one harness, {size} pixels", [*head, *lines], write)
        if write:
            write_curves(ROOT / "docs" / "pictures" / f"peers-{size}", shown, ("svg",))
    return DONE


def scene(splat: Path, folder: Path, size: int) -> int:
    """Renders 100 photographs and 25 tests of a splat whose up is -y, by the cameras of refcodec convert, no points."""
    splats = read_splats(splat)
    write_photographs(splats, orbit(splats, AXES["-y"], size, 100, 25), folder, lambda *_: None, points=False)
    return DONE


def main(words: list[str] | None = None) -> int:
    """Runs one command. Returns its exit status."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.peers", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    commands = parser.add_subparsers(dest="command", required=True)
    running = commands.add_parser("run", help="trains 3DGS for each scene and seed of a plan")
    running.add_argument("plan", type=Path)
    running.add_argument("-o", "--output", type=Path, required=True)
    running.add_argument("--caps", type=int, nargs="+", required=True, help="largest numbers of Gaussians")
    running.add_argument("--jobs", type=int, default=2, help="training runs at a time (2)")
    training = commands.add_parser("train", help="one training, as JSON")
    training.add_argument("photographs", type=Path)
    training.add_argument("-o", "--output", type=Path, required=True)
    for name, kind in SplatSettings.__annotations__.items():
        training.add_argument(f"--{name}", type=kind, required=True)
    rendering = commands.add_parser("scene", help="photographs of a splat, with its licence")
    rendering.add_argument("splat", type=Path)
    rendering.add_argument("-o", "--output", type=Path, required=True)
    rendering.add_argument("--size", type=int, default=400, help="sides in pixels (400)")
    listing = commands.add_parser("table", help="the tables of all cells in folders")
    listing.add_argument("folders", type=Path, nargs="+")
    listing.add_argument("--seeds", type=int, default=SEEDS, help=f"fewest seeds of a row ({SEEDS})")
    listing.add_argument("--write", action="store_true", help="write the sections of benchmarks/RESULTS.md")
    given = parser.parse_args(words)
    try:
        if given.command == "run":
            return run(given.plan, given.output, given.caps, given.jobs)
        if given.command == "scene":
            return scene(given.splat, given.output, given.size)
        if given.command == "table":
            return tables(given.folders, given.seeds, given.write)
        settings = SplatSettings(*(getattr(given, name) for name in SplatSettings.__annotations__))
        print(dumped(train(given.photographs, given.output, settings)).decode())
        return DONE
    except (ValueError, OSError) as error:
        print(printable(str(error), lines=True), file=sys.stderr)
        return USAGE


if __name__ == "__main__":
    sys.exit(main())
