"""The messages of a training run: before its first step, after steps, and at its end."""

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
from ..photographs.photographs import excluded
from .estimate import UNCOUNTED
from .stages.size import Size
from .trainer import Trainer, Watch

# Seconds between two lines of progress where there is no terminal.
LINE_SECONDS = 5.0


def opening(trainer: Trainer) -> str:
    """The line before the first step: photographs, points, anchors, steps, lambda_r."""
    photographs, settings = trainer.photographs, trainer.settings
    first = photographs.train[0].camera
    red, green, blue = photographs.background
    words = [f"{len(photographs.train)} photographs of {first.width} x {first.height}"]
    words.append(f"{len(photographs.test)} held out" if photographs.test else "none held out")
    if photographs.skipped:
        words.append(f"{photographs.skipped} without pose are left out")
    points = "points drawn at random" if photographs.random else "points"
    words += [f"{len(photographs.points)} {points}", f"background {red},{green},{blue}"]
    words += filter(None, [excluded([*photographs.train, *photographs.test])["masks"]])
    given = " of the scene to continue" if trainer.given else ""
    words += [f"{trainer.scaffold.count} anchors{given}", f"{settings.steps} steps"]
    words.append(f"lambda {settings.rate.lambda_r:g}" if settings.rate.lambda_r else "lambda 0: an uncompressed scene")
    if trainer.clock.done:
        words.append(f"from step {trainer.clock.done} on")
    return f"train: {', '.join(words)}"


def line(trainer: Trainer) -> str:
    """The progress of a training run. A value that is not measured yet is left out."""
    clock, looks, last = trainer.clock, trainer.looks, trainer.looks.history[-1:]
    halved = any(stage.halves(trainer.cameras[0], clock.done - len(looks.recent)) for stage in trainer.of(Size))
    shown = f"{np.mean(looks.recent):.2f} dB{' of halved photographs' if halved else ''}"
    words = [f"step {clock.done} of {clock.steps}", shown]
    words += [f"held-out {look['psnr']:.2f} dB" for look in last]
    words += [f"{trainer.scaffold.count} anchors"]
    return ", ".join([*words, *_size(trainer), *_left(trainer)])


def _left(trainer: Trainer) -> list[str]:
    """The time left, if it is known and the training has not ended."""
    left = trainer.looks.pace.left()
    if left is None or trainer.clock.done == trainer.clock.steps:
        return []
    seconds, sure = left
    return [f"{'' if sure else 'about '}{max(seconds, 1):.0f} s left"]


def _size(trainer: Trainer) -> list[str]:
    """The size of a file at the last look, if an entropy model counted it."""
    return [file_size(trainer, look["bytes"]) for look in trainer.looks.history[-1:] if look["bytes"]]


def file_size(trainer: Trainer, size: float) -> str:
    """The size of a file in words. size: bytes of estimate."""
    uncounted = 0 if trainer.rate is None else UNCOUNTED
    return f"{(size + uncounted) / 1000:.0f} KB"


def closing(trainer: Trainer, report: dict[str, Any], output: Path, photographs: str) -> Iterator[str]:
    """The lines after the last step. report: training.json. photographs: their folder, as the user gave it."""
    scene, size = str(output), sum(value for name, value in report["bytes"].items() if name not in KINDS)
    yield f"{scene}: {report['anchors']} anchors, {report['steps']} steps, {report['seconds']:.0f} s"
    test = len(trainer.photographs.test)
    shown = f"held-out PSNR {report['psnr']:.2f} dB of {test} photographs" if test else "no photographs are held out"
    coded = trainer.rate is not None
    yield f"{shown}; {'about ' if coded else ''}{file_size(trainer, size)} {'in a file' if coded else 'uncompressed'}"
    if coded:
        yield f"next: refcodec encode {shell_word(scene)} -o {shell_word(f'{scene}.c3gs')}"
    else:
        yield f"next: refcodec eval {shell_word(scene)} {shell_word(photographs)}"


class _Compiling(event.Listener):
    """Reports once on stderr that numba compiles."""

    reported = False

    def on_start(self, event: event.Event) -> None:
        if not self.reported:
            note("train: compiling, which takes up to a minute or two; the compiled code is kept if possible")
            self.reported = True

    def on_end(self, event: event.Event) -> None:
        """Needs no message."""


@contextlib.contextmanager
def shown(trainer: Trainer, progress: bool, looked: Callable[[list[dict[str, Any]]], None]) -> Iterator[Watch]:
    """Progress on stderr: a bar on a terminal, else lines if they are wanted.

    looked: called with the history after each step.
    """
    with event.install_listener("numba:compile", _Compiling()), _progress(trainer, progress) as report:

        def watch(trainer: Trainer) -> None:
            report(trainer)
            looked(trainer.looks.history)

        yield watch


@contextlib.contextmanager
def _progress(trainer: Trainer, progress: bool) -> Iterator[Watch]:
    clock, looks = trainer.clock, trainer.looks
    if sys.stderr.isatty():
        from tqdm import tqdm  # noqa: PLC0415 (only here)

        # tqdm's own estimate does not include the rate.
        form = "{desc}: {percentage:3.0f}%|{bar}| {n_fmt}/{total_fmt} [{elapsed}{postfix}]"
        with tqdm(total=clock.steps, initial=clock.done, desc="train", file=ProgressStream(), bar_format=form) as bar:

            def show(_: Trainer) -> None:
                bar.update(clock.done - bar.n)
                if clock.done % 20 == 0 and looks.history:
                    last = looks.history[-1]
                    words = [f"{last['psnr']:.2f} dB", f"{last['anchors']} anchors"]
                    bar.set_postfix_str(", ".join([*words, *_size(trainer), *_left(trainer)]))

            yield show
        return
    last = time.monotonic()

    def report(_: Trainer) -> None:
        nonlocal last
        if progress and (time.monotonic() - last > LINE_SECONDS or clock.done == clock.steps):
            note(line(trainer))
            last = time.monotonic()

    yield report
