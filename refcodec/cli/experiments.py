"""Commands that run others: demo, rd, experiment."""

# Modules that need NumPy are imported by the commands that use them, so that help is instant.
# ruff: noqa: PLC0415

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from .. import statuses
from ..files.terminal import note, say
from . import train_options
from .shared import PHOTOGRAPHS, RENDER_PACKAGES, UsageError, add_command, needs, positive, rate, seed


def _demo(arguments: argparse.Namespace) -> int:
    try:
        from ..experiments.data_set import DataSet
        from ..experiments.demo import STEPS, find_example, run_demo
        from ..experiments.jobs import RunError
        from ..photographs.photographs import PhotographError
        from ..train.settings import TrainSettings
    except ModuleNotFoundError as error:
        raise needs("demo", "demo", error, RENDER_PACKAGES) from None
    train_options.refuse_rate(arguments, "the demo chooses its rates")
    chosen = train_options.settings(arguments, TrainSettings(steps=STEPS), {"steps": arguments.steps})
    try:
        folder = Path(arguments.photographs) if arguments.photographs else find_example(arguments.scene)
        photographs = DataSet(folder, chosen.size, chosen.background, chosen.holdout, train_options.words(arguments))
        page, whole = run_demo(Path(arguments.output), photographs, chosen.steps)
    except PhotographError as error:
        raise UsageError(str(error)) from None
    except RunError as error:
        for line in f"refcodec: {error}".splitlines():
            note(line)
        return error.status
    say(f"The page: {page.resolve().as_uri()}")
    return 0 if whole else statuses.INTERRUPTED


def _rd(arguments: argparse.Namespace) -> int:
    try:
        from ..experiments.command import Options
        from ..experiments.data_set import DataSet
        from ..experiments.jobs import RunError
        from ..experiments.plan import OWN_KEYS, ExperimentError
        from ..experiments.rd import one_scene, run_rd, scene_name
        from ..photographs.photographs import PhotographError
        from ..train.settings import PRESETS
    except ModuleNotFoundError as error:
        packages = ("matplotlib", "bjontegaard", "msgspec", "torch", *RENDER_PACKAGES)
        raise needs("rd", "train,render,rd", error, packages) from None
    train_options.refuse_rate(arguments, "use --lambdas")
    own = {"size": arguments.size, "steps": arguments.steps, "seed": arguments.seed}
    chosen = train_options.settings(arguments, PRESETS[arguments.preset], own)
    folder = Path(arguments.photographs)
    scene = {
        "name": scene_name(folder),
        "photographs": str(folder.absolute()),
        "size": chosen.size,
        "background": None if chosen.background == "auto" else chosen.background,
        "holdout": chosen.holdout,
        "up": arguments.up,
        "voxel": arguments.voxel,
        "anchors": arguments.anchors,
        "degree": arguments.degree,
        "set": [change for change in arguments.set if change.partition("=")[0].strip() not in OWN_KEYS],
    }
    others = {"seeds": [chosen.seed], "steps": chosen.steps, "device": arguments.device}
    against = Path(arguments.against) if arguments.against else None
    try:
        # Errors in the photographs are reported before anything is written.
        places = DataSet(folder, chosen.size, chosen.background, chosen.holdout).read().places()
        rates = sorted(set(arguments.lambdas))
        experiment = one_scene(scene, arguments.preset, rates, arguments.uncompressed, arguments.static, **others)
        return run_rd(experiment, places, Options(Path(arguments.output), jobs=arguments.jobs), against)
    except (ExperimentError, PhotographError) as error:
        raise UsageError(str(error)) from None
    except RunError as error:
        note(f"refcodec: {error}")
        return error.status


def _experiment(arguments: argparse.Namespace) -> int:
    try:
        from ..experiments.command import Options, run_experiment
        from ..experiments.jobs import RunError
        from ..experiments.plan import ExperimentError, read_experiment
    except ModuleNotFoundError as error:
        packages = ("matplotlib", "bjontegaard", "msgspec", "torch", *RENDER_PACKAGES)
        raise needs("experiment", "train,render,rd", error, packages) from None
    options = Options(
        folder=Path(arguments.output),
        engine=arguments.engine,
        jobs=arguments.jobs,
        threads=arguments.threads,
        only=tuple(arguments.only),
        tables=arguments.tables,
    )
    try:
        return run_experiment(read_experiment(Path(arguments.file)), options)
    except ExperimentError as error:
        raise UsageError(str(error)) from None
    except RunError as error:
        note(f"refcodec: {error}")
        return error.status
    except ModuleNotFoundError as error:
        raise needs("experiment --engine ray", "ray", error, ("ray",)) from None


# Help of `experiment` on the file and the folder.
_EXPERIMENT_NOTES = """\
FILE is a TOML file with these keys:
  lambdas, seeds        lists of lambda_r and of seeds; each method trains each scene at each pair of them
  steps                 of each training (default: the preset's)
  device                cpu or cuda (default: cpu)
  baseline              the method with which the others are compared: BD-rates, and differences of photographs
It has a table [[scenes]] for each scene:
  name                  1 to 64 letters, digits and . _ + -
  photographs           a folder, relative to FILE; ${NAME} is an environment variable
  size, holdout, up     as for train (default: the preset's)
  lambdas               those of this scene
  set                   a list of NAME=VALUE, as for train --set, such as background=white or start.anchors=5000
It has a table [[methods]] for each method:
  name                  as for scenes
  kind                  train (the default), or uncompressed, which has no lambdas
  preset, static        as for train (default: fast, false)
  set                   a list of NAME=VALUE, as for train --set, applied after that of the scene
  scenes                names of scenes, if the method is only for these
A cell is SCENE/METHOD/lambda-L/seed-S: one training, encode, eval --json. It is done if DIR/cells/CELL/result.json is
complete and was made by the same commands, settings, photographs and version of refcodec. The command runs the other
cells, and continues interrupted ones. DIR gets results.csv (a row for each cell), tables.md (means and sample standard
deviations over seeds, comparisons) and curves/ (PNG, SVG).
Ctrl-C stops the training runs, which save their state.

--engine ray runs cells on Ray, on this machine or on the cluster of RAY_ADDRESS. All machines of a cluster need
refcodec, and DIR and the photographs under the same paths. A cell requests --threads processors (default: 1), and with
device = "cuda" one GPU.
Needs: pip install 'refcodec[train,render,rd]', and 'refcodec[ray]' for --engine ray."""


def add(commands: Any) -> None:
    """Adds the commands of this module."""
    _add_demo(commands)
    _add_rd(commands)
    _add_experiment(commands)


def _add_demo(commands: Any) -> None:
    demo = add_command(
        commands,
        "demo",
        _demo,
        "train on example photographs, encode the scene, and write a page of the results",
        [
            "demo",
            "demo -o out --scene snowmiku",
            "demo -o out --steps 600",
            "demo -o out --photographs my-photographs --background white --holdout 5",
        ],
        "The page is DIR/index.html. It takes about six minutes on two cores. Ctrl-C ends the training early and\n"
        "shows the result so far. The same command continues, and repeats nothing. Options of train apply to both\n"
        "training runs.\n"
        "Needs: pip install 'refcodec[demo]'.",
        parents=[train_options.parser()],
    )
    demo.add_argument(
        "-o", "--output", metavar="DIR", default="demo", help="folder for the results (default: %(default)s)"
    )
    which = demo.add_mutually_exclusive_group()
    which.add_argument(
        "--scene",
        choices=("caliterra", "snowmiku"),
        default="caliterra",
        help="which photographs (default: %(default)s)",
    )
    which.add_argument("--photographs", metavar="FOLDER", help="your own photographs, a COLMAP or NeRF folder")
    demo.add_argument(
        "--steps", type=positive, metavar="N", help="steps of each training (default: about four minutes)"
    )


def _add_rd(commands: Any) -> None:
    rd = add_command(
        commands,
        "rd",
        _rd,
        "train at several rates, and write sizes and quality as a table and a chart",
        [
            "rd photographs -o curve --size 400x300",
            "rd photographs -o curve --lambdas 0.002 0.004 0.01 0.04 --uncompressed",
            "rd photographs -o curve --against other/results.csv",
            "rd photographs -o curve --anchors 20000 --holdout 5 --set masks.epsilon=0.0004",
        ],
        "It runs an experiment of one scene, and writes its file, DIR/experiment.toml. DIR gets results.csv,\n"
        "tables.md and curves/, and below cells/ a scene folder and a file for each rate, as with `experiment`.\n"
        "The same command continues after an interruption, and repeats nothing. Options of train apply to all\n"
        "training runs.\n"
        "Needs: pip install 'refcodec[train,render,rd]'.",
        parents=[train_options.parser()],
    )
    rd.add_argument("photographs", metavar="PHOTOGRAPHS", help=PHOTOGRAPHS)
    rd.add_argument("-o", "--output", metavar="DIR", required=True, help="folder for the results")
    rd.add_argument(
        "--lambdas",
        type=rate,
        nargs="+",
        metavar="R",
        default=[0.002, 0.004, 0.01, 0.04],
        help="lambda_r (default: 0.002 0.004 0.01 0.04)",
    )
    rd.add_argument("--uncompressed", action="store_true", help="also train without the codec")
    rd.add_argument(
        "--against",
        metavar="CSV",
        help="a table with columns bytes and psnr: print BD-rate and BD-PSNR with this curve as reference",
    )
    rd.add_argument(
        "--jobs", type=positive, metavar="N", default=2, help="training runs in parallel (default: %(default)s)"
    )
    rd.add_argument("--size", metavar="WxH", help="size to which photographs are averaged down, or longest side")
    rd.add_argument("--preset", choices=("fast", "paper"), default="fast", help="as for train (default: %(default)s)")
    for name, kind in (("steps", positive), ("seed", seed), ("device", str)):
        rd.add_argument(f"--{name}", type=kind, help="as for train")


def _add_experiment(commands: Any) -> None:
    experiment = add_command(
        commands,
        "experiment",
        _experiment,
        "train the scenes, methods, rates and seeds of a file, and write tables and curves",
        [
            "experiment benchmarks/experiments/tiny.toml -o tiny",
            "experiment benchmarks/experiments/tiny.toml -o tiny --only 'caliterra/pro/*' --jobs 4",
            "experiment benchmarks/experiments/quality.toml -o /shared/quality --engine ray",
            "experiment benchmarks/experiments/tiny.toml -o tiny --tables",
        ],
        _EXPERIMENT_NOTES,
    )
    experiment.add_argument("file", metavar="FILE", help="a TOML file that describes the experiment")
    experiment.add_argument("-o", "--output", metavar="DIR", required=True, help="folder for the results")
    experiment.add_argument(
        "--engine", choices=("local", "ray"), default="local", help="what runs the cells (default: %(default)s)"
    )
    experiment.add_argument(
        "--jobs",
        type=positive,
        metavar="N",
        help="parallel cells (default: 2; with Ray, as many as fit)",
    )
    experiment.add_argument(
        "--threads",
        type=positive,
        metavar="N",
        help="processors per training (default: all divided by the jobs; with Ray: 1); results do not depend on it",
    )
    experiment.add_argument(
        "--only", metavar="PATTERN", action="append", default=[], help="cells to run, with * and ?; repeatable"
    )
    experiment.add_argument(
        "--tables", action="store_true", help="run nothing: write tables and curves of the finished cells"
    )
