"""The work of `refcodec experiment`: it runs the missing cells, then writes the tables of all cells that are done."""

from __future__ import annotations

import contextlib
import hashlib
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from ..files.lock import hold_folder
from ..files.stage import write_file
from ..files.terminal import note, say
from ..photographs.colmap import IMAGE_SUFFIXES
from ..photographs.photographs import TEST_EVERY, PhotographError, parse_size, read_photographs
from ..statuses import DONE, INTERRUPTED
from .cells import Cell, cells, result_of
from .jobs import Run, Watch, claim, run_job, run_jobs
from .plan import Experiment, ExperimentError
from .tables import CSV, CURVES, MARKDOWN, as_csv, as_markdown, row, write_curves

FORMAT, MARK, COPY = "C3GS experiment", "experiment.json", "experiment.toml"
# Images, models of COLMAP, transforms of NeRF, points.
_SUFFIXES = (*IMAGE_SUFFIXES, ".bin", ".txt", ".json", ".ply")
# The largest number of missing cells that are named.
_NAMED = 20


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

    Raises ExperimentError for a fault that is found before anything runs, RunError for a folder or an engine that
    cannot be used, and OSError.
    """
    chosen, folder = list(cells(experiment, options.only)), options.folder.absolute()
    if not chosen:
        first = next(cells(experiment)).name
        raise ExperimentError(f"no cell has a name like {' or '.join(options.only)}; the first one is {first}")
    claim(folder, MARK, FORMAT)
    if options.tables:
        _write_tables(experiment, options.folder)
        return DONE
    with hold_folder(folder):
        digests = _digests(experiment, chosen)
        waiting = [cell for cell in chosen if result_of(cell, folder, digests[cell.scene.name]) is None]
        write_file(folder / COPY, experiment.text)
        note(f"{len(chosen) - len(waiting)} of {len(chosen)} cells are done before")
        watch = Watch(len(chosen), len(chosen) - len(waiting))
        try:
            with _engine(options, folder, experiment.device) as (workers, threads, run):
                jobs = [
                    cell.job(folder, experiment.photographs(cell.scene), digests[cell.scene.name], threads)
                    for cell in waiting
                ]
                outcomes, stopped = run_jobs(jobs, workers, run, watch) if jobs else ([], False)
        finally:
            _write_tables(experiment, options.folder)
    failed = [outcome for outcome in outcomes if outcome.status not in (DONE, INTERRUPTED)]
    for outcome in failed:
        note(f"refcodec: cell {outcome.name} has failed; its folder in {options.folder / 'cells'} has all lines")
        for line in outcome.text.splitlines():
            note(line)
    if stopped:
        note(f"refcodec: stopped with {watch.done} of {len(chosen)} cells done; the same command continues")
        return INTERRUPTED
    if failed:
        note(f"refcodec: {len(failed)} of {len(chosen)} cells failed; the same command runs them again")
    return failed[0].status if failed else DONE


@contextlib.contextmanager
def _engine(options: Options, folder: Path, device: str) -> Iterator[tuple[int, int, Run]]:
    """Yields the number of cells at a time, the threads of each training run, and what runs a job."""
    if options.engine == "ray":
        from .on_ray import on_ray  # noqa: PLC0415 (an extra)

        threads = options.threads or 1
        with on_ray(folder, options.jobs, threads, int(device == "cuda")) as (workers, run):
            yield workers, threads, run
    else:
        jobs = options.jobs or 2
        yield jobs, options.threads or max(1, (os.cpu_count() or 1) // jobs), run_job


def _digests(experiment: Experiment, chosen: Sequence[Cell]) -> dict[str, str]:
    """Returns the digests of the photographs of some cells, by scene. Raises ExperimentError for unusable ones."""
    sizes = {(cell.scene.name, cell.settings.size): cell.scene for cell in chosen}
    digests: dict[str, str] = {}
    for (name, size), scene in sizes.items():
        path = experiment.photographs(scene)
        try:
            read_photographs(path, parse_size(size), holdout=TEST_EVERY if scene.holdout is None else scene.holdout)
        except PhotographError as error:
            raise ExperimentError(f"scene {name}: {error}") from None
        digests[name] = digests.get(name) or _digest(path)
    return digests


def _digest(folder: Path) -> str:
    """SHA-256 of the names, from the folder on, and contents of all files of a data set. Raises OSError."""
    made = hashlib.sha256()
    for path in sorted(folder.rglob("*")):
        if path.suffix.lower() in _SUFFIXES and path.is_file():
            with path.open("rb") as file:
                line = [path.relative_to(folder).as_posix(), hashlib.file_digest(file, "sha256").hexdigest()]
            made.update(f"{line}\n".encode())
    return made.hexdigest()


def _write_tables(experiment: Experiment, folder: Path) -> None:
    """Writes tables and curves of all cells that are done, including those of earlier calls."""
    every = list(cells(experiment))
    results = {cell.name: result for cell in every if (result := result_of(cell, folder))}
    rows = [
        row(cell.scene.name, cell.method.name, cell.lambda_r, cell.seed, results[cell.name])
        for cell in every
        if cell.name in results
    ]
    missing = ", ".join([cell.name for cell in every if cell.name not in results][:_NAMED])
    if missing:
        missing = f"{len(every) - len(rows)} of {len(every)} cells are missing: {missing}"
    write_file(folder / CSV, as_csv(rows).encode())
    write_file(folder / MARKDOWN, as_markdown(experiment.path.stem, rows, missing, experiment.baseline).encode())
    write_curves(folder / CURVES, rows)
    say(f"{len(rows)} of {len(every)} cells are in {folder / MARKDOWN}, {CSV} and {CURVES}")
    if missing:
        say(missing)
