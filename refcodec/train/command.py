"""The work of `refcodec train`: progress, the saved state, the scene folder and training.json."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numba
import numpy as np
import torch

from ..bitstream.metadata import with_metadata
from ..bitstream.scene import Scene
from ..files.stage import write_file
from ..files.terminal import note
from ..folder.layout import REPORT_FILE
from ..folder.uncompressed import Uncompressed, write_uncompressed
from ..folder.write import write_folder
from ..photographs.photographs import PhotographSet
from .continued import continued_settings
from .estimate import estimate
from .fit_input import Given
from .log import Log, Logging
from .looks import psnr
from .losses import squared_error
from .messages import opening, shown
from .settings import TrainSettings
from .settings_file import document
from .stage import Stage
from .state import Keeper, ending, restore, write_somewhere
from .trainer import Trainer
from .views import show


@dataclass(frozen=True, eq=False)
class Trained:
    """A finished training. whole: whether it reached its last step. report: the document of training.json."""

    trainer: Trainer
    whole: bool
    report: dict[str, Any]


def state_path(output: Path) -> Path:
    """The path of the saved state: beside the scene folder, which is either complete or absent."""
    return output.with_name(output.name + ".train-state")


def train(
    photographs: PhotographSet,
    settings: TrainSettings,
    output: Path,
    *,
    threads: int | None = None,
    device: str = "cpu",
    resume: bool = False,
    progress: bool = False,
    keep_state: bool = False,
    log: Log | None = None,
    metadata: Mapping[str, str] | None = None,
    given: Given | None = None,
    up_axis: int | None = None,
    stages: Sequence[Stage] = (),
) -> Trained:
    """Trains, and writes the scene folder and training.json. Prints the opening line on stderr.

    threads: those of the rasteriser, None for all. The rest uses one, and no result depends on them. resume: from the
    saved state. progress: whether progress is printed in lines where there is no terminal. keep_state: whether the
    saved state stays after the end, for a training run with more steps. log: receives the history. metadata: entries of
    SPEC 6.14, for a coded scene. given: a scene to continue, None to begin with points. up_axis: SPEC 6.5, None for the
    axis of the photographs. stages: others than those of the method (stage.Stage).

    A state that cannot be saved does not end the training. A scene that cannot be written to `output` is written to
    the folder of temporary files, and the error names the path.

    Raises ValueError for photographs that do not suffice for training, and for a result that no file can hold.
    Raises StateError for a saved state that cannot be used, and OSError for a scene that cannot be written.
    """
    torch.set_num_threads(1)
    numba.set_num_threads(min(threads or numba.get_num_threads(), numba.get_num_threads()))
    if given is not None:
        settings = continued_settings(given, settings)
    trainer = Trainer(photographs, settings, device, given, stages)
    keep = Keeper(trainer, state_path(output))
    if resume:
        restore(trainer, keep.path)
    note(opening(trainer))
    logging = Logging(log, trainer.looks.history) if log else lambda rows: None
    with shown(trainer, progress, logging) as watch:
        whole = trainer.run(watch, keep)
    # result() begins the stages that have not begun, so training could not continue from a state saved after it.
    with ending(keep.path):
        result = trainer.result()
    if up_axis is not None:
        result = replace(result, render=replace(result.render, up_axis=up_axis))
    if metadata and isinstance(result, Scene):
        result = replace(result, ancillary=with_metadata(result.ancillary, metadata))
    summary = report(trainer, result)
    text = json.dumps(summary, indent=1) + "\n"

    def write(folder: Path) -> None:
        if isinstance(result, Uncompressed):
            write_uncompressed(result, folder)
        else:
            write_folder(result, folder)
        write_file(folder / REPORT_FILE, text.encode())

    write_somewhere(write, output, keep.path)
    if whole and not keep_state:
        keep.discard()
    return Trained(trainer, whole, summary)


def report(trainer: Trainer, result: Scene | Uncompressed) -> dict[str, Any]:
    """The document of training.json.

    bytes: those of each part, as estimated (uncompressed: exact); attributes are the sum of their kinds. quantised: the
    PSNR of each held-out photograph in 3DGS's convention, drawn by the training from the scene of integers. psnr: the
    mean of these, or of those of the uncompressed scene, None if no photograph is held out. schedule: where training
    was extended last, as schedule.Clock.
    """
    draw = partial(show, trainer.scaffold, trainer.drawing, result) if isinstance(result, Scene) else trainer.draw
    quantised = {
        p.camera.name: psnr(squared_error(draw(p.camera).double(), trainer.pixels(p).double()))
        for p in trainer.photographs.test
    }
    first = trainer.photographs.train[0].camera
    return {
        "settings": document(trainer.settings),
        "size": [first.width, first.height],
        "steps": trainer.clock.done,
        "seconds": round(trainer.looks.seconds, 2),
        "anchors": result.anchor_count,
        "quantised": quantised if isinstance(result, Scene) else {},
        "psnr": float(np.mean(list(quantised.values()))) if quantised else None,
        "schedule": {"first": trainer.clock.first, "base": trainer.clock.base},
        "unit": trainer.scaffold.units.length,
        "bytes": {name: round(value) for name, value in estimate(trainer).items()},
        "history": trainer.looks.history,
    }
