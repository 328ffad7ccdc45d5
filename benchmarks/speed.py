"""Where the time of a step of training goes, with and without a rate: python -m benchmarks.speed

It writes a section of RESULTS.md.
"""

from __future__ import annotations

import cProfile
import pstats

import numba
import torch

from refcodec.photographs.photographs import read_photographs
from refcodec.train.settings import TrainSettings
from refcodec.train.settings_file import varied
from refcodec.train.trainer import Trainer

from .results import machine, table, write_section
from .runs import EXAMPLES

# Steps that are measured, after some that compile and fill caches.
STEPS = 100
# Parts of a step, and what of the profile belongs to them: functions, or ends of file names.
PARTS = {
    "rasteriser, forward": ("project_gaussians", "sort_by_depth", "list_tiles", "blend_tiles"),
    "rasteriser, backward": ("unblend_tiles", "unproject_gaussians"),
    "SSIM": ("ssim.py",),
    "anchors to Gaussians": ("spawn.py",),
    "Adam": ("adam.py",),
    "torch, backward": ("run_backward",),
    "torch, products": ("linear",),
}
# Of these, the profile has the words in longer names.
BUILT_IN = ("run_backward", "linear")


def part_of(file: str, function: str) -> str | None:
    """The part of a step that a function belongs to."""
    for name, marks in PARTS.items():
        for mark in marks:
            if mark == function or file.endswith(mark) or (mark in BUILT_IN and mark in function):
                return name
    return None


def milliseconds(profiler: cProfile.Profile) -> dict[str, float]:
    """Of a step, by its parts, and "step" for all of it."""
    spent = dict.fromkeys(("step", *PARTS), 0.0)
    found: dict[tuple[str, int, str], tuple[int, int, float, float, object]] = vars(pstats.Stats(profiler))["stats"]
    for (file, _, function), (_, _, own, _, _) in found.items():
        spent["step"] += 1000 * own / STEPS
        if part := part_of(file, function):
            spent[part] += 1000 * own / STEPS
    return spent


def row(side: int, words: str, rate: float, begin: float) -> list[str]:
    """A row of the table. begin: the share of the training at which it is measured."""
    photographs = read_photographs(EXAMPLES / "caliterra", (side, side * 3 // 4))
    trainer = Trainer(photographs, varied(TrainSettings(), {"rate.weight": rate, "steps": 1000}))
    for _ in range(60):
        trainer.step()
    trainer.clock.done += int(begin * trainer.clock.steps)
    for _ in range(20):
        trainer.step()
    profiler = cProfile.Profile()
    profiler.enable()
    for _ in range(STEPS):
        trainer.step()
    profiler.disable()
    spent = milliseconds(profiler)
    rest = 2 * spent["step"] - sum(spent.values())
    return [f"{side} x {side * 3 // 4}", words, *(f"{value:.1f}" for value in (*spent.values(), rest))]


def main() -> None:
    """Measures and writes."""
    torch.set_num_threads(1)
    numba.set_num_threads(1)
    phases = (("anchors alone", 0.0, 0.0), ("with the rate", 0.004, 0.5))
    rows = [row(side, *phase) for side in (200, 400) for phase in phases]
    lines = ["`python -m benchmarks.speed`", "", machine("torch"), ""]
    lines += [f"Milliseconds of a step, caliterra, one thread, mean of {STEPS} steps:", ""]
    lines += table(["size", "phase", "step", *PARTS, "the rest"], rows)
    write_section("training-speed", "Speed of training", lines)


if __name__ == "__main__":
    main()
