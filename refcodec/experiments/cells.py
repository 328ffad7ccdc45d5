"""The cells of an experiment: one training run each, as a job, and its result."""

import hashlib
import json
from collections.abc import Iterator
from dataclasses import dataclass
from fnmatch import fnmatchcase
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta, Struct

from .. import __version__
from ..files.documents import DocumentError, checked, read_json
from ..files.stage import write_file
from ..folder.layout import REPORT_FILE
from ..train.settings import TrainSettings
from ..train.settings_file import document
from .jobs import Job, Step, dumped, has, read
from .plan import Experiment, Method, Scene

# Names in the folder of a cell: the outputs of its commands, their record, and the result.
WORK, RECORD, RESULT = "work", "steps.json", "result.json"
# They stand for paths in a definition, which does not depend on the places of files.
_PHOTOGRAPHS, _HERE = Path("PHOTOGRAPHS"), Path()

Count = Annotated[int, Meta(ge=0)]


class Measures(Struct):
    """The measures of `refcodec eval`, of an image or their mean."""

    psnr: float
    ssim: float
    psnr_3dgs: float
    ssim_3dgs: float


class Image(Measures):
    """The measures of an image, with its name."""

    image: str = ""


class Evaluation(Struct):
    """The used fields of the output of `refcodec eval --json`."""

    bytes: Count
    anchors: Count
    parts: dict[str, Count]
    mean: Measures
    images: list[Image]


class Look(Struct):
    """An entry of the history of a training."""

    seconds: float
    psnr: float


class Training(Struct):
    """The used fields of training.json."""

    steps: Count
    history: list[Look]


class Result(Evaluation):
    """The result of a cell. hash: of the definition. sha256: of the file. seconds, processor_seconds: by command."""

    format: Literal["C3GS cell"]
    hash: str
    definition: dict[str, Any]
    sha256: str | None
    seconds: dict[str, float]
    processor_seconds: dict[str, float]


def hash_of(definition: dict[str, Any]) -> str:
    """SHA-256 of a definition."""
    return hashlib.sha256(json.dumps(definition, sort_keys=True).encode()).hexdigest()


def read_result(folder: Path) -> Result | None:
    """The result in the folder of a cell, or None if it is missing or incomplete. Its hash is that of its definition.

    Raises RunError for something else in its place, and OSError for one that cannot be read.
    """
    try:
        result: Result | None = checked(read_json(folder / RESULT), Result) if has(folder / RESULT) else None
    except DocumentError:
        return None
    return result if result and result.hash == hash_of(result.definition) else None


def write_result(
    folder: Path,
    definition: dict[str, Any],
    shown: Evaluation,
    file: Path | None,
    job: Job,
    trained: float | None = None,
) -> None:
    """Writes the result of a job.

    file: that whose digest is in it. trained: processor seconds of the training, None for those of its command.
    """
    entries = job.entries()
    processor = {step.name: round(entries[step.name].processor_seconds, 2) for step in job.steps}
    result = Result(
        format="C3GS cell",
        hash=hash_of(definition),
        definition=definition,
        **msgspec.structs.asdict(shown),
        sha256=hashlib.sha256(file.read_bytes()).hexdigest() if file else None,
        seconds={step.name: round(entries[step.name].seconds, 2) for step in job.steps},
        processor_seconds=processor if trained is None else {"train": trained},
    )
    write_file(folder / RESULT, dumped(result))


@dataclass(frozen=True)
class Cell:
    """A scene, a method, a lambda_r and a seed. settings: all of its training. device: of `train --device`."""

    scene: Scene
    method: Method
    lambda_r: float
    seed: int
    settings: TrainSettings
    steps: int | None
    device: str

    @property
    def name(self) -> str:
        """Unique in an experiment; also its folder below `cells`."""
        return f"{self.scene.name}/{self.method.name}/lambda-{self.lambda_r:g}/seed-{self.seed}"

    def folder(self, root: Path) -> Path:
        """The cell's folder. root: the experiment's folder."""
        return root / "cells" / self.name

    def steps_of(self, work: Path, photographs: Path, threads: int) -> tuple[Step, ...]:
        """The commands that make its figures: train, encode, eval. work: the folder of their outputs.

        threads: of the training; no result depends on them.
        """
        scene, file, made = work / "scene", work / "scene.c3gs", work / "scene" / REPORT_FILE
        size = ("--size", self.settings.size)
        held = () if self.scene.holdout is None else ("--holdout", str(self.scene.holdout))
        words = ["--preset", self.method.preset, "--lambda", f"{self.lambda_r:g}", "--seed", str(self.seed)]
        words += [*size, *held]
        words += ["--steps", str(self.steps)] if self.steps else []
        words += ["--static"] if self.method.static else []
        words += ["--device", self.device] if self.device != "cpu" else []
        words += [f"--up={self.scene.up}"] if self.scene.up else []
        words += [word for change in (*self.scene.changes, *self.method.changes) for word in ("--set", change)]
        train = Step(
            ("train", str(photographs), "-o", str(scene), *words),
            made,
            state=work / "scene.train-state",
            free=("--threads", str(threads), "--progress"),
        )
        encode = Step(("encode", str(scene), "-o", str(file)), file, (made,))
        coded, shown = ((encode,), file) if self.lambda_r else ((), scene)
        measured = ("eval", str(shown), str(photographs), *size, *held, "--json")
        evaluate = Step(measured, work / "eval.json", (file if coded else made,), printed=True)
        return train, *coded, evaluate

    def definition(self, photographs: str) -> dict[str, Any]:
        """All inputs of its result. photographs: their digest."""
        return {
            "refcodec": __version__,
            "commands": [list(step.words) for step in self.steps_of(_HERE, _PHOTOGRAPHS, 1)],
            "settings": document(self.settings),
            "photographs": photographs,
        }

    def job(self, root: Path, photographs: Path, digest: str, threads: int) -> Job:
        """The job that makes its result. photographs: their folder, with their digest."""
        folder, definition = self.folder(root), self.definition(digest)
        steps = self.steps_of(folder / WORK, photographs, threads)
        depends = hash_of(definition)
        return Job(self.name, folder / RECORD, steps, depends, partial(_finish, folder, definition))


def _finish(folder: Path, definition: dict[str, Any], job: Job) -> None:
    file = folder / WORK / "scene.c3gs" if len(job.steps) > 2 else None
    write_result(folder, definition, read(job.steps[-1].output, Evaluation), file, job)


def result_of(cell: Cell, root: Path, photographs: str | None = None) -> Result | None:
    """The result of a cell that is done. photographs: their digest; None for whatever the result was made of.

    root: the experiment's folder. Errors are those of read_result.
    """
    result = read_result(cell.folder(root))
    if result is None:
        return None
    definition = cell.definition(photographs or str(result.definition.get("photographs")))
    return result if result.hash == hash_of(definition) else None


def cells(experiment: Experiment, patterns: tuple[str, ...] = ()) -> Iterator[Cell]:
    """The cells whose name matches one of the patterns (fnmatch), or all without patterns; seeds change first."""
    for scene in experiment.scenes:
        for method in experiment.methods_of(scene):
            for lambda_r in experiment.lambdas_of(scene, method):
                for seed in experiment.seeds:
                    settings = experiment.settings(scene, method, lambda_r, seed)
                    cell = Cell(scene, method, lambda_r, seed, settings, experiment.steps, experiment.device)
                    if not patterns or any(fnmatchcase(cell.name, pattern) for pattern in patterns):
                        yield cell
