"""The work of `experiment` and `rd`: it runs the missing cells, then writes the tables of all cells that are done."""

import contextlib
import hashlib
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from ..files.lock import hold_folder
from ..files.outputs import check_apart
from ..files.stage import write_file
from ..files.terminal import note, say
from ..photographs.as_trained import stated_photographs
from ..photographs.colmap import IMAGE_SUFFIXES
from ..photographs.photographs import PhotographError
from ..statuses import DONE, INTERRUPTED
from .cells import Cell, cells, result_of
from .jobs import Run, RunError, Watch, claim, run_job, run_jobs
from .plan import CODED, Experiment, ExperimentError, Scene
from .tables import BD_POINTS, CSV, CURVES, MARKDOWN, as_csv, as_markdown, compare, read_curve, row, write_curves

FORMAT, MARK, COPY = "C3GS experiment", "experiment.json", "experiment.toml"
# Images, models of COLMAP, transforms of NeRF, points.
_SUFFIXES = (*IMAGE_SUFFIXES, ".bin", ".txt", ".json", ".ply")
# The largest number of missing cells that are named.
_NAMED = 20


@dataclass(frozen=True)
class Options:
    """The options of the command.

    jobs: cells at a time, None for the engine's own number. threads: of each training run, None likewise. only:
    patterns of the cells to run, none for all. tables: whether nothing is run. against: a table whose curve is compared
    with that of the method `coded` of the only scene.
    """

    folder: Path
    engine: str = "local"
    jobs: int | None = None
    threads: int | None = None
    only: tuple[str, ...] = ()
    tables: bool = False
    against: Path | None = None


def run_experiment(experiment: Experiment, options: Options) -> int:
    """Returns the exit status.

    Raises ExperimentError for a fault that is found before anything is written, RunError for a folder, an engine or a
    curve that cannot be used, UsageError if an output is an input, and OSError.
    """
    chosen, folder = list(cells(experiment, options.only)), options.folder.absolute()
    if not chosen:
        first = next(cells(experiment)).name
        raise ExperimentError(f"no cell has a name like {' or '.join(options.only)}; the first one is {first}")
    other = [point for point in read_curve(options.against) if point["lambda_r"]] if options.against else None
    if other is not None and (least := min(len(experiment.lambdas), len(other))) < BD_POINTS:
        raise RunError(f"BD-rate needs {BD_POINTS} points or more, here and in {options.against}: there are {least}")
    digests, inputs = ({}, []) if options.tables else _inputs(experiment, chosen)
    # Those of cells that are not run count only for the photographs that are there, if any are.
    known = {scene.name: _digest(path) for scene in experiment.scenes if (path := _here(experiment, scene))} | digests
    check_apart([folder / name for name in (MARK, COPY, CSV, MARKDOWN)], [options.against, *inputs])
    claim(folder, MARK, FORMAT)
    if options.tables:
        _write_tables(experiment, options.folder, known)
        return DONE
    with hold_folder(folder):
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
            _write_tables(experiment, options.folder, known)
    failed = [outcome for outcome in outcomes if outcome.status not in (DONE, INTERRUPTED)]
    for outcome in failed:
        note(f"refcodec: cell {outcome.name} has failed; its folder in {options.folder / 'cells'} has all lines")
        for line in outcome.text.splitlines():
            note(line)
    # A command may end so without a signal to this one.
    if stopped or any(outcome.status == INTERRUPTED for outcome in outcomes):
        note(f"refcodec: stopped with {watch.done} of {len(chosen)} cells done; the same command continues")
        return INTERRUPTED
    if failed:
        note(f"refcodec: {len(failed)} of {len(chosen)} cells failed; the same command runs them again")
    if not failed and other is not None:
        own = read_curve(folder / CSV)
        stated = {"scene": own[0]["scene"], "method": str(options.against)}
        write_curves(folder / CURVES, own + [{**point, **stated} for point in other])
        difference = compare(other, [point for point in own if point["method"] == CODED])
        say(f"BD-rate {difference.rate:+.2f} %, BD-PSNR {difference.psnr:+.3f} dB against {options.against}")
        if difference.warning:
            note(f"refcodec: {difference.warning}")
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


def _inputs(experiment: Experiment, chosen: Sequence[Cell]) -> tuple[dict[str, str], list[Path]]:
    """Returns the digests of the photographs of some cells, by scene, and their files.

    Raises ExperimentError for unusable ones.
    """
    digests, places = dict[str, str](), list[Path]()
    for cell in {(cell.scene.name, cell.settings.size): cell for cell in chosen}.values():
        path, settings, name = experiment.photographs(cell.scene), cell.settings, cell.scene.name
        try:
            photographs = stated_photographs(path, settings.size, settings.background, settings.holdout)
        except PhotographError as error:
            raise ExperimentError(f"scene {name}: {error}") from None
        places += photographs.places()
        digests[name] = digests.get(name) or _digest(path)
    return digests, places


def _here(experiment: Experiment, scene: Scene) -> Path | None:
    """Returns the folder of the photographs of a scene, or None if it is not there or its variable is not set."""
    with contextlib.suppress(ExperimentError):
        return path if (path := experiment.photographs(scene)).is_dir() else None
    return None


def _digest(folder: Path) -> str:
    """SHA-256 of the names, from the folder on, and contents of all files of a data set. Raises OSError."""
    made = hashlib.sha256()
    for path in sorted(folder.rglob("*")):
        if path.suffix.lower() in _SUFFIXES and path.is_file():
            with path.open("rb") as file:
                line = [path.relative_to(folder).as_posix(), hashlib.file_digest(file, "sha256").hexdigest()]
            made.update(f"{line}\n".encode())
    return made.hexdigest()


def _write_tables(experiment: Experiment, folder: Path, digests: Mapping[str, str]) -> None:
    """Writes tables and curves of all cells that are done, including those of earlier calls.

    digests: of the photographs, by scene. A result of other ones is none.
    """
    every = list(cells(experiment))
    results = {cell.name: result for cell in every if (result := result_of(cell, folder, digests.get(cell.scene.name)))}
    if absent := [scene.name for scene in experiment.scenes if scene.name not in digests]:
        note(f"the photographs of these scenes are missing, and are not compared: {', '.join(absent)}")
    rows = [
        row(cell.scene.name, cell.method.name, cell.lambda_r, cell.seed, results[cell.name])
        for cell in every
        if cell.name in results
    ]
    names = [cell.name for cell in every if cell.name not in results]
    more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
    missing = f"{len(names)} of {len(every)} cells are missing: {', '.join(names[:_NAMED])}{more}" if names else ""
    write_file(folder / CSV, as_csv(rows).encode())
    text = as_markdown(experiment.path.stem, rows, missing, experiment.baseline)
    write_file(folder / MARKDOWN, text.encode())
    write_curves(folder / CURVES, rows)
    say(text, lines=True)
    say(f"{len(rows)} of {len(every)} cells are in {folder / MARKDOWN}, {CSV} and {CURVES}")
