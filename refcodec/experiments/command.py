"""The work of `refcodec experiment`: it runs the missing cells, then writes the tables of all cells that are done."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from .. import statuses
from ..files.lock import hold_folder
from ..files.stage import write_file
from ..files.terminal import note, say
from .cells import LOG, Cell, cells
from .curves import write_curves
from .engines import Engine, Local
from .experiment import COPY, Folder, State, Watch, look, named, run, tasks
from .on_ray import OnRay
from .plan import Experiment, ExperimentError
from .tables import CSV, MARKDOWN, as_csv, as_markdown, row

CURVES = "curves"


@dataclass(frozen=True)
class Options:
    """The options of the command.

    jobs: cells at a time, None for the engine's own number. threads: of each training run, None likewise. only:
    patterns of the cells to run, none for all. tables: whether nothing is run.
    """

    folder: Path
    engine: str = "local"
    jobs: int | None = None
    threads: int | None = None
    only: tuple[str, ...] = ()
    tables: bool = False


def run_experiment(experiment: Experiment, options: Options) -> int:
    """Returns the exit status.

    Raises ExperimentError for a fault that is found before anything runs, RunError for an engine that cannot run,
    and OSError.
    """
    chosen = list(cells(experiment, options.only))
    if not chosen:
        raise ExperimentError(
            f"no cell has a name like {' or '.join(options.only)}; the first one is {next(cells(experiment)).name}"
        )
    folder = Folder(options.folder)
    if options.tables:
        _write_tables(experiment, folder)
        return statuses.DONE
    with hold_folder(folder.path):
        state = look(experiment, folder, chosen, need=True)
        write_file(folder.path / COPY, experiment.text)
        threads, engine = _engine(options, folder)
        waiting = tasks(experiment, folder, state, threads)
        note(f"{len(state.results)} of {len(chosen)} cells are done before")
        try:
            watch, stopped = run(engine, waiting, len(chosen)) if waiting else (Watch(len(chosen), len(chosen)), False)
        finally:
            _write_tables(experiment, folder)
    for outcome in watch.failed:
        place = folder.path / "cells" / outcome.name / LOG
        note(f"refcodec: cell {outcome.name} has failed; all its lines are in {place}")
        for line in outcome.text.splitlines():
            note(line)
    if stopped or watch.interrupted:
        words = f"stopped with {watch.done} of {len(chosen)} cells done; run the same command again to continue"
        note(f"refcodec: {words}")
        return statuses.INTERRUPTED
    if watch.failed:
        count = len(watch.failed)
        note(f"refcodec: {count} of {len(chosen)} cells failed; the same command runs them again")
        return watch.failed[0].status
    return statuses.DONE


def _engine(options: Options, folder: Folder) -> tuple[int, Engine]:
    """The threads of each training run, and the engine that runs them."""
    if options.engine == "ray":
        return options.threads or 1, OnRay(folder.path.absolute(), options.jobs)
    jobs = options.jobs or 2
    return options.threads or max(1, (os.cpu_count() or 1) // jobs), Local(jobs)


def _write_tables(experiment: Experiment, folder: Folder) -> None:
    """Writes tables and curves of all cells that are done, including those of earlier calls."""
    every = list(cells(experiment))
    state = look(experiment, folder, every, need=False)
    missing = _missing(every, state)
    rows = [row(cell, state.results[cell.name]) for cell in every if cell.name in state.results]
    write_file(folder.path / CSV, as_csv(rows).encode())
    groups = {scene.name: scene.group for scene in experiment.scenes}
    write_file(
        folder.path / MARKDOWN, as_markdown(experiment.path.stem, rows, missing, experiment.baseline, groups).encode()
    )
    write_curves(folder.path / CURVES, rows)
    say(f"{len(rows)} of {len(every)} cells are in {folder.path / MARKDOWN}, {CSV} and {CURVES}")
    if missing:
        say(missing, lines=True)


def _missing(every: Sequence[Cell], state: State) -> str:
    lines = []
    if state.missing:
        names = [cell.name for cell in state.missing]
        lines.append(f"{len(names)} of {len(every)} cells are missing: {named(names)}.")
    if state.unknown:
        where = f"The photographs of these scenes are missing: {named(state.unknown)}"
        lines.append(f"{where}: their results are not compared with them.")
    return " ".join(lines)
