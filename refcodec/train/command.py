"""What `refcodec train` does: presets, progress, the saved state, and what it leaves behind."""

from __future__ import annotations

import contextlib
import json
import math
import sys
import time
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numba
import numpy as np
import torch

from ..bitstream.attributes import KINDS
from ..bitstream.scene import Scene
from ..folder.layout import is_free
from ..folder.uncompressed import Uncompressed, is_uncompressed, write_uncompressed
from ..folder.write import write_folder
from ..photographs.photographs import PhotographSet
from .state import restore
from .trainer import Trainer, TrainSettings, Watch

REPORT_FILE = "training.json"
# fast: minutes on two cores. paper: the paper's steps, anchors from the points' median distance, photographs as large as 3DGS takes them.
PRESETS: dict[str, dict[str, int]] = {
    "fast": {"steps": 4000, "anchors": 5000, "most_anchors": 40000, "side": 400},
    "paper": {"steps": 40000, "anchors": 0, "most_anchors": 1 << 20, "side": 1600},
}
# Seconds between two lines of progress where there is no terminal.
LINE_SECONDS = 5.0


def state_path(output: Path) -> Path:
    """Where a training saves itself: beside the folder, which is whole or not there."""
    return output.with_name(output.name + ".train-state")


def may_write(output: Path) -> bool:
    """Whether a training may leave its result there."""
    return is_free(output) or is_uncompressed(output)


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

    threads: of the rasteriser; all else uses one, so that no result depends on it. Raises ValueError for photographs that cannot be
    learnt from, for a saved state that is damaged or of another training, and for a scene that cannot be written.
    """
    torch.set_num_threads(1)
    numba.set_num_threads(min(threads, numba.get_num_threads()))
    trainer = Trainer(photographs, settings, device)
    state = state_path(output)
    if resume:
        restore(trainer, state)
    with _shown(trainer, progress) as watch:
        whole = trainer.run(watch, state)
    result = trainer.result()
    if isinstance(result, Uncompressed):
        write_uncompressed(result, output)
    else:
        write_folder(result, output)
    (output / REPORT_FILE).write_text(json.dumps(report(trainer, result), indent=1) + "\n", encoding="utf-8")
    if whole:
        state.unlink(missing_ok=True)
    return trainer, whole


def report(trainer: Trainer, result: Scene | Uncompressed) -> dict[str, Any]:
    """What training.json says. bytes: of each part, as estimated (uncompressed: as they are); attributes are the sum of their kinds;
    quantised: what training draws of the scene of integers, for each held-out photograph, PSNR in 3DGS's convention."""
    shown = {}
    if isinstance(result, Scene):
        for photograph in trainer.photographs.test:
            error = np.mean((trainer.show(result, photograph.camera).double().numpy() - photograph.image / 255) ** 2)
            shown[photograph.camera.name] = -10 * math.log10(float(error) + 1e-12)
    return {
        "settings": asdict(trainer.settings),
        "size": [trainer.cameras[0].width, trainer.cameras[0].height],
        "steps": trainer.done,
        "seconds": round(trainer.seconds, 2),
        "anchors": result.anchor_count,
        "quantised": shown,
        "unit": trainer.scaffold.units.length,
        "bytes": {name: round(value) for name, value in trainer.estimate().items()},
        "history": trainer.history,
    }


def line(trainer: Trainer) -> str:
    """A training's progress in words."""
    left = trainer.pace * (trainer.settings.steps - trainer.done)
    known = (
        trainer.history[-1]["bytes"] / 1000
        if trainer.history
        else sum(v for k, v in trainer.estimate().items() if k not in KINDS) / 1000
    )
    held_out = f", held-out {trainer.history[-1]['psnr']:.2f} dB" if trainer.history else ""
    return (
        f"step {trainer.done} of {trainer.settings.steps}, {np.mean(trainer.recent):.2f} dB{held_out}, {trainer.scaffold.count} anchors, "
        f"{known:.0f} KB, {left:.0f} s left"
    )


@contextlib.contextmanager
def _shown(trainer: Trainer, progress: bool) -> Iterator[Watch]:
    """Progress on stderr: a bar on a terminal, else lines if they are wanted."""
    if sys.stderr.isatty():
        from tqdm import tqdm  # noqa: PLC0415 (only here)

        with tqdm(total=trainer.settings.steps, initial=trainer.done, desc="train", file=sys.stderr) as bar:

            def show(t: Trainer) -> None:
                bar.update(t.done - bar.n)
                if t.done % 20 == 0 and t.history:
                    last = t.history[-1]
                    bar.set_postfix_str(
                        f"{last['psnr']:.2f} dB, {last['anchors']} anchors, {last['bytes'] / 1000:.0f} KB"
                    )

            yield show
        return
    last = time.monotonic()

    def tell(t: Trainer) -> None:
        nonlocal last
        if progress and (time.monotonic() - last > LINE_SECONDS or t.done == t.settings.steps):
            print(line(t), file=sys.stderr, flush=True)
            last = time.monotonic()

    yield tell
