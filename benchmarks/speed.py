"""Where the time of a step of training goes, without a rate, with it and in the last phase: python -m benchmarks.speed

It writes a section of RESULTS.md.
"""

from __future__ import annotations

import cProfile
import pstats
import time
from statistics import median

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
# Where steps are compared: rounds, in each of which every phase takes some steps.
ROUNDS, TURN = 20, 5
# Phases: what they are called, lambda_r, and the share of a training that they come after.
PHASES = (("anchors alone", 0.0, 0.0), ("with the rate", 0.004, 0.5), ("in the last phase", 0.004, 0.8))
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


def trainer_at(side: int, rate: float, begin: float) -> Trainer:
    """A training that has compiled and filled its caches. begin: the share of its steps that it leaves out."""
    photographs = read_photographs(EXAMPLES / "caliterra", (side, side * 3 // 4))
    trainer = Trainer(photographs, varied(TrainSettings(), {"rate.weight": rate, "steps": 1000}))
    for _ in range(60):
        trainer.step()
    trainer.clock.done += int(begin * trainer.clock.steps)
    for _ in range(20):
        trainer.step()
    return trainer


def row(side: int, words: str, rate: float, begin: float) -> list[str]:
    """A row of the table of parts."""
    trainer = trainer_at(side, rate, begin)
    profiler = cProfile.Profile()
    profiler.enable()
    for _ in range(STEPS):
        trainer.step()
    profiler.disable()
    spent = milliseconds(profiler)
    rest = 2 * spent["step"] - sum(spent.values())
    return [f"{side} x {side * 3 // 4}", words, *(f"{value:.1f}" for value in (*spent.values(), rest))]


def compared(side: int) -> list[str]:
    """A row of the table of ratios: process time of a step in each phase, and ratios to the first one's.

    The phases take turns, so that all of them have a busy machine's good and bad moments. Nothing is profiled, which
    would count Python's calls twice.
    """
    trainers = [trainer_at(side, rate, begin) for _, rate, begin in PHASES]
    spent: list[list[float]] = [[] for _ in trainers]
    for _ in range(ROUNDS):
        for trainer, found in zip(trainers, spent, strict=True):
            began = time.process_time()
            for _ in range(TURN):
                trainer.step()
            found.append(1000 * (time.process_time() - began) / TURN)
    ratios = [median(b / a for a, b in zip(spent[0], found, strict=True)) for found in spent[1:]]
    times = [f"{median(found):.1f}" for found in spent]
    return [f"{side} x {side * 3 // 4}", *times, *(f"{ratio:.2f}" for ratio in ratios)]


def main() -> None:
    """Measures and writes."""
    torch.set_num_threads(1)
    numba.set_num_threads(1)
    sides = (200, 400)
    rows = [row(side, *phase) for side in sides for phase in PHASES]
    lines = ["`python -m benchmarks.speed`", "", machine("torch"), ""]
    lines += [f"Milliseconds of a step, caliterra, one thread, profiled, mean of {STEPS} steps:", ""]
    lines += table(["size", "phase", "step", *PARTS, "the rest"], rows)
    words = [words for words, _, _ in PHASES]
    lines += [
        "",
        "Milliseconds of a step's process time, not profiled, and medians of its ratio to one of anchors alone:",
        "",
    ]
    lines += table(["size", *words, *(f"ratio {phase}" for phase in words[1:])], [compared(side) for side in sides])
    write_section("training-speed", "Speed of training", lines)


if __name__ == "__main__":
    main()
