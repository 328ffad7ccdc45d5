"""The cells of an experiment: one training run each, its commands, and the inputs of its result."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterator
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

from .. import __version__
from ..files.documents import DocumentError, read_json
from ..folder.layout import REPORT_FILE
from ..train.settings import TrainSettings
from ..train.settings_file import document
from .figures import FIGURES
from .plan import Experiment, Method, Scene
from .runs import Command, has

FORMAT = "C3GS cell"
# Names in a cell's folder: the outputs of its commands, their lines on stderr, and the result.
WORK, LOG, RESULT = "work", "log.txt", "result.json"
# They stand for paths in a definition, which does not depend on the places of files.
_PHOTOGRAPHS, _HERE = Path("PHOTOGRAPHS"), Path()


@dataclass(frozen=True)
class Cell:
    """A scene, a method, a rate and a seed. settings: all of its training. device: of `train --device`."""

    scene: Scene
    method: Method
    rate: float
    seed: int
    settings: TrainSettings
    steps: int | None
    device: str

    @property
    def name(self) -> str:
        """Unique in an experiment; also its folder below `cells`."""
        return f"{self.scene.name}/{self.method.name}/rate-{self.rate:g}/seed-{self.seed}"

    def folder(self, root: Path) -> Path:
        """The cell's folder. root: the experiment's folder."""
        return root / "cells" / self.name

    def commands(self, work: Path, photographs: Path, threads: int) -> tuple[Command, ...]:
        """The chain of commands that makes its figures: train, encode, eval. work: the folder of their outputs.

        threads: of the training; no result depends on them.
        """
        scene, file = work / "scene", work / "scene.c3gs"
        size = ("--size", self.settings.size)
        held = () if self.scene.holdout is None else ("--holdout", str(self.scene.holdout))
        over = () if self.scene.background is None else ("--background", self.scene.background)
        words = [
            "--preset",
            self.method.preset,
            "--lambda",
            f"{self.rate:g}",
            "--seed",
            str(self.seed),
            *size,
            *held,
            *over,
        ]
        words += ["--steps", str(self.steps)] if self.steps else []
        words += ["--static"] if self.method.static else []
        words += ["--device", self.device] if self.device != "cpu" else []
        words += [f"--up={self.scene.up}"] if self.scene.up else []
        words += [word for change in (*self.scene.changes, *self.method.changes) for word in ("--set", change)]
        train = Command(
            self.name,
            ("train", str(photographs), "-o", str(scene), *words),
            scene / REPORT_FILE,
            state=work / "scene.train-state",
            free=("--threads", str(threads), "--progress"),
        )
        encode = Command(self.name, ("encode", str(scene), "-o", str(file)), file, (train.name,))
        coded = (encode,) if self.rate else ()
        shown = ("eval", str(file if coded else scene), str(photographs), *size, *held, "--json")
        return (train, *coded, Command(self.name, shown, work / "eval.json", ((coded or (train,))[0].name,), True))

    def definition(self, photographs: str) -> dict[str, Any]:
        """All inputs of its result. photographs: their digest."""
        commands = self.commands(_HERE, _PHOTOGRAPHS, 1)
        return {
            "refcodec": __version__,
            "commands": [list(command.arguments) for command in commands],
            "settings": document(self.settings),
            "photographs": photographs,
        }


def cells(experiment: Experiment, patterns: tuple[str, ...] = ()) -> Iterator[Cell]:
    """The cells whose name matches one of the patterns (fnmatch), or all without patterns; seeds change first."""
    for scene in experiment.scenes:
        for method in experiment.methods_of(scene):
            for rate in experiment.rates_of(scene, method):
                for seed in experiment.seeds:
                    settings = experiment.settings(scene, method, rate, seed)
                    cell = Cell(scene, method, rate, seed, settings, experiment.steps, experiment.device)
                    if not patterns or any(fnmatchcase(cell.name, pattern) for pattern in patterns):
                        yield cell


# --- results ----------------------------------------------------------------------------------------------------------


def hash_of(definition: dict[str, Any]) -> str:
    """SHA-256 of a definition."""
    return hashlib.sha256(json.dumps(definition, sort_keys=True).encode()).hexdigest()


def read_result(folder: Path) -> dict[str, Any] | None:
    """The result in a cell's folder, or None if it is missing or incomplete.

    Its hash is that of the definition in it. Raises RunError for something else in its place, and OSError for one that
    cannot be read.

    `bytes`, `anchors`, `parts` (bytes by section) and `mean` are those of `eval --json`, `sha256` is of the file, None
    for an uncompressed scene, and `seconds` and `processor_seconds` are by command.
    """
    try:
        if not has(folder / RESULT):
            return None
        found = read_json(folder / RESULT)
    except DocumentError:
        return None
    try:
        whole = (
            found["format"] == FORMAT
            and found["hash"] == hash_of(found["definition"])
            and isinstance(found["definition"]["photographs"], str)
            and all(_is_count(found[key]) for key in ("bytes", "anchors"))
            and all(_is_count(value) for value in found["parts"].values())
            and all(_is_number(found["mean"][key]) for key in FIGURES)
            and all(_is_number(found[key]["train"]) for key in ("seconds", "processor_seconds"))
            and (found["sha256"] is None or isinstance(found["sha256"], str))
        )
    except (KeyError, TypeError, AttributeError):
        return None
    return dict(found) if whole else None


def _is_count(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and value >= 0


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
