"""The comparisons: single steps from one state, and whole training runs with their files."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from torch import Tensor

from refcodec.bitstream.codec import parse
from refcodec.bitstream.reconstruction import digest
from refcodec.photographs.photographs import PhotographSet, read_photographs
from refcodec.train.adam import BETA_1
from refcodec.train.exact_networks import device_networks
from refcodec.train.scaffold import TABLES
from refcodec.train.settings import TrainSettings
from refcodec.train.settings_file import varied
from refcodec.train.state import restore, save
from refcodec.train.trainer import Trainer

from ..large import ROOT

EXAMPLES = ROOT / "examples" / "photographs"
ENVIRONMENT = {**os.environ, "OMP_WAIT_POLICY": "PASSIVE", "NUMBA_NUM_THREADS": "1"}

# The allowed differences. Images and gradients differ where an alpha of 1/255 falls on the other side (splat.draw), on
# the mean by far less than a step of eight bits. Training runs differ by rounding, as much as two seeds do.
IMAGE, GRADIENT, PSNR, BYTES = 1e-4, 1e-2, 0.3, 0.03


class LateError(Exception):
    """The time limit is exceeded."""


@dataclass(frozen=True)
class Size:
    """The size of the comparison. sides: longest in pixels, of single steps and of training runs. steps: of each."""

    sides: tuple[int, int] = (200, 200)
    steps: tuple[int, int] = (200, 1000)
    anchors: int = 4000


@dataclass(frozen=True)
class Row:
    """A line of the table. limit: the largest allowed difference; None if it is only reported."""

    what: str
    cpu: str
    other: str
    difference: float | None = None
    limit: float | None = None

    @property
    def holds(self) -> bool:
        """Whether the two agree."""
        return self.limit is None or (self.difference is not None and self.difference <= self.limit)

    @property
    def cells(self) -> list[str]:
        """The cells of the table."""
        told = ["" if v is None else f"{v:.2g}" for v in (self.difference, self.limit)]
        return [self.what, self.cpu, self.other, *told, "" if self.limit is None else "yes" if self.holds else "**no**"]


# --- single steps -----------------------------------------------------------------------------------------------------


def steps_agree(device: str, work: Path, size: Size) -> list[Row]:
    """One step from the same state on the CPU and on a device: before there is a rate, and when all is rounded.

    Neither depends on random numbers: there is no noise, and the rate counts all anchors.
    """
    photographs = read_photographs(EXAMPLES / "caliterra", size.sides[0])
    changes = {
        "steps": size.steps[0],
        "start.anchors": size.anchors,
        "sampling.share": 1.0,
        "sampling.among": "all",
        # No anchor is added or removed, so that rows before and after a step are the same.
        "growth.period": size.steps[0] + 1,
    }
    settings = varied(TrainSettings(), changes)
    along, state = Trainer(photographs, settings), work / "state"
    rows = []
    for when, done in (("the first step", 0), ("the last step", size.steps[0] - 1)):
        while along.clock.done < done:
            along.step()
        save(along, state)
        image, gradients = _step(photographs, settings, "cpu", state)
        other_image, other_gradients = _step(photographs, settings, device, state)
        rows.append(_image_far(f"image before {when}, mean difference", image, other_image))
        # Masks have no gradient before there is a rate.
        names = [name for name in TABLES if gradients[name].any() or other_gradients[name].any()]
        rows += [_far(f"gradient of {name}, {when}", gradients[name], other_gradients[name]) for name in names]
    return rows


def _step(
    photographs: PhotographSet, settings: TrainSettings, device: str, state: Path
) -> tuple[Tensor, dict[str, Tensor]]:
    """An image of a state, and the gradients of the tables in its next step, on the CPU."""
    trainer = Trainer(photographs, settings, device)
    restore(trainer, state)
    image = trainer.views.draw(photographs.train[0].camera).cpu()
    before = {name: value.clone() for name, value in trainer.scaffold.first.items()}
    trainer.step()
    # Adam's first moment: only the rows that were seen have changed.
    after, share = trainer.scaffold.first, float(BETA_1)
    found = {}
    for name in TABLES:
        changed = (after[name] != before[name]).any(dim=1, keepdim=True)
        found[name] = ((after[name] - share * before[name]) * changed / (1 - share)).cpu()
    return image, found


def _far(what: str, one: Tensor, other: Tensor) -> Row:
    """The relative difference of two gradients."""
    first, second = (float(v.double().norm()) for v in (one, other))
    away = float((one.double() - other.double()).norm()) / max(first, 1e-30)
    return Row(what, f"{first:.4g}", f"{second:.4g}", away, GRADIENT)


def _image_far(what: str, one: Tensor, other: Tensor) -> Row:
    """The mean difference of two images' values."""
    away = float((one.double() - other.double()).abs().mean())
    return Row(what, f"{float(one.mean()):.4g}", f"{float(other.mean()):.4g}", away, IMAGE)


def networks_agree(device: str) -> Row:
    """The digest of a trained file whose networks a device computes, beside the one of the CPU."""
    data = (ROOT / "vectors" / "valid" / "trained-caliterra.c3gs").read_bytes()
    wanted = digest(parse(data).scene)[0]
    found = digest(parse(data, derive=partial(device_networks, device=device)).scene)[0]
    return Row("digest of a file, its networks on each", wanted[:8], found[:8], float(found != wanted), 0.0)


# --- whole training runs ----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Outcome:
    """A training run and its file. again: the digest of the file that is made of the decoded one."""

    psnr: float
    size: int
    seconds: float
    anchors: int
    digest: str
    again: str


def trained(device: str, work: Path, size: Size, deadline: float) -> Outcome:
    """Trains, encodes, decodes, and encodes the decoded scene. Raises LateError, and SystemExit if a command fails."""
    folder, file, second = work / device, work / f"{device}.c3gs", work / f"{device}-again.c3gs"
    photographs, side = str(EXAMPLES / "caliterra"), str(size.sides[1])
    said = _caller(deadline)
    words = ["--size", side, "--steps", str(size.steps[1]), "--anchors", str(size.anchors), "--device", device]
    said("train", photographs, "-o", str(folder), *words)
    said("encode", str(folder), "-o", str(file))
    said("decode", str(file), "-o", str(work / f"{device}-decoded"))
    said("encode", str(work / f"{device}-decoded"), "-o", str(second))
    shown = json.loads(said("eval", str(file), photographs, "--size", side, "--json"))
    report = json.loads((folder / "training.json").read_text())
    digests = [said("digest", str(each)).split()[0] for each in (file, second)]
    return Outcome(
        shown["mean"]["psnr"], file.stat().st_size, report["seconds"], report["anchors"], digests[0], digests[1]
    )


def _caller(deadline: float) -> Callable[..., str]:
    def call(*words: str) -> str:
        left = deadline - time.monotonic()
        try:
            done = subprocess.run(
                [sys.executable, "-m", "refcodec", *words],
                env=ENVIRONMENT,
                capture_output=True,
                text=True,
                check=False,
                timeout=max(left, 0.001),
            )
        except subprocess.TimeoutExpired:
            raise LateError(f"refcodec {words[0]} was not done in time") from None
        if done.returncode:
            raise SystemExit(f"refcodec {' '.join(words)}: {done.stderr}")
        return done.stdout

    return call


def trainings_agree(cpu: Outcome, other: Outcome) -> list[Row]:
    """The rows about two training runs."""
    same = [outcome.digest == outcome.again for outcome in (cpu, other)]
    told = ["the same" if each else "another" for each in same]
    return [
        Row(
            "PSNR of held-out photographs, dB", f"{cpu.psnr:.2f}", f"{other.psnr:.2f}", abs(cpu.psnr - other.psnr), PSNR
        ),
        Row("bytes of the file", f"{cpu.size:,}", f"{other.size:,}", abs(cpu.size - other.size) / cpu.size, BYTES),
        Row(
            "digest of the file decoded and encoded again",
            told[0],
            told[1],
            float(same.count(False)),
            0.0,
        ),
        Row("anchors", f"{cpu.anchors:,}", f"{other.anchors:,}"),
        Row("seconds of the training", f"{cpu.seconds:.0f}", f"{other.seconds:.0f}"),
        Row("times as fast", "1", f"{cpu.seconds / other.seconds:.1f}"),
    ]


def holds(rows: Sequence[Row]) -> bool:
    """Whether all rows agree."""
    return bool(np.all([row.holds for row in rows]))
