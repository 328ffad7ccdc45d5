"""`python -m benchmarks train`: a step of training without a rate, with it and in the last phase, and its parts."""

from __future__ import annotations

import cProfile
import pstats
import time
from dataclasses import dataclass
from statistics import median
from typing import Any

import numba
import torch

from refcodec.photographs.photographs import read_photographs
from refcodec.train.settings import TrainSettings
from refcodec.train.settings_file import varied
from refcodec.train.trainer import Trainer

from .results import facts, facts_line, table
from .runs import EXAMPLES

# Phases: what they are called, lambda_r, and the share of a training that they come after.
PHASES = (("anchors alone", 0.0, 0.0), ("with the rate", 0.004, 0.5), ("in the last phase", 0.004, 0.8))
# Parts of a step, and what of the profile belongs to them: functions, or ends of file names.
PARTS = {
    "rasteriser, forward": ("project_gaussians", "sort_by_depth", "list_tiles", "blend_tiles"),
    "rasteriser, backward": ("unblend_tiles", "unproject_gaussians"),
    "SSIM": ("photometric.py",),
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


@dataclass(frozen=True)
class Amount:
    """How much is measured.

    sides: widths of the photographs in pixels. warm: steps that compile and fill caches, and as many more in the phase
    that is measured. profiled: steps under the profiler. rounds, turn: where steps are compared, how many rounds there
    are, and how many steps every phase takes in each of them.
    """

    sides: tuple[int, ...] = (200, 400)
    warm: int = 40
    profiled: int = 100
    rounds: int = 20
    turn: int = 5


def milliseconds(profiler: cProfile.Profile, steps: int) -> dict[str, float]:
    """Of a step, by its parts, and "step" for all of it. steps: how many the profiler saw."""
    spent = dict.fromkeys(("step", *PARTS), 0.0)
    found: dict[tuple[str, int, str], tuple[int, int, float, float, object]] = vars(pstats.Stats(profiler))["stats"]
    for (file, _, function), (_, _, own, _, _) in found.items():
        spent["step"] += 1000 * own / steps
        if part := part_of(file, function):
            spent[part] += 1000 * own / steps
    return {**spent, "the rest": 2 * spent["step"] - sum(spent.values())}


def trainer_at(side: int, rate: float, begin: float, warm: int) -> Trainer:
    """A training that has compiled and filled its caches. begin: the share of its steps that it leaves out."""
    photographs = read_photographs(EXAMPLES / "caliterra", (side, side * 3 // 4))
    trainer = Trainer(photographs, varied(TrainSettings(), {"rate.weight": rate, "steps": 1000}))
    for _ in range(warm):
        trainer.step()
    trainer.clock.done += int(begin * trainer.clock.steps)
    for _ in range(warm):
        trainer.step()
    return trainer


def parts(side: int, amount: Amount) -> list[dict[str, Any]]:
    """Where the time of a step goes, in each phase."""
    found = []
    for phase, rate, begin in PHASES:
        trainer = trainer_at(side, rate, begin, amount.warm)
        profiler = cProfile.Profile()
        profiler.enable()
        for _ in range(amount.profiled):
            trainer.step()
        profiler.disable()
        found.append({"side": side, "phase": phase, "milliseconds": milliseconds(profiler, amount.profiled)})
    return found


def compared(side: int, amount: Amount) -> dict[str, Any]:
    """Process time and seconds of a step in each phase, and ratios to the first phase.

    The phases take turns, so that all of them have a busy machine's good and bad moments. Nothing is profiled, which
    would count Python's calls twice.
    """
    trainers = {phase: trainer_at(side, rate, begin, amount.warm) for phase, rate, begin in PHASES}
    clocks = {"milliseconds": time.perf_counter, "processor_milliseconds": time.process_time}
    spent: dict[str, dict[str, list[float]]] = {clock: {phase: [] for phase in trainers} for clock in clocks}
    order = []
    for _ in range(amount.rounds):
        for phase, trainer in trainers.items():
            order.append(phase)
            began = {clock: read() for clock, read in clocks.items()}
            for _ in range(amount.turn):
                trainer.step()
            for clock, read in clocks.items():
                spent[clock][phase].append(1000 * (read() - began[clock]) / amount.turn)
    runs = spent["processor_milliseconds"]
    first = runs[PHASES[0][0]]
    return {
        "side": side,
        "order": order,
        "ratios": {phase: median(b / a for a, b in zip(first, found, strict=True)) for phase, found in runs.items()},
        **{clock: {phase: median(found) for phase, found in each.items()} for clock, each in spent.items()},
        "runs": runs,
    }


def training(amount: Amount = Amount()) -> dict[str, Any]:
    """Returns the figures, by one thread."""
    torch.set_num_threads(1)
    numba.set_num_threads(1)
    return {
        "task": "train",
        "machine": facts("torch", "numba"),
        "amount": vars(amount),
        "parts": [row for side in amount.sides for row in parts(side, amount)],
        "compared": [compared(side, amount) for side in amount.sides],
    }


def training_lines(figures: dict[str, Any]) -> list[str]:
    """Figures as the lines of a section."""
    amount, phases = figures["amount"], [phase for phase, _, _ in PHASES]
    whole = [
        [_size(row["side"]), row["phase"], *(f"{value:.1f}" for value in row["milliseconds"].values())]
        for row in figures["parts"]
    ]
    ratios = [
        [
            _size(row["side"]),
            *(f"{row['processor_milliseconds'][phase]:.1f}" for phase in phases),
            *(f"{row['ratios'][phase]:.2f}" for phase in phases[1:]),
        ]
        for row in figures["compared"]
    ]
    return [
        facts_line(figures["machine"]),
        "",
        f"Milliseconds of a step, caliterra, one thread, profiled, mean of {amount['profiled']} steps:",
        "",
        *table(["size", "phase", "step", *PARTS, "the rest"], whole),
        "",
        "Milliseconds of a step's process time, not profiled, and medians of its ratio to one of anchors alone:",
        "",
        *table(["size", *phases, *(f"ratio {phase}" for phase in phases[1:])], ratios),
    ]


def _size(side: int) -> str:
    return f"{side} x {side * 3 // 4}"
