"""Run whole experiments."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Literal, Unpack

from ..statuses import DONE, INTERRUPTED, UsageError
from . import kinds
from .command import Report, command, only_one
from .learning import DataWords, TrainingWords


def _refuse_lambda(words: DataWords, advice: str) -> None:
    """Raises UsageError if --set has lambda_r, for commands that choose it. advice: the remedy."""
    if any(change.partition("=")[0].strip() == "rate.lambda_r" for change in words.get("set") or ()):
        raise UsageError(f"--set cannot change rate.lambda_r: {advice}")


@command("demo")
def demo(
    *,
    output: kinds.Folder = "demo",
    scene: Literal["caliterra", "snowmiku"] | None = None,
    photographs: kinds.AnyPath | None = None,
    steps: kinds.Positive | None = None,
    **words: Unpack[DataWords],
) -> Report:
    """Train on example photographs, encode the scene, and write a page of the results.

    The page is DIR/index.html. It takes eight to twelve minutes on two cores. Ctrl-C ends the training early and
    shows the result so far. The same command continues, and repeats nothing. Options of train apply to both
    training runs.
    Needs: pip install 'refcodec[demo]'.

    Args:
        output: folder for the results.
        scene: which photographs (default: caliterra).
        photographs: your own photographs, a COLMAP or NeRF folder.
        steps: steps of each training (default: 5,000).

    Examples:
        demo
        demo -o out --scene snowmiku
        demo -o out --steps 600
        demo -o out --photographs my-photographs --background white --holdout 5
    """
    from ..experiments.demo import Demo, find_example, options_of, run_demo
    from ..train.settings_file import chosen_settings

    only_one(scene=scene, photographs=photographs)
    _refuse_lambda(words, "the demo chooses its lambdas")
    chosen = chosen_settings({**words, "steps": steps})
    folder = find_example(scene or "caliterra") if photographs is None else Path(photographs)
    page, whole = run_demo(Demo(Path(output), folder, chosen, options_of(words)))
    return Report([f"The page: {page.resolve().as_uri()}"], {"page": page}, status=DONE if whole else INTERRUPTED)


@command("train,render,rd")
def rd(
    photographs: kinds.AnyPath,
    output: kinds.Folder,
    *,
    lambdas: Sequence[kinds.CodedLambda] = (0.002, 0.004, 0.01, 0.04),
    uncompressed: bool = False,
    against: kinds.FilePath | None = None,
    jobs: kinds.Positive = 2,
    device: kinds.Device | None = None,
    **words: Unpack[TrainingWords],
) -> Report:
    """Train with several lambdas, and write sizes and quality as a table and a chart.

    It runs an experiment of one scene, and writes its file, DIR/experiment.toml. DIR gets results.csv,
    tables.md and curves/, and below cells/ a scene folder and a file for each lambda, as with `experiment`.
    The same command continues after an interruption, and repeats nothing. Options of train apply to all
    training runs.
    Needs: pip install 'refcodec[train,render,rd]'.

    Args:
        output: folder for the results.
        lambdas: lambda_r of each training.
        uncompressed: also train without the codec.
        against: a table with columns bytes and psnr: print BD-rate and BD-PSNR with this curve as reference.
        jobs: training runs in parallel.
        device: device of the training, as for train.

    Examples:
        rd photographs -o curve --size 400x300
        rd photographs -o curve --lambdas 0.002 0.004 0.01 0.04 --uncompressed
        rd photographs -o curve --against other/results.csv
        rd photographs -o curve --anchors 20000 --holdout 5 --set masks.epsilon=0.0004
    """
    from ..experiments.command import Options, run_experiment
    from ..experiments.plan import one_scene

    _refuse_lambda(words, "use --lambdas")
    curve = one_scene(Path(photographs), words, sorted({*lambdas}), uncompressed, device)
    table = None if against is None else Path(against)
    return Report(status=run_experiment(curve, Options(Path(output), jobs=jobs, against=table)))


@command("train,render,rd")
def experiment(
    file: kinds.FilePath,
    output: kinds.Folder,
    *,
    engine: Literal["local", "ray"] = "local",
    jobs: kinds.Positive | None = None,
    threads: kinds.Positive | None = None,
    only: Sequence[kinds.Pattern] = (),
    tables: bool = False,
) -> Report:
    """Train the scenes, methods, lambdas and seeds of a file, and write tables and curves.

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
    A cell is SCENE/METHOD/lambda-L/seed-S: one training, encode, eval --json. It is done if
    DIR/cells/CELL/result.json is complete and was made by the same commands, settings, photographs and version of
    refcodec. The command runs the other cells, and continues interrupted ones. DIR gets results.csv (a row for each
    cell), tables.md (means and sample standard deviations over seeds, comparisons), which it prints, and curves/ (PNG,
    SVG).
    Ctrl-C stops the training runs, which save their state.

    --engine ray runs cells on Ray, on this machine or on the cluster of RAY_ADDRESS. All machines of a cluster need
    refcodec, and DIR and the photographs under the same paths. A cell requests --threads processors (default: 1), and
    with device = "cuda" one GPU.
    Needs: pip install 'refcodec[train,render,rd]', and 'refcodec[ray]' for --engine ray.

    Args:
        file: a TOML file that describes the experiment.
        output: folder for the results.
        engine: what runs the cells.
        jobs: parallel cells (default: 2; with Ray, as many as fit).
        threads: processors per training (default: all divided by the jobs; with Ray: 1); results do not depend on it.
        only: cells to run, with * and ?; repeatable.
        tables: run nothing: write tables and curves of the finished cells.

    Examples:
        experiment benchmarks/experiments/tiny.toml -o tiny
        experiment benchmarks/experiments/tiny.toml -o tiny --only 'caliterra/pro/*' --jobs 4
        experiment benchmarks/experiments/quality.toml -o /shared/quality --engine ray
        experiment benchmarks/experiments/tiny.toml -o tiny --tables
    """
    from ..experiments.command import Options, run_experiment
    from ..experiments.plan import read_experiment

    options = Options(Path(output), engine, jobs, threads, tuple(only), tables)
    return Report(status=run_experiment(read_experiment(Path(file)), options))
