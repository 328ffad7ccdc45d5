"""Trainings of the benchmarks: as commands of refcodec, two at a time, and what is finished is kept."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

EXAMPLES = Path(__file__).resolve().parent.parent / "examples" / "photographs"
ENVIRONMENT = {**os.environ, "OMP_WAIT_POLICY": "PASSIVE", "NUMBA_NUM_THREADS": "1"}
JOBS = 2
HOW = (
    "Two trainings at a time, one thread each; every eighth image held out; "
    "PSNR and SSIM by scikit-image of eight-bit images."
)


@dataclass(frozen=True)
class Run:
    """One training: photographs, longest side in pixels, lambda_r, steps, and changes as of `refcodec train --set`."""

    scene: str
    side: int
    rate: float
    steps: int
    changes: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """A name for its files."""
        return "-".join([self.scene, str(self.side), f"{self.rate:g}", str(self.steps), *self.changes])

    @property
    def options(self) -> list[str]:
        """Of `refcodec train`."""
        words = ["--size", str(self.side), "--rate", f"{self.rate:g}", "--steps", str(self.steps)]
        return words + [word for change in self.changes for word in ("--set", change)]

    @property
    def command(self) -> str:
        """What to type."""
        return " ".join(["refcodec train", f"examples/photographs/{self.scene}", "-o SCENE", *self.options])


def refcodec(*words: str) -> str:
    """What a command of refcodec prints. Raises SystemExit with its errors if it fails."""
    command = [sys.executable, "-m", "refcodec", *words]
    done = subprocess.run(command, env=ENVIRONMENT, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"refcodec {' '.join(words)}: {done.stderr}")
    return done.stdout


def perform(run: Run, work: Path) -> dict[str, Any]:
    """Trains, encodes and evaluates: `training`, what training.json says, and `eval`, what eval says."""
    found = work / f"{run.name}.json"
    if found.exists():
        return dict(json.loads(found.read_text()))
    folder, file, photographs = work / run.name, work / f"{run.name}.c3gs", str(EXAMPLES / run.scene)
    state = folder.with_name(folder.name + ".train-state")
    resume = ["--resume"] if state.exists() else []
    refcodec("train", photographs, "-o", str(folder), "--threads", "1", *run.options, *resume)
    coded = run.rate > 0
    if coded:
        refcodec("encode", str(folder), "-o", str(file))
    shown = json.loads(refcodec("eval", str(file if coded else folder), photographs, "--size", str(run.side), "--json"))
    return keep(run.name, work, {"training": json.loads((folder / "training.json").read_text()), "eval": shown})


def keep(name: str, work: Path, result: dict[str, Any]) -> dict[str, Any]:
    """Writes a result to a file, and says that it is there."""
    (work / f"{name}.json").write_text(json.dumps(result))
    print(f"{name}: {result['eval']['mean']['psnr']:.2f} dB, {result['eval']['bytes']} bytes", flush=True)
    return result


def perform_all(runs: Sequence[Run], work: Path) -> list[dict[str, Any]]:
    """Results of runs, two at a time."""
    with ThreadPoolExecutor(JOBS) as pool:
        return list(pool.map(lambda run: perform(run, work), runs))
