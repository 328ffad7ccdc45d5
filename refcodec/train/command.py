"""What `refcodec train` does: progress, the saved state, and what it leaves behind."""

from __future__ import annotations

import contextlib
import json
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numba
import numpy as np
import torch

from ..bitstream.attributes import KINDS
from ..bitstream.scene import Scene
from ..files.stage import write_file
from ..files.terminal import ProgressStream, note
from ..folder.uncompressed import Uncompressed, write_uncompressed
from ..folder.write import write_folder
from ..photographs.photographs import PhotographSet
from .looks import psnr
from .settings import TrainSettings
from .settings_file import document
from .state import Keeper, restore, write_somewhere
from .trainer import Trainer, Watch

REPORT_FILE = "training.json"
# Seconds between two lines of progress where there is no terminal.
LINE_SECONDS = 5.0


def state_path(output: Path) -> Path:
    """Where a training saves itself: beside the folder, which is whole or not there."""
    return output.with_name(output.name + ".train-state")


def train(
    photographs: PhotographSet,
    settings: TrainSettings,
    output: Path,
    *,
    threads: int,
    device: str,
    resume: bool,
    progress: bool,
) -> tuple[Trainer, bool]:
    """Trains, and writes the scene folder and training.json. Returns the training, and whether it came to its end.

    threads: of the rasteriser; all else uses one, so that no result depends on it. resume: from the saved state.
    progress: whether lines tell of it where there is no terminal.

    A state that cannot be saved does not end the training. A scene that cannot be written to `output` is written among
    the temporary files, and the error says where.

    Raises ValueError for photographs that cannot be learnt from, and for what has been learnt but has no file.
    Raises StateError for a saved state that cannot be used, and OSError for a scene that cannot be written.
    """
    torch.set_num_threads(1)
    numba.set_num_threads(min(threads, numba.get_num_threads()))
    trainer = Trainer(photographs, settings, device)
    keep = Keeper(trainer, state_path(output))
    if resume:
        restore(trainer, keep.path)
    with _shown(trainer, progress) as watch:
        whole = trainer.run(watch, keep)
    result = trainer.result()
    said = json.dumps(report(trainer, result), indent=1) + "\n"

    def write(folder: Path) -> None:
        if isinstance(result, Uncompressed):
            write_uncompressed(result, folder)
        else:
            write_folder(result, folder)
        write_file(folder / REPORT_FILE, said.encode())

    write_somewhere(write, output, keep.path, keep)
    if whole:
        keep.discard()
    return trainer, whole


def report(trainer: Trainer, result: Scene | Uncompressed) -> dict[str, Any]:
    """What training.json says.

    bytes: of each part, as estimated (uncompressed: as they are); attributes are the sum of their kinds. quantised: of
    what training draws of the scene of integers, PSNR for each held-out photograph in 3DGS's convention.
    """
    shown = {}
    if isinstance(result, Scene):
        for photograph in trainer.photographs.test:
            made = trainer.views.show(result, photograph.camera).double().numpy()
            shown[photograph.camera.name] = psnr(float(np.mean((made - photograph.image / 255) ** 2)))
    first = trainer.photographs.train[0].camera
    return {
        "settings": document(trainer.settings),
        "size": [first.width, first.height],
        "steps": trainer.clock.done,
        "seconds": round(trainer.looks.seconds, 2),
        "anchors": result.anchor_count,
        "quantised": shown,
        "unit": trainer.scaffold.units.length,
        "bytes": {name: round(value) for name, value in trainer.estimate().items()},
        "history": trainer.looks.history,
    }


def line(trainer: Trainer) -> str:
    """A training's progress in words."""
    clock, looks, last = trainer.clock, trainer.looks, trainer.looks.history[-1:]
    size = last[0]["bytes"] if last else sum(v for k, v in trainer.estimate().items() if k not in KINDS)
    words = [f"step {clock.done} of {clock.steps}", f"{np.mean(looks.recent):.2f} dB"]
    words += [f"held-out {look['psnr']:.2f} dB" for look in last]
    words += [f"{trainer.scaffold.count} anchors", f"{size / 1000:.0f} KB"]
    return ", ".join([*words, f"{looks.pace * (clock.steps - clock.done):.0f} s left"])


@contextlib.contextmanager
def _shown(trainer: Trainer, progress: bool) -> Iterator[Watch]:
    """Progress on stderr: a bar on a terminal, else lines if they are wanted."""
    clock, looks = trainer.clock, trainer.looks
    if sys.stderr.isatty():
        from tqdm import tqdm  # noqa: PLC0415 (only here)

        with tqdm(total=clock.steps, initial=clock.done, desc="train", file=ProgressStream()) as bar:

            def show(_: Trainer) -> None:
                bar.update(clock.done - bar.n)
                if clock.done % 20 == 0 and looks.history:
                    last = looks.history[-1]
                    bar.set_postfix_str(
                        f"{last['psnr']:.2f} dB, {last['anchors']} anchors, {last['bytes'] / 1000:.0f} KB"
                    )

            yield show
        return
    last = time.monotonic()

    def tell(_: Trainer) -> None:
        nonlocal last
        if progress and (time.monotonic() - last > LINE_SECONDS or clock.done == clock.steps):
            note(line(trainer))
            last = time.monotonic()

    yield tell
