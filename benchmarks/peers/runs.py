"""Runs of methods on scenes, one JSON file each. Finished runs are not repeated, and interrupted ones are resumed."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numba
import torch

from refcodec.bitstream.batches import no_progress
from refcodec.bitstream.codec import emit
from refcodec.encoder.quantise import packed
from refcodec.evaluate.evaluation import evaluate
from refcodec.files.documents import DocumentError, read_json
from refcodec.folder.uncompressed import Uncompressed
from refcodec.photographs.photographs import PhotographSet, read_photographs
from refcodec.train.settings import TrainSettings
from refcodec.train.settings_file import assigned, differences, document, varied
from refcodec.train.state import restore, save
from refcodec.train.trainer import Trainer

from .convert import FORMATS, INSTALL, VERSION, there_and_back, tool
from .figures import Record
from .settings import SplatSettings
from .splats import quality, read_ply, write_ply
from .trainer import SplatTrainer, view_settings

METHODS = PLAIN, OWN = "3dgs", "c3gs"
# The file of 3DGS itself, from which SPZ and SOG are made.
UNCODED = "3DGS, PLY"
# The least number of seconds between two lines of progress.
LINE_SECONDS = 5.0


@dataclass(frozen=True)
class Run:
    """One training.

    photographs: their folder. method: of METHODS. strength: for 3DGS the limit of Gaussians, else lambda_r; with 0,
    C3GS is an uncompressed Scaffold-GS. size: longest side, in pixels. changes: NAME=VALUE of the method's settings.
    """

    photographs: Path
    method: str
    strength: float
    seed: int
    size: int
    steps: int
    changes: tuple[str, ...] = ()

    @property
    def scene(self) -> str:
        """The name of the photographs."""
        return self.photographs.resolve().name

    @property
    def name(self) -> str:
        """The name of its files."""
        words = [self.scene, self.method, f"{self.strength:g}", f"s{self.seed}", f"{self.size}px"]
        return "-".join([*words, f"{self.steps}", *self.changes]).replace("/", "_")

    def record(self, seconds: float, settings: Any, files: Record, **more: Any) -> Record:
        """The content of its JSON file: the run, processor seconds of training, and each kind of file that it made."""
        own = {"scene": self.scene, "method": self.method, "strength": self.strength, "seed": self.seed}
        own |= {"size": self.size, "steps": self.steps, "changes": list(self.changes)}
        return {**own, "seconds": round(seconds, 2), "files": files, **more, "settings": document(settings)}


def perform(run: Run, folder: Path) -> Record | None:
    """Returns the record of a run, from its file or by running it. Returns None after an interrupt.

    If splat-transform is missing, a 3DGS run is complete without SPZ and SOG. It gets them later. Raises ValueError for
    a record of other settings, and for unusable photographs.
    """
    torch.set_num_threads(1)
    numba.set_num_threads(1)
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / f"{run.name}.json"
    if file.exists():
        record = _read(file)
        _check(record, file, splat_settings(run) if run.method == PLAIN else anchor_settings(run))
        if run.method != PLAIN or len(record["files"]) > len(FORMATS) or tool() is None:
            return record
        return _written(file, _with_formats(run, record, folder))
    made = _plain(run, folder) if run.method == PLAIN else _anchored(run, folder)
    return made and _written(file, made)


def _check(record: Record, file: Path, settings: Any) -> None:
    """Raises ValueError if the settings of a method differ from those of a record."""
    changes = list(differences(record["settings"], document(settings)))
    if changes:
        raise ValueError(f"{file} has other settings, remove it: {'; '.join(changes)}")


# The fields of a record, for tables and for resuming a run.
_KEYS = {"scene", "method", "strength", "seed", "size", "steps", "changes", "seconds", "files", "settings"}


def _read(file: Path) -> Record:
    """Reads a record. Raises ValueError for another document, and OSError."""
    try:
        found = read_json(file)
    except DocumentError as error:
        raise ValueError(f"{file}: {error}") from None
    if not isinstance(found, dict) or not found.keys() >= _KEYS:
        raise ValueError(f"{file} is not a record of a run, remove it")
    return found


def records(folder: Path) -> list[Record]:
    """Returns all runs of a folder. Raises ValueError and OSError."""
    return [_read(path) for path in sorted(folder.glob("*.json"))]


def _written(file: Path, record: Record) -> Record:
    beside = file.with_suffix(".new")
    beside.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")
    beside.replace(file)
    shown = [f"{label} {row['psnr']:.2f} dB in {row['bytes']:.0f} bytes" for label, row in record["files"].items()]
    print(f"{file.stem}: {', '.join(shown)}; {record['seconds']:.0f} s", flush=True)
    return record


# --- 3DGS -------------------------------------------------------------------------------------------------------------


def splat_settings(run: Run) -> SplatSettings:
    """Returns the settings of a run of 3DGS. Raises SettingsError."""
    own = {"steps": run.steps, "seed": run.seed, "size": run.size, "density.most": int(run.strength)}
    return assigned(varied(SplatSettings(), own), run.changes)


def train_splats(
    photographs: PhotographSet, settings: SplatSettings, output: Path, resume: bool
) -> SplatTrainer | None:
    """Trains a plain 3DGS and writes its PLY file. After an interrupt it saves its state and returns None.

    resume: from the saved state beside the output. Raises ValueError for unusable photographs, and for a saved state
    that is damaged or of another training run.
    """
    trainer, state = SplatTrainer(photographs, settings), output.with_suffix(".train-state")
    if resume:
        restore(trainer, state)
    watch = every_seconds(
        lambda: f"step {trainer.done} of {settings.steps}, loss {trainer.loss:.4f}, {trainer.count} Gaussians"
    )
    if not trainer.run(lambda _: watch(), lambda: save(trainer, state)):
        return None
    write_ply(trainer.result(), output)
    state.unlink(missing_ok=True)
    return trainer


def every_seconds(line: Callable[[], str]) -> Callable[[], None]:
    """Returns a function that prints a line to stderr, at most once per LINE_SECONDS."""
    last = time.monotonic()

    def watch() -> None:
        nonlocal last
        if time.monotonic() - last > LINE_SECONDS:
            print(line(), file=sys.stderr, flush=True)
            last = time.monotonic()

    return watch


def _plain(run: Run, folder: Path) -> Record | None:
    photographs, settings = read_photographs(run.photographs, run.size, seed=run.seed), splat_settings(run)
    ply = folder / f"{run.name}.ply"
    trainer = train_splats(photographs, settings, ply, ply.with_suffix(".train-state").exists())
    if trainer is None:
        return None
    shown = _shown(ply, ply, photographs, settings)
    record = run.record(trainer.seconds, settings, {UNCODED: shown}, gaussians=len(trainer.result()["mean"]))
    if tool() is None:
        print(f"splat-transform is missing, so there is no SPZ and no SOG: run `{INSTALL}`", file=sys.stderr)
        return record
    return _with_formats(run, record, folder)


def _with_formats(run: Run, record: Record, folder: Path) -> Record:
    """Returns the record with SPZ and SOG, rendered after decoding."""
    photographs, ply = read_photographs(run.photographs, run.size, seed=run.seed), folder / f"{run.name}.ply"
    files = dict(record["files"])
    for suffix in FORMATS:
        coded, again = there_and_back(ply, suffix)
        files[f"3DGS, {suffix.upper()}"] = _shown(coded, again, photographs, splat_settings(run))
        again.unlink()
    return {**record, "files": files, "tool": f"splat-transform {VERSION}"}


def _shown(coded: Path, ply: Path, photographs: PhotographSet, settings: SplatSettings) -> dict[str, float]:
    """Returns the bytes of a file, and the quality of its Gaussians on the held-out photographs."""
    found = quality(read_ply(ply), photographs.test, view_settings(photographs, settings))
    return {"bytes": coded.stat().st_size, **found}


# --- anchors ----------------------------------------------------------------------------------------------------------


def anchor_settings(run: Run) -> TrainSettings:
    """Returns the settings of a run with anchors. Raises SettingsError."""
    own = {"steps": run.steps, "seed": run.seed, "size": str(run.size), "rate.lambda_r": run.strength}
    # Evaluations during the training would count as its time.
    return assigned(varied(TrainSettings(), {**own, "looks.count": 1}), run.changes)


def _anchored(run: Run, folder: Path) -> Record | None:
    """Trains C3GS and writes its file, or an uncompressed Scaffold-GS."""
    photographs, settings = read_photographs(run.photographs, run.size, seed=run.seed), anchor_settings(run)
    trainer = Trainer(photographs, settings)
    state = folder / f"{run.name}.train-state"
    # Processor seconds of the training before the interrupt.
    spent, before = folder / f"{run.name}.seconds", 0.0
    if state.exists():
        restore(trainer, state)
        before = float(spent.read_text()) if spent.exists() else 0.0
    began: float | None = None

    def watch(_: Trainer) -> None:
        nonlocal began
        # The first step compiles.
        began = time.process_time() if began is None else began
        tell()

    def seconds() -> float:
        return before + (0.0 if began is None else time.process_time() - began)

    def keep() -> None:
        save(trainer, state)
        spent.write_text(f"{seconds():.3f}")

    tell = every_seconds(lambda: f"step {trainer.clock.done} of {settings.steps}, {trainer.scaffold.count} anchors")
    if not trainer.run(watch, keep):
        return None
    took, files = seconds(), {}
    lengths = {name: round(value) for name, value in trainer.estimate().items()}
    scene = trainer.result()
    if isinstance(scene, Uncompressed):
        files["Scaffold-GS"] = _anchors_shown(scene, sum(scene.sizes().values()), photographs)
    else:
        data = emit(packed(scene, None, None))
        (folder / f"{run.name}.c3gs").write_bytes(data)
        files["C3GS"] = _anchors_shown(data, len(data), photographs)
        lengths = {name: round(value) for name, value in trainer.estimate().items()}
    for file in (state, spent):
        file.unlink(missing_ok=True)
    rate = trainer.rate
    coding = sum(p.numel() for p in rate.started().coding_parameters()) if rate else 0
    more = {"anchors": trainer.scaffold.count, "lengths": lengths, "coding_parameters": coding}
    return run.record(took, settings, files, **more)


def _anchors_shown(scene: Any, size: int, photographs: PhotographSet) -> dict[str, float]:
    return {"bytes": size, **evaluate(scene, photographs, None, no_progress)["mean"]}
