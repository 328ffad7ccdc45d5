"""What a training says to people: before its first step, on the way, and at its end."""

from __future__ import annotations

import contextlib
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numba.core import event

from ..bitstream.attributes import KINDS
from ..files.terminal import ProgressStream, note
from ..files.text import shell_word
from .trainer import Trainer, Watch

# Seconds between two lines of progress where there is no terminal.
LINE_SECONDS = 5.0


def opening(trainer: Trainer) -> str:
    """What a training begins with, in a line."""
    photographs, settings = trainer.photographs, trainer.settings
    first = photographs.train[0].camera
    red, green, blue = photographs.background
    words = [f"{len(photographs.train)} photographs of {first.width} x {first.height}"]
    words.append(f"{len(photographs.test)} held out" if photographs.test else "none held out")
    if photographs.skipped:
        words.append(f"{photographs.skipped} without pose are left out")
    points = "points drawn at random" if photographs.random else "points"
    words += [f"{len(photographs.points)} {points}", f"background {red},{green},{blue}"]
    given = " of the scene to go on from" if trainer.given else ""
    words += [f"{trainer.scaffold.count} anchors{given}", f"{settings.steps} steps"]
    words.append(f"rate {settings.rate.weight:g}" if settings.rate.weight else "no rate: an uncompressed scene")
    if trainer.clock.done:
        words.append(f"from step {trainer.clock.done} on")
    return f"train: {', '.join(words)}"


def line(trainer: Trainer) -> str:
    """A training's progress in words. What is not measured yet is told with "about", or not at all."""
    clock, looks, last = trainer.clock, trainer.looks, trainer.looks.history[-1:]
    size = last[0]["bytes"] if last else sum(v for k, v in trainer.estimate().items() if k not in KINDS)
    words = [f"step {clock.done} of {clock.steps}", f"{np.mean(looks.recent):.2f} dB"]
    words += [f"held-out {look['psnr']:.2f} dB" for look in last]
    words += [f"{trainer.scaffold.count} anchors", kilobytes(trainer, size)]
    return ", ".join([*words, *_left(trainer)])


def _left(trainer: Trainer) -> list[str]:
    """The time that is left, in words, if there is any and it is known."""
    found = trainer.looks.pace.left()
    if found is None or trainer.clock.done == trainer.clock.steps:
        return []
    seconds, sure = found
    return [f"{'' if sure else 'about '}{max(seconds, 1):.0f} s left"]


def kilobytes(trainer: Trainer, size: float) -> str:
    """Bytes of a file in words."""
    likely = trainer.rate is not None and trainer.rate.model is None
    return f"{'about ' if likely else ''}{size / 1000:.0f} KB"


def closing(trainer: Trainer, report: dict[str, Any], output: Path, photographs: str) -> Iterator[str]:
    """What a training ends with, in lines. report: training.json. photographs: their folder, as it was given."""
    scene, size = str(output), sum(value for name, value in report["bytes"].items() if name not in KINDS)
    yield f"{scene}: {report['anchors']} anchors, {report['steps']} steps, {report['seconds']:.0f} s"
    test = len(trainer.photographs.test)
    shown = f"held-out PSNR {report['psnr']:.2f} dB of {test} photographs" if test else "no photographs are held out"
    coded = trainer.rate is not None
    yield f"{shown}; {'about ' if coded else ''}{size / 1000:.0f} KB {'in a file' if coded else 'uncompressed'}"
    if coded:
        yield f"next: refcodec encode {shell_word(scene)} -o {shell_word(f'{scene}.c3gs')}"
    else:
        yield f"next: refcodec eval {shell_word(scene)} {shell_word(photographs)}"


class _Compiling(event.Listener):
    """Says on stderr, once, that numba compiles."""

    said = False

    def on_start(self, event: event.Event) -> None:
        if not self.said:
            note("train: compiling, which takes up to a minute or two; what is compiled is kept if there is a place")
            self.said = True

    def on_end(self, event: event.Event) -> None:
        """Says nothing."""


@contextlib.contextmanager
def shown(trainer: Trainer, progress: bool, looked: Callable[[list[dict[str, Any]]], None]) -> Iterator[Watch]:
    """Progress on stderr: a bar on a terminal, else lines if they are wanted.

    looked: is told the history after each step.
    """
    with event.install_listener("numba:compile", _Compiling()), _told(trainer, progress) as tell:

        def watch(trainer: Trainer) -> None:
            tell(trainer)
            looked(trainer.looks.history)

        yield watch


@contextlib.contextmanager
def _told(trainer: Trainer, progress: bool) -> Iterator[Watch]:
    clock, looks = trainer.clock, trainer.looks
    if sys.stderr.isatty():
        from tqdm import tqdm  # noqa: PLC0415 (only here)

        # tqdm's own time left knows nothing of the rate.
        form = "{desc}: {percentage:3.0f}%|{bar}| {n_fmt}/{total_fmt} [{elapsed}{postfix}]"
        with tqdm(total=clock.steps, initial=clock.done, desc="train", file=ProgressStream(), bar_format=form) as bar:

            def show(_: Trainer) -> None:
                bar.update(clock.done - bar.n)
                if clock.done % 20 == 0 and looks.history:
                    last = looks.history[-1]
                    words = [f"{last['psnr']:.2f} dB, {last['anchors']} anchors", kilobytes(trainer, last["bytes"])]
                    bar.set_postfix_str(", ".join([*words, *_left(trainer)]))

            yield show
        return
    last = time.monotonic()

    def tell(_: Trainer) -> None:
        nonlocal last
        if progress and (time.monotonic() - last > LINE_SECONDS or clock.done == clock.steps):
            note(line(trainer))
            last = time.monotonic()

    yield tell
